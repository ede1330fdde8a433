"""Figure 2.27: images of a USAF target from more and more snapshots: the speckle noise falls."""

import numpy as np
from common import begin, number
from drawing import bar, new_figure
from target import CLOSE_UP, averages, image, iota_of, masked, passed, show, snr, usaf

CELLS, COUNTS = 56, (1, 5, 25, 100, 300)
FACTOR = {"field": 2.301, "phase": 2.284}  # rms/mean of the exact image: independent, float64
ONE = {"field": 0.978, "phase": 0.603}  # contrast of one clear snapshot: the same
LAW = r"$c_1\,$rms$\,$/$\,$mean$\,$/$\,\sqrt{M}$"
COLOURS = {"field": "C0", "phase": "C1"}

run = begin(__doc__, __file__)
counts = COUNTS[:4] if run.quick else COUNTS
thing = usaf(448, run.device)
figure = new_figure(11.4, 8)
upper, lower = figure.subfigures(2, 1, height_ratios=[1.8, 1])
(curve, cut), panels = lower.subplots(1, 2), upper.subplots(2, len(counts), sharey="row")
for kind, factor in FACTOR.items():
    light = masked(thing, CELLS, kind)
    exact, level = image(thing, light), passed(thing, light)
    relative = np.sqrt(np.mean(exact**2)) / exact.mean()
    number(f"{kind} masks: rms/mean of the exact image", relative, factor, 0.01, ".3f")
    means = averages(thing, light, counts)
    for (whole, close), (count, mean) in zip(panels.T, means.items(), strict=True):
        if kind == "field":
            drawn, near = (show(axes, mean.to_numpy() / level, thing.grid, most)
                           for axes, most in ((whole, 2), (close, 0.8)))
            whole.set(title=f"M = {count}: {snr(thing, mean.to_numpy()):.1f} dB", xlabel="")
            close.set(**CLOSE_UP)
    done, reported = means[counts[-1]].convergence.T
    law = ONE[kind] * factor / np.sqrt(done)
    curve.loglog(done, law, color="0.8", lw=5, label=LAW if kind == "field" else None)
    curve.loglog(done, reported, color=COLOURS[kind], label=f"{kind} masks: reported")
    errors = {n: mean.to_numpy() - exact for n, mean in means.items()}
    curve.loglog(counts, [np.sqrt(np.mean(e**2)) / exact.mean() for e in errors.values()], "o",
                 color=COLOURS[kind], label=f"{kind} masks: true")
    number(f"{kind} masks: reported error over the law", reported[-1] / law[-1], 1.0, 0.1, ".3f")
    off = (errors[100] / means[100].standard_error.to_numpy())[exact > 0.1 * level]
    off = np.sqrt(np.mean(off**2))
    number(f"{kind} masks, M = 100: rms error / reported", off, 1.0, 0.1, ".3f")
    if kind == "field":
        x, row = thing.grid.x * 1e3, np.argmin(np.abs(thing.grid.y - 1.18e-3))
        for n, colour in ((25, "C1"), (counts[-1], "C3")):
            mean, error = (v.to_numpy()[row] / level
                           for v in (means[n].intensity, means[n].standard_error))
            cut.fill_between(x, mean - error, mean + error, color=colour, alpha=0.5, lw=0,
                             label=f"M = {n}: mean and standard error")
        cut.plot(x, exact[row] / level, "k", lw=1, label="sum over the source")
for values, row in zip((drawn, near), panels, strict=True):
    bar(upper, values, row, "intensity / clear field", extend="max")
curve.set(xlabel="snapshots M", ylabel="standard error / mean")
cut.set(xlabel="x / mm", ylabel="intensity / clear field", xlim=(0, 1.79),
        title=rf"cut at y = 1.18 mm, field masks, $\iota$ = {iota_of(thing, CELLS):.2g}")
curve.legend()
cut.legend()
run.save(figure)
