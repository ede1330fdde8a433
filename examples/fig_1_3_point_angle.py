"""Figure 1.3: a ray by the point in which it meets one plane, and its two angles with the axis."""

import numpy as np
import rays
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import new_figure

LENSLETS = (3, 8)  # of x and y
LENS = (0.12e-3, -0.06e-3)  # (u, v) in metres

run = begin(__doc__, __file__)
camera = rays.standard(run)
F, f_mu = camera.image_distance, camera.sensor_distance
z = rays.planes(camera)[2] * 1e3
place = rays.centres(camera)[list(LENSLETS)]
theta = (place - LENS) / F
for name, x, u, angle in zip("xy", place, LENS, theta, strict=True):
    ray = rays.trace(camera, (-x * camera.object_distance / F, 0.0), u)[:, 0]
    number(f"theta_{name} from the pixel, (s - {name})/f_mu / mrad", (ray[3] - ray[2]) / f_mu * 1e3,
           angle * 1e3, 1e-3, ".3f")
number("angle of one pixel, dx/f_mu / mrad", camera.pixel_pitch / f_mu * 1e3, 20 / 5, 1e-9, ".3f")

figure = new_figure(9, 4.6)
axes = figure.subplots()
rays.space(axes, (-3, z + 5))
rays.plane_in_space(axes, z, 0.26, GREEN)
rays.plane_in_space(axes, 0, 0.2, "0.6")
(x, y), (u, v) = place * 1e3, np.array(LENS) * 1e3
axes.plot(*rays.in_space([0, z], [u, x], [v, y]), color=RED, lw=2.2)
axes.plot(*rays.in_space([0, z], x, y), color="0.3", lw=1, ls="--")
axes.plot(*rays.in_space([0, z], [u, x], y), color=BLUE, lw=1.3)
axes.plot(*rays.in_space([0, z], x, [v, y]), color=ORANGE, lw=1.3)
axes.fill(*rays.in_space([0, z, 0], [u, x, x], y), color=BLUE, alpha=0.12)
axes.fill(*rays.in_space([0, z, 0], x, [v, y, y]), color=ORANGE, alpha=0.15)
axes.plot(*rays.in_space(0, [u, x, x, u, u], [v, v, y, y, v]), color="0.5", lw=0.8, ls=":")
axes.plot(*rays.in_space(z, [x, x, 0], [0, y, y]), color=GREEN, lw=1.4, ls=":")
axes.plot(*rays.in_space(z, x, y), "o", color=GREEN, ms=8, mec="k", mew=0.6)
axes.plot(*rays.in_space(0, u, v), "o", color="0.6", ms=6, mec="k", mew=0.6)
back, share = 0.55 * z, np.linspace(0, 1, 2)  # where the angles are marked, before the array
axes.plot(*rays.in_space(z - back, x - share * theta[0] * back, y), color=BLUE, lw=1.3)
axes.plot(*rays.in_space(z - back, x, y - share * theta[1] * back), color=ORANGE, lw=1.3)
rays.note(axes, *rays.in_space(z - back - 1, x - theta[0] * back * 0.6, y),
     rf"$\theta_x$ = {theta[0] * 1e3:.2f} mrad", color=BLUE, ha="right")
rays.note(axes, *rays.in_space(z - back - 0.5, x, y - theta[1] * back * 0.72),
     rf"$\theta_y$ = {theta[1] * 1e3:.2f} mrad", color=ORANGE, ha="right")
axes.text(z, 1.42 * rays.LARGER * 0.26,
          f"array of lenslets\n(x, y) = ({x * 1e3:.1f}, {y * 1e3:.1f}) um", color=GREEN,
          ha="center", va="bottom")
axes.text(0, 1.42 * rays.LARGER * 0.2, f"main lens\n(u, v) = ({u * 1e3:.0f}, {v * 1e3:.0f}) um",
          color="0.3", ha="center", va="bottom")
axes.text(*rays.in_space(z / 2, 0.1, -0.3), f"F = {z:.0f} mm", ha="center")
figure.supxlabel(r"red: the ray; dashed: parallel to the optical axis; $\theta$ = (x - u)/F, "
                 r"(y - v)/F; drawn to scale, heights "
                 f"{rays.LARGER:.0f} times larger than lengths")
run.save(figure)
