"""Figure 2.26: speckle in the image of a USAF target after only 5 iterations."""

import numpy as np
from common import begin, number
from drawing import bar, new_figure
from scipy.stats import gamma
from target import averages, clear, image, iota_of, masked, passed, show, usaf

M, CELLS = 5, 56
ONE = {"field": 0.978, "phase": 0.603}  # contrast of one clear snapshot: independent, float64
COLOURS = {"field": "C0", "phase": "C1"}

run = begin(__doc__, __file__)
thing = usaf(448, run.device)
ground = clear(thing)
figure = new_figure(11.4, 7.4)
upper, lower = figure.subfigures(2, 1, height_ratios=[1.55, 1])
panels, (close, law) = upper.subplots(1, 3, sharey=True), lower.subplots(1, 2)
for axes, kind in zip(panels, ONE, strict=False):
    light = masked(thing, CELLS, kind)
    level = passed(thing, light)
    mean = averages(thing, light, (M,))[M].to_numpy() / level
    drawn = show(axes, mean, thing.grid, 2)
    axes.set_title(f"{kind} masks, M = {M}")
    x, row = thing.grid.x * 1e3, np.argmin(np.abs(thing.grid.y - 1.18e-3))
    close.plot(x, mean[row], color=COLOURS[kind], lw=1, label=f"{kind} masks, M = {M}")
    found = averages(ground, light, (M,))[M].to_numpy().astype(float).ravel() / level
    contrast = found.std() / found.mean()
    number(f"clear field, {kind} masks: mean", found.mean(), 1.0, 0.05, ".3f")
    number(f"clear field, {kind} masks: contrast", contrast, ONE[kind] / np.sqrt(M), 0.03, ".3f")
    law.hist(found, np.linspace(0, 3.5, 71), density=True, color=COLOURS[kind], alpha=0.5,
             label=f"{kind} masks: contrast {contrast:.2f}")
    shape, t = M / ONE[kind] ** 2, np.linspace(0, 3.5, 351)
    law.plot(t, gamma.pdf(t, shape, scale=1 / shape), color=COLOURS[kind])
    if kind == "field":
        dark = gamma.cdf(0.5, shape, scale=1 / shape)
        number("share of a clear field below half its mean", np.mean(found < 0.5), dark, 0.02,
               ".3f")
exact = image(thing, light) / level
show(panels[2], exact, thing.grid, 2)
panels[2].set_title("sum over the source of phase masks: no speckle")
close.plot(x, exact[row], "k", lw=1, label="sum over the source")
bar(upper, drawn, panels, "intensity / that of a clear field", extend="max")
close.set(xlabel="x / mm", ylabel="intensity / that of a clear field", xlim=(-1.79, 1.79),
          title=rf"cut at y = 1.18 mm; $\iota$ = {iota_of(thing, CELLS):.2g}")
law.set(xlabel="intensity / mean", ylabel="probability density",
        title="clear field; lines: gamma distributions of that contrast")
for axes in (close, law):
    axes.legend()
run.save(figure)
