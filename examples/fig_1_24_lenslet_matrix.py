"""Figure 1.24: a lenslet as a matrix, from the main image to the sensor."""

import numpy as np
import rays
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import new_figure
from matplotlib.patches import Polygon

M = 0.4
BOX = np.array([[-20, -1.4], [20, -1.4], [20, 1.4], [-20, 1.4]])  # um and mrad
POINTS = {-30e-6: BLUE, 30e-6: RED}  # x in metres

run = begin(__doc__, __file__)
camera = rays.focused(run, M)
a, b, f = camera.a, camera.b, camera.mla.f
matrix = camera.ray_matrix()
space = [np.array([[1, length], [0, 1]]) for length in (a, b)]
product = space[1] @ np.array([[1, 0], [-1 / f, 1]]) @ space[0]
closed = np.array([[-M, 0], [-1 / f, -1 / M]])
for (i, k), name in np.ndenumerate(np.array([["A", "B"], ["C", "D"]])):
    number(f"{name}{' / (1/m)' if name == 'C' else ' / m' if name == 'B' else ''}", matrix[i, k],
           closed[i, k] + 0.0, 1e-9)
number("determinant", np.linalg.det(matrix), 1, 1e-9)
number("entries from b after lens after a, at most", np.abs(matrix - product).max(), 0, 1e-9)

figure = new_figure(11, 4.6)
left, right = figure.subplots(1, 2, width_ratios=[1.45, 1])
z = np.array([-a, 0, b]) * 1e3
rays.stage(left, (z[0] - 2, z[2] + 2), (-0.085, 0.085))
rays.draw_lens(left, 0, 0, camera.mla.diameter * 500, 0.012)
for at in (z[0], z[2]):
    rays.mark_plane(left, at, 0.08)
for x, colour in POINTS.items():
    for hit in (-22e-6, 0, 22e-6):
        start = np.array([x, (hit - x) / a])
        end = matrix @ start
        left.plot(z, np.array([x, hit, end[0]]) * 1e3, color=colour, lw=1.2)
    rays.note(left, z[0] - 0.4, x * 1e3, "x", ha="right", color=colour)
    rays.note(left, z[2] + 0.4, end[0] * 1e3, "x' = \u2212m x", ha="left", color=colour)
rays.names(left, {z[0]: r"main image: $(x, \theta)$", 0: "lenslet",
                  z[2]: r"sensor: $(x', \theta')$"})
rays.distance(left, z[0], 0, f"a = {a * 1e3:.1f} mm")
rays.distance(left, 0, z[2], f"b = {b * 1e3:.0f} mm")
rays.note(left, -9, -0.062, "$x' = -m\\,x$\n" r"$\theta' = -x/f_\mu - \theta/m$",
          size=10, ha="center")
units = np.array([1e-6, 1e-3])
image = (matrix @ (BOX * units).T).T / units
for corners, colour, text in ((BOX, GREEN, "main image"), (image, ORANGE, "sensor")):
    right.add_patch(Polygon(corners, fc=colour, alpha=0.4, ec=colour, lw=1.5, label=text))
    size = abs(np.linalg.det(corners[1:3] - corners[0]))
    number(f"area of the box, {text} / (um mrad)", size, 40 * 2.8, 1e-6, ".3f")
right.legend(loc="upper right")
left.set_ylabel("x from the axis of the lenslet / mm")
right.grid(color="0.9")
right.set(xlabel="x / um", ylabel=r"$\theta$ / mrad", xlim=(-26, 26), ylim=(-9, 9),
          title="a box of phase space before and after: equal areas")
rays.say_scale(figure, left, where="left:")
run.save(figure)
