"""Figure 2.29: coherent and incoherent response of a simple 2f system to a sharp edge."""

import numpy as np
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import LIGHT, bar, new_figure
from responses import FC, edge_through_the_lens, edge_through_the_pupil
from scipy.signal import resample
from target import COHERENT, LAMP

from clplen import Coherence
from clplen.wave import RandomPhaseMask, coherent_edge, incoherent_edge

MASKS = {  # iota: samples of a cell (y, x), cells (y, x); edge, maximum: independent, float64
    0.25: ((13, 39), (3, 14), 0.262, 1.143, "0.5"), 0.5: ((6, 20), (4, 26), 0.270, 1.104, GREEN),
    1: ((3, 10), (8, 52), 0.334, 0.997, ORANGE), 2: ((2, 5), (16, 104), 0.411, 0.994, "C4")}

run = begin(__doc__, __file__)
figure = new_figure(11.4, 9)
upper, lower = figure.subfigures(2, 1, height_ratios=[1, 5.5])
strips = upper.subplots(1, 6)
axes, off = lower.subplots(2, height_ratios=[2, 1], sharex=True)
x, *whole = edge_through_the_lens(run.device)
x_fc, shown = np.linspace(-2, 3, 501), {}
laws = (("coherent", coherent_edge, COHERENT, 0.25, BLUE),
        ("incoherent", incoherent_edge, LAMP, 0.5, RED))
for (name, law, light, expected, colour), lens in zip(laws, whole, strict=True):
    at, mean = edge_through_the_pupil((512, 512), (1 / (16 * FC),) * 2, light, run.device)
    axes.plot(x_fc, law(x_fc), color=colour, label=f"{name}: closed form")
    shown[name] = law(x_fc)
    for word, u, values, form in (("pupil", at, mean, "o"), ("whole system", x, lens, "+")):
        near = np.abs(u) < 3
        axes.plot(u[near], values[near], form, color=colour, ms=5, mfc="none",
                  label=f"{name}: {word}")
        error = 1e3 * (values[near] - law(u[near]))
        off.plot(u[near], error, f"{form}-", color=colour, ms=4, mfc="none", lw=0.6)
        number(f"{name}, {word}: at the edge", values[np.abs(u) < 1e-6][0], expected,
               0.005 if form == "o" else 0.01)
        if light is COHERENT:
            number(f"{name}, {word}: maximum", values[near].max(), 1.18699, 0.02)
for iota, (samples, cells, expected, maximum, colour) in MASKS.items():
    p = 0.61 / (iota * FC)
    at, mean = edge_through_the_pupil(np.multiply(samples, cells), p / np.array(samples),
                                      Coherence(RandomPhaseMask(p)), run.device)
    fine = np.interp(x_fc, at[0] + np.arange(8 * at.size) / 8 * (at[1] - at[0]),
                     resample(mean, 8 * at.size))  # eight values a sample
    axes.plot(x_fc, fine, color=colour, lw=1, label=rf"$\iota$ = {iota:g}: sum over the source")
    shown[rf"$\iota$ = {iota:g}"] = fine
    number(f"iota = {iota:g}: at the edge", mean[np.abs(at) < 1e-6][0], expected, 0.01, ".3f")
    number(f"iota = {iota:g}: maximum", mean[at < 8].max(), maximum, 0.01, ".3f")
shown["incoherent"] = shown.pop("incoherent")  # last
how = {"cmap": LIGHT, "vmin": 0, "vmax": 1.2, "aspect": "auto", "extent": (-2, 3, 0, 1)}
for panel, (name, values) in zip(strips, shown.items(), strict=True):
    drawn = panel.imshow(values[None], **how)
    panel.set(title=name, yticks=[])
bar(upper, drawn, strips, "intensity")
axes.set(ylabel="intensity / clear field", xlim=(-2, 3), ylim=(0, 1.25))
off.set(xlabel="distance from the edge times $f_c$", ylabel="less closed form / $10^{-3}$")
axes.legend(ncols=2, loc="lower right")
run.save(figure)
