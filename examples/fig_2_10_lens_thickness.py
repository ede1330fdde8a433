"""Figure 2.10: thickness of a lens across x, and its phase against the paraxial one."""

import numpy as np
from common import BLUE, ORANGE, RED, begin, number
from drawing import new_figure

from clplen import Field, Grid, thin_lens

F, D, INDEX, LAM, PITCH = 0.12, 3.6e-3, 1.5, 550e-9, 6e-6
LENSES = {"biconvex": (0.12, -0.12, BLUE, 3), "plano-convex": (0.06, np.inf, RED, 1)}  # R1, R2
THICKNESS = {"biconvex": 27.0015, "plano-convex": 27.0061}  # to the term in r^4, um
BEYOND = {"biconvex": -8.675, "plano-convex": -34.700}  # phase of that term at the rim, mrad
TURN = 2 * np.pi
K = TURN / LAM


def sag(r: np.ndarray, R: float) -> np.ndarray:
    """Depth of a sphere, R (1 - sqrt(1 - r^2/R^2)); Goodman (2005), section 5.1."""
    return r**2 / R / (1 + np.sqrt(1 - (r / R) ** 2))


run = begin(__doc__, __file__)
grid = Grid((1, 601), PITCH)
plane = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=run.device)
made = np.unwrap(np.angle(thin_lens(plane, F).to_numpy()[0]))
made -= made[300]
x, mm, paraxial = grid.x, grid.x * 1e3, -K * grid.x**2 / (2 * F)
number("thin_lens: phase at the rim / rad", made[0], -154.2236, 1e-3)

figure = new_figure(9, 5.6)
panels = figure.subplot_mosaic("ac;bd", width_ratios=[1, 1.25])
for panel, (name, (R1, R2, colour, width)) in zip("ab", LENSES.items(), strict=True):
    front, back = sag(x, R1), -sag(x, R2)  # glass that each face takes away
    delta = (front + back)[0] - front - back  # Delta; 0 at the rim
    beyond = K * (INDEX - 1) * (delta - delta[300]) - paraxial
    number(f"{name}: f / mm", 1e3 / (INDEX - 1) / (1 / R1 - 1 / R2), 120.0, 1e-9)
    number(f"{name}: thickness at the centre / um", delta[300] * 1e6, THICKNESS[name], 1e-4)
    number(f"{name}: phase beyond paraxial / mrad", beyond[0] * 1e3, BEYOND[name], 0.02, ".3f")
    left, right = (front - front[0]) * 1e6, (back[0] - back) * 1e6  # faces
    axes = panels[panel]
    axes.fill_betweenx(mm, left, right, color=colour, alpha=0.25, lw=0)
    axes.plot(left, mm, right, mm, color=colour)
    axes.annotate("", (left[400], 0.6), (right[400], 0.6),
                  arrowprops={"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0})
    axes.text((left + right)[400] / 2, 0.68, rf"$\Delta$ = {delta[400] * 1e6:.1f} µm", ha="center")
    axes.set(xlim=(-36, 24), ylim=(-2, 2), xlabel="z / µm", ylabel="x / mm",
             title=f"{name}: R1, R2 = {R1 * 1e3:g}, {R2 * 1e3:g} mm".replace("inf", r"$\infty$"))
    panels["c"].plot(mm, paraxial + beyond, color=colour, lw=width, label=f"exact, {name}")
    panels["d"].plot(mm, beyond * 1e3, color=colour, label=name)
panels["c"].plot(mm, paraxial, color="0.8", lw=8, zorder=0, label=r"paraxial, $-k r^2/(2f)$")
panels["c"].plot(mm[::20], made[::20], "o", color=ORANGE, ms=2.5, label="clplen.thin_lens")
panels["c"].set(xlabel="x / mm", ylabel="phase / rad", title="f = 120 mm, n = 1.5, 550 nm")
panels["d"].set(xlabel="x / mm", ylabel="phase difference / mrad", title="exact - paraxial phase")
for panel in "cd":
    panels[panel].grid(color="0.9", lw=0.6)
    panels[panel].legend(loc="lower center")
waves = panels["d"].secondary_yaxis("right", functions=(lambda a: a / TURN, lambda b: b * TURN))
waves.set_ylabel("thousandths of a wavelength")
run.save(figure)
