"""Figure 2.18: Young's experiment, to scale, and the visibility of its fringes."""

import numpy as np
from closed import LAM
from coherent import Young
from common import BLUE, GREEN, RED, begin, number
from drawing import LIGHT, new_figure
from scipy.signal import resample

from clplen import Coherence
from clplen.wave import ExtendedSource

FAR, SIZE, PAIR = 0.5, 0.5e-3, 8  # m, source to pinholes to screen; m; samples: what is drawn
SIZES = {0.25e-3: GREEN, SIZE: BLUE, 1e-3: RED}  # diameters of the source
SHOWN, DEEP = (4, 8, 16, 24), 0.05  # separations in samples; depth of the screen as drawn, m
run = begin(__doc__, __file__, quick="fewer snapshots")
young, snapshots = Young(np.arange(2, 32, 2), distance=FAR), 80 if run.quick else 400
d, fine = young.lengths * 1e3, np.linspace(1e-6, 1.25, 500)
scatter = 1 / np.sqrt(2 * young.repeats * snapshots)  # of a visibility, at most
figure, lit, mu = new_figure(10, 7.4), {}, {}
setup, fringes, law = figure.subplot_mosaic("ss;fv", height_ratios=[1, 1.25]).values()
for size, colour in SIZES.items():
    source = ExtendedSource(size, FAR, points=200)
    lit[size] = young.fringes(Coherence(source), LAM * FAR / size, run.device, snapshots)
    mu[size], stated = young.visibility(lit[size]), source.degree(0, d * 1e-3, wavelength=LAM)
    number(f"source of {size * 1e3:g} mm: rms of visibility - mu",
           np.sqrt(np.mean((mu[size] - stated) ** 2)), 0, round(1.4 * scatter, 2))
    for samples in SHOWN if size == SIZE else ():
        at = samples // 2 - 1
        number(f"visibility at d = {d[at]:.2f} mm", mu[size][at], stated[at], round(3 * scatter, 2))
    law.plot(fine, np.abs(source.degree(0, fine * 1e-3, wavelength=LAM)), color=colour, lw=1)
    law.errorbar(d, np.abs(mu[size]), scatter, fmt="o", ms=4, lw=1, color=colour,
                 label=rf"$D_s$ = {size * 1e3:g} mm")
smooth = resample(lit[SIZE] / lit[SIZE].mean(axis=1, keepdims=True), 8 * young.columns, axis=1)
x = (np.arange(8 * young.columns) / 8 / young.columns - 0.5) * young.width * 1e3
for place, samples in enumerate(SHOWN[::-1]):
    at, low = samples // 2 - 1, 2.4 * place
    fringes.fill_between(x, low, low + smooth[at], where=abs(x) < 2, color=BLUE, alpha=0.35, lw=0)
    fringes.text(2.15, low + 1, f"d = {d[at]:.2f} mm\n$\\mu$ = {mu[SIZE][at]:.2f}", va="center")
fringes.set(xlim=(-2, 3.2), xlabel="x on the screen / mm", xticks=range(-2, 3), yticks=[],
            ylabel="intensity", title=rf"fringes measured, $D_s$ = {SIZE * 1e3:g} mm")
law.set(xlabel="separation d of the pinholes / mm", xlim=(0, 1.25), ylim=(0, 1.05),
        title=r"visibility; lines: |$\mu$| = |2 J$_1$(v)/v|, v = $\pi D_s d/(\lambda z)$")
law.legend()
z, at, up, edge = np.linspace(0, FAR, 40 if run.quick else 400), PAIR // 2 - 1, x[-1], SIZE * 500
hole, light = d[at] / 2, young.between(PAIR, mu[SIZE][at], z[1:], run.device)
for values, start, end in ((light, 0, FAR), (smooth[[at]], FAR, FAR + DEEP)):
    setup.imshow(values.T, extent=(start, end, -up, up), cmap=LIGHT, origin="lower", vmin=0)
for side, colour in ((-edge, "#56b4e9"), (edge, "#009e73")):
    setup.plot([0, -FAR, 0], [-hole, side, hole], color=colour, lw=0.8)
setup.vlines([-FAR, FAR], [-edge, -up], [edge, up], color="w", lw=[5, 1])
setup.vlines([0, 0, 0], [-up, 0.03 - hole, hole + 0.03], [-hole - 0.03, hole - 0.03, up],
             color="0.75", lw=3)
for at, height, words in ((-0.37, 0.4, f"source, $D_s$ = {SIZE * 1e3:g} mm"), (0.49, 1.7, "screen"),
                          (-0.02, 1.7, f"pinholes, d = {2 * hole:.2f} mm")):
    setup.text(at, height, words, color="w", ha="right")
setup.set(xlim=(-0.53, FAR + DEEP), ylim=(-2, 2), xlabel="z / m", ylabel="x / mm", facecolor="k",
          aspect="auto", title="intensity over each plane's highest; lines from source to pinholes")
run.save(figure)
