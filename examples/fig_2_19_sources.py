"""Figure 2.19: light of an array of sources, each of a random phase, becomes a phase mask."""

import numpy as np
from closed import LAM
from coherent import WINDOW, intensity, phase_bar, show_phase, show_points, snapshot, sources
from common import BLUE, RED, begin, number
from drawing import LIGHT, bar, new_figure

from clplen import Grid
from clplen.wave import RandomPhaseMask

CELLS, N = 10, 500  # sources and samples a side
CONTRASTS = {0: 0, 0.1: 0.62, 0.25: 0.81, 0.5: 1.03, 1: 0.79, 2: 0.944, 4: 0.985, 8: 0.998}
BINS, TICKS = np.linspace(-np.pi, np.pi, 17), (-10, -5, 0, 5, 10)

run = begin(__doc__, __file__, quick="fewer planes, fewer snapshots")
grid, p = Grid((N, N), WINDOW / N), WINDOW / CELLS
d_c = 4 * p**2 / LAM
number("10 sources: d_c = 4 p^2/lam / m", d_c, 29.0909, 1e-4)
phases = np.angle([sources(200, run.device)])
number("200 sources: rms phase / rad", np.sqrt(np.mean(phases**2)), np.pi / np.sqrt(3), 0.02)
figure = new_figure(12, 6)
(a, b, c), (d, e, f) = figure.subplots(2, 3, width_ratios=[1, 1.6, 1.1], height_ratios=[1.3, 1])
show_points(a, sources(CELLS, run.device), WINDOW, 28)
z = np.linspace(0, d_c, 25 if run.quick else 161)
planes = [snapshot(RandomPhaseMask(p, distance=at, jitter=False), grid, run.device) for at in z]
cut = np.abs([u[:, N // 2 + N // CELLS // 2] for u in planes]) ** 2
drawn = b.imshow(cut.T, extent=(0, d_c, -WINDOW * 500, WINDOW * 500), cmap=LIGHT, origin="lower",
                 aspect="auto", vmin=0, vmax=4)
phase_bar(figure, show_phase(c, planes[-1], grid), c, shrink=0.9)
bar(figure, drawn, b, "intensity / mean", extend="max")

masks, between = (4, np.geomspace(0.02, 8, 9)) if run.quick else (16, np.geomspace(0.02, 8, 49))
e.plot(between, [intensity(times, run.device, 4).std() for times in between], color=RED, lw=1)
for times, reference in CONTRASTS.items():
    contrast = intensity(times, run.device, masks).std()
    number(f"contrast at {times:g} p^2/lam", contrast, reference, 0.03, ".3f")
    e.plot(times, reference, "o", color="0.75", ms=9, zorder=0)
    e.plot(times, contrast, "o", color=RED, ms=4)
d.hist(phases.ravel(), BINS, density=True, color=BLUE, alpha=0.6)
d.axhline(0.5 / np.pi, color="k", lw=1)
d.set(title="phases of 200 x 200 sources", xlabel="phase / rad", ylabel="density / rad$^{-1}$",
      ylim=(0, 0.2), xticks=(-np.pi, 0, np.pi), xticklabels=("-π", "0", "π"))
e.set(title="contrast of the intensity; grey: independent float64 simulation", ylim=(-0.04, 1.1),
      xlabel=r"distance / ($p^2/\lambda$)", ylabel="standard deviation / mean")
e.axvspan(4, 8.4, color=BLUE, alpha=0.1, lw=0)
e.text(6.2, 0.15, r"$d_c \geq 4 p^2/\lambda$: speckle", ha="center")
even = np.linspace(0, 8, 33)
f.hist(intensity(8, run.device, masks).ravel(), even, density=True, color=BLUE, alpha=0.6, log=True)
f.plot(even, np.exp(-even), color="k", lw=1)
f.set(title="intensity at 8 $p^2/\\lambda$; line: exp(-I)", xlabel="intensity I / mean",
      ylabel="density", xlim=(0, 8), ylim=(3e-4, 1.5))
for axes in (a, b, c):
    axes.set(ylabel="y / mm", yticks=TICKS, xlabel="z / m" if axes is b else "x / mm")
a.set_title(f"{CELLS} x {CELLS} sources, p = {p * 1e3:g} mm")
b.set_title("light on its way, behind a column of sources")
c.set_title(f"phase at $d_c$ = {d_c:.1f} m")
run.save(figure)
