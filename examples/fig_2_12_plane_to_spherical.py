"""Figure 2.12: a lens makes a plane wave spherical; radii measured from the field."""

import numpy as np
from common import BLUE, GREEN, RED, begin, number
from drawing import LIGHT, bar, new_figure

from clplen import Field, Grid, propagate, thin_lens

W, LAM, PITCH, N, F = 0.9e-3, 550e-9, 6.6e-6, 756, 0.12  # F: of the beam that is drawn
BEAMS = {0.06: (BLUE, 30.0101), 0.12: (GREEN, 60.0808), 0.24: (RED, 120.6475)}  # f: R(f/2) / mm
PLACES = np.array([0, 0.25, 0.5, 0.75, 0.9, 0.95, 1.05, 1.1, 1.25, 1.5, 1.75, 2])  # z/f


def radius(u: np.ndarray) -> float:
    """Radius of a wave (positive: converging) from its phase steps along x, by least squares."""
    steps, middles = u[:, 1:] * np.conj(u[:, :-1]), grid.x[1:] - PITCH / 2
    slope = (np.abs(steps) * middles * np.angle(steps)).sum() / (np.abs(steps) * middles**2).sum()
    return -2 * np.pi * PITCH / (LAM * slope)


def gaussian(f: float, z: np.ndarray) -> np.ndarray:
    """Radius of a Gaussian beam behind the lens, by its complex parameter q."""
    return -1 / (1 / (1 / (-1 / f + 1j * LAM / (np.pi * W**2)) + z)).real


run = begin(__doc__, __file__)
grid = Grid((N, N), PITCH)
u = np.exp(-(grid.x**2 + grid.y[:, None] ** 2) / W**2)  # a plane wave with soft edges
plane = Field.from_array(u, grid, wavelength=LAM, device=run.device)
figure, fine = new_figure(10, 5.4), np.linspace(0, 2, 801)
left, above, below = figure.subplot_mosaic("ab;ac", height_ratios=[1.5, 1]).values()
for f, (colour, half) in BEAMS.items():
    R = np.array([radius(propagate(thin_lens(plane, f), z).to_numpy()) for z in PLACES * f])
    over = (R - gaussian(f, PLACES * f)) * 1e6
    number(f"f = {f * 1e3:g} mm: radius at the lens / mm", R[0] * 1e3, f * 1e3, 1e-3)
    number(f"f = {f * 1e3:g} mm: radius at z = f/2 / mm", R[2] * 1e3, half, 5e-3)
    number(f"f = {f * 1e3:g} mm: beyond the Gaussian beam / um", over[2], -W**2 / f * 2.5e5, 0.05)
    above.plot(fine, gaussian(f, fine * f) / f, color=colour, lw=1)
    above.plot(PLACES, R / f, "o", color=colour, ms=4, label=f"f = {f * 1e3:g} mm")
    below.plot(PLACES, over, "o", fine, -fine * W**2 / f * 5e5, color=colour, ms=4, lw=1)
above.plot(fine, 1 - fine, color="0.85", lw=5, zorder=0, label="f - z")
above.legend()
above.set(ylim=(-1.1, 1.1), xlabel="z/f", ylabel="R/f", title="radius R measured; lines: Gaussian")
below.text(0, -13, "lines: by rays; near the focus\ndiffraction sets the radius")
below.set(xlabel="z/f", ylabel="points - lines above / µm", title=r"lines: $-z w^2/(2 f^2)$")
planes, x = 24 if run.quick else 96, grid.x * 1e3
z, lens = np.append(-F / 4, np.arange(planes) * 1.5 * F / planes), thin_lens(plane, F)
rows = [u[N // 2], *(propagate(lens, place, pad=1).to_numpy()[N // 2] for place in z[1:])]
drawn = left.pcolormesh(z * 1e3, x, np.abs(rows).T ** 2, cmap=LIGHT, norm="log", vmin=1e-3,
                        vmax=1e3, shading="gouraud")
bar(figure, drawn, left, "intensity (logarithmic)", extend="min")
left.vlines((-22, -15, -8), -1.5, 1.5, color="w", lw=1)
for place, row in list(zip(z, rows, strict=True))[1 :: planes // 8]:
    lit = np.abs(row) > 0.06 * np.abs(row).max()
    ahead = -np.unwrap(np.angle(row[lit])) * LAM / (2 * np.pi) * 1000
    left.plot((place + ahead - ahead[lit.sum() // 2]) * 1e3, x[lit], color="w", lw=1)
left.set(xlabel="z behind the lens / mm", ylabel="x / mm", ylim=(-1.8, 1.8),
         title="f = 120 mm; wavefronts drawn 1000 times deeper")
run.save(figure)
