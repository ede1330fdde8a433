"""Figure 2.11: phase of a lens between -pi and pi, as its samples hold it."""

import numpy as np
from common import BLUE, RED, begin, number
from drawing import new_figure
from matplotlib.patches import Rectangle

from clplen import Field, Grid, aperture, thin_lens

F, D, LAM, PITCH, N = 0.12, 3.6e-3, 550e-9, 6.6e-6, 606
RIM = (1.52, 1.88, -0.18, 0.18)  # mm, the magnified part: x, then y
TICKS = (-np.pi, 0, np.pi), (r"$-\pi$", "0", r"$\pi$")

run = begin(__doc__, __file__)
grid = Grid((N, N), PITCH)
plane = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=run.device)
lens = thin_lens(plane, F)
inside = np.abs(aperture(lens, D).to_numpy()) > 0.5
phase = np.angle(lens.to_numpy())

x, cut = grid.x[N // 2 :], phase[N // 2, N // 2 :]
turns = -np.unwrap(cut) / (2 * np.pi)
rings = np.arange(1, 25)  # where the phase is a whole number of turns
radii = np.sqrt(np.interp(rings, turns, x**2))
number("rings from the centre to the rim", np.interp(D**2 / 4, x**2, turns), 24.5455, 1e-3)
number("radius of ring 24 / mm", radii[-1] * 1e3, 1.7799, 1e-4)
number("from ring 23 to ring 24 / um", np.diff(radii)[-1] * 1e6, 37.4759, 0.005)

figure = new_figure(9.6, 7.8)
panels = figure.subplot_mosaic("ab;cc", height_ratios=[2.2, 1], width_ratios=[1.35, 1])
edges = np.array([-N / 2 - 0.5, N / 2 - 0.5]) * PITCH * 1e3  # sample N/2 lies at 0
for panel, how in (("a", "hanning"), ("b", "nearest")):
    drawn = panels[panel].imshow(
        np.where(inside, phase, np.nan), cmap="twilight", vmin=-np.pi, vmax=np.pi, origin="lower",
        extent=(*edges, *edges), interpolation=how, interpolation_stage="rgba")
    panels[panel].set(xlabel="x / mm", ylabel="y / mm")
panels["a"].set(xlim=(-2, 2), ylim=(-2, 2), title="f = 120 mm, D = 3.6 mm, 550 nm")
panels["b"].set(xlim=RIM[:2], ylim=RIM[2:], title="at the rim: samples of 6.6 µm")
panels["a"].add_patch(Rectangle((RIM[0], RIM[2]), 0.36, 0.36, fill=False, color=RED, lw=1.2))
bar = figure.colorbar(drawn, ax=panels["b"], label="phase / rad", location="top", shrink=0.9)
bar.set_ticks(TICKS[0], labels=TICKS[1])

fine = np.linspace(1.2e-3, D / 2, 4001)
wrapped = (-np.pi * fine**2 / (LAM * F) + np.pi) % (2 * np.pi) - np.pi
wrapped[np.abs(np.diff(wrapped, append=wrapped[-1])) > np.pi] = np.nan
axes = panels["c"]
axes.plot(fine * 1e3, wrapped, color=BLUE, lw=1, label=r"$-\pi r^2/(\lambda f)$, wrapped")
axes.plot(x * 1e3, cut, "o", color=RED, ms=3, label="samples of clplen.thin_lens")
for ring, radius in zip(rings, radii * 1e3, strict=True):
    if 1.22 < radius < 1.79:
        axes.text(radius, 3.6, ring, ha="center", fontsize=7)
last = LAM * F / (D / 2)
axes.set(xlim=(1.2, D * 500), ylim=(-4.9, 4.4), xlabel="x / mm", ylabel="phase / rad",
         title=r"cut; ring $m$ at $r^2 = 2 m \lambda f$, spacing at the rim $\lambda f/r$ = "
         f"{last * 1e6:.1f} µm = {last / PITCH:.1f} samples")
axes.set_yticks(*TICKS)
axes.legend(loc="lower center", ncols=2)
run.save(figure)
