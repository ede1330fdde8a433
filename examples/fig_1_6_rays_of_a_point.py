"""Figure 1.6: in a plenoptic camera 1.0 the lenslet tells the place, the pixel the direction."""

import numpy as np
import rays
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import new_figure

COLOURS = (BLUE, GREEN, RED)  # of the directions 1, 2, 3

run = begin(__doc__, __file__)
camera = rays.standard(run)
F, f_mu, p = camera.image_distance, camera.sensor_distance, camera.mla.pitch
u = np.array([1, 0, -1]) * camera.pixel_pitch * F / f_mu  # main lens as pixels 1, 2, 3 see it
place = 7  # the lenslet, counted from 0
point = (-rays.centres(camera)[place] * camera.object_distance / F, 0.0)
z = rays.planes(camera) * 1e3

figure = new_figure(10, 4.6)
left, right = figure.subplots(1, 2, width_ratios=[1.7, 1])
rays.stage(left, (-32, 37), (-0.34, 0.34))
rays.stage(right, (z[2] - 2.2, z[3] + 1), ((place - 5) * 0.06 - 0.1, (place - 5) * 0.06 + 0.09))
for axes in (left, right):
    rays.draw_camera(axes, camera)
    hits = rays.draw_rays(axes, camera, point, u, COLOURS, lw=1.5)
    seen = [rays.light_pixel(axes, camera, s, c) for s, c in zip(hits[3], COLOURS, strict=True)]
first = camera.grid.shape[1] // 2 + 3 * (place - 5) - 1  # pixel 1 of the sub-image
for n, (at, s) in enumerate(zip(seen, hits[3], strict=True), 1):
    number(f"ray {n}: pixel of the sub-image", at - first + 1, n, 0, ".0f")
    rays.note(right, z[3] + 0.3, s * 1e3, f"{n}", color=COLOURS[n - 1], weight="bold", size=10)
    rays.note(left, -3, np.interp(-3, z, hits[:, n - 1] * 1e3) + 0.012,
              rf"$\theta_{n}$", color=COLOURS[n - 1], ha="center", size=10)
number("they part on the sensor by / um", np.diff(hits[3]).mean() * 1e6, 20, 1e-3, ".3f")
for s in ((place - 5.5) * 0.06, (place - 4.5) * 0.06):
    right.axhline(s, color=ORANGE, lw=1, ls="--", zorder=1)
rays.note(right, z[2] + 2.5, (place - 4.5) * 0.06 + 0.006, "sub-image of this lenslet",
          color=ORANGE, ha="center")
left.plot(z[0], point[0] * 1e3, "ko", ms=5, zorder=6)
rays.note(left, z[0] + 1, point[0] * 1e3 - 0.035, "P")
rays.mark_plane(left, z[0], 0.3)
rays.names(left, {z[0]: "focused plane", z[1]: "main lens", z[2]: "array", z[3]: "sensor"})
rays.names(right, {z[2]: "array", z[3]: "sensor"})
rays.distance(left, z[0], z[1], f"2f = {z[1] - z[0]:.0f} mm")
rays.distance(left, z[1], z[2], f"2f = {z[2]:.0f} mm")
rays.distance(right, z[2], z[3], rf"$f_\mu$ = {z[3] - z[2]:.0f} mm")
right.set_ylabel("")
rays.say_scale(figure, left, "right: enlarged", where="left:")
run.save(figure)
