"""Figure 1.7: each ray has the number x of its lenslet and the number u of its pixel."""

import numpy as np
import rays
from common import BLUE, GREEN, PAPER, RED, begin, number
from drawing import new_figure

POINTS = {"A": 7, "B": 3}  # their lenslets
COLOURS = {"green": GREEN, "red": RED, "blue": BLUE}  # pixels 1, 2, 3

run = begin(__doc__, __file__)
camera = rays.standard(run)
F, z = camera.image_distance, rays.planes(camera) * 1e3
step = camera.pixel_pitch * F / camera.sensor_distance
u = np.array([1, 0, -1]) * step

figure = new_figure(10, 4.6)
left, right = figure.subplots(1, 2, width_ratios=[2.3, 1])
rays.stage(left, (-32, 40), (-0.34, 0.34))
rays.draw_camera(left, camera)
rows = []
for name, lenslet in POINTS.items():
    point = (-rays.centres(camera)[lenslet] * camera.object_distance / F, 0.0)
    left.plot(z[0], point[0] * 1e3, "ko", ms=5, zorder=6)
    rays.note(left, z[0] - 0.8, point[0] * 1e3, name, ha="right", weight="bold")
    style = {"ls": "-" if name == "A" else (0, (5, 2)), "lw": 1.4}
    hits = rays.draw_rays(left, camera, point, u, COLOURS.values(), **style)
    x = np.rint(hits[2] / camera.mla.pitch).astype(int) + 5
    for n, (s, colour) in enumerate(zip(hits[3], COLOURS.values(), strict=True)):
        first = camera.grid.shape[1] // 2 + 3 * (x[n] - 5) - 2  # before the sub-image
        pixel = rays.light_pixel(left, camera, s, colour) - first
        rows.append((name, tuple(COLOURS)[n], f"{x[n]}", f"{pixel}"))
        number(f"{name}, {rows[-1][1]}: 10 x + u", 10 * x[n] + pixel, 10 * lenslet + n + 1, 0,
               ".0f")
for lenslet, c in enumerate(rays.centres(camera)[1:-1] * 1e3, 1):
    rays.note(left, z[2] - 1, c, f"{lenslet}", ha="right", size=7,
              bbox=PAPER | {"alpha": 1, "pad": 0.8})
rays.names(left, {z[0]: "focused plane", z[1]: "main lens", z[2]: "array", z[3]: "sensor"})
rays.distance(left, z[0], z[1], f"2f = {z[1] - z[0]:.0f} mm")
rays.distance(left, z[1], z[2], f"2f = {z[2]:.0f} mm")
right.set_axis_off()
table = right.table([[name, colour, x, u] for name, colour, x, u in rows], loc="center",
                    colLabels=("point", "ray", "x, lenslet", "u, pixel"), cellLoc="center",
                    colWidths=[0.2, 0.25, 0.28, 0.27])
table.auto_set_font_size(False)
table.set_fontsize(9)
table.scale(1, 1.8)
for (row, column), cell in table.get_celld().items():
    cell.set_edgecolor("0.8")
    if row and column == 1:
        cell.get_text().set_color(COLOURS[rows[row - 1][1]])
rays.say_scale(figure, left, "pixels of a sub-image are counted upwards from 1")
run.save(figure)
