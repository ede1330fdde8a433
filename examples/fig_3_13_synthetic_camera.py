"""Figure 3.13: a synthetic camera, focused on an object that the real one blurs."""

import numpy as np
from common import BLUE, RED, begin, number
from drawing import new_figure
from rays import distance, draw_camera, image, names, note, planes, say_scale, stage
from slices import camera, span

from clplen import OpticalSystem
from clplen.plot import rays_through
from clplen.wave import Lens

DZ, Y0 = -50e-3, -0.6e-3  # the object is nearer than the focused plane

run = begin(__doc__, __file__)
cam = camera(run)
D, F, z = cam.aperture_diameter, cam.image_distance, cam.object_distance + DZ
alpha = cam.alpha(DZ)
f_new = 1 / (1 / z + 1 / F)  # of the main lens that focuses the object on the array
meeting, virtual = (rays_through(OpticalSystem([z, Lens(f, diameter=D), 0.4])).images[0].z - z
                    for f in (cam.focal_length, f_new))
number("the real lens focuses the object at F' / mm", meeting * 1e3, 325.7143, 1e-4)
number("the synthetic one focuses it on the array / mm", virtual * 1e3, 240.0, 1e-4)
number("its focal length / mm", f_new * 1e3, 106.0465, 1e-4)
u = np.array([-0.5, 0.5]) * D
end, X = image(cam, (Y0, DZ))
hits = u + (X - u) * F / end
wide = np.ptp(hits)
number("range Dx of its light on the array / mm", wide * 1e3, 0.9474, 1e-4)

figure = new_figure(10, 4.3)
axes = figure.subplots()
start, _, array, _ = planes(cam, DZ) * 1e3
stage(axes, (start - 14, end * 1e3 + 14), (-2.6, 2.6))
draw_camera(axes, cam, pixels=False)
axes.fill([0, 0, F * 1e3, F * 1e3], [*u * 1e3, *hits[::-1] * 1e3], color=BLUE, alpha=0.1, lw=0)
for top, hit in zip(u * 1e3, hits * 1e3, strict=True):
    axes.plot([start, 0, F * 1e3, end * 1e3], [Y0 * 1e3, top, hit, X * 1e3], color=BLUE, lw=1.2)
    axes.plot([0, F * 1e3], [top, X * F / end * 1e3], color=RED, lw=1.2, ls="--")
axes.plot([start, end * 1e3], [Y0 * 1e3, X * 1e3], "o", color=BLUE, ms=5, zorder=7)
axes.plot(F * 1e3, X * F / end * 1e3, "o", color=RED, ms=5, zorder=7)
axes.vlines(end * 1e3, -2.4, 2.4, color=RED, lw=1.6, ls=(0, (4, 2)))
t = np.linspace(-1, 1, 41)
axes.plot(np.r_[7 * (1 - t**2), -7 * (1 - t[::-1] ** 2)], np.r_[t, t[::-1]] * D * 500, "--",
          color=RED, lw=1.3, zorder=5)
span(axes, (-11, u[0] * 1e3), (-11, u[1] * 1e3), r"$\Delta u$ = D", aside=(-4, 20), ha="right")
span(axes, (F * 1e3 - 5, hits[0] * 1e3), (F * 1e3 - 5, hits[1] * 1e3), r"$\Delta x$",
     aside=(-5, -14), ha="right", va="center")
note(axes, F * 1e3 + 16, -1.6, "sensor", ha="left")
names(axes, {start: "object", 0: "main lens and\nsynthetic lens (dashed)", F * 1e3: "array, F",
             end * 1e3: "synthetic plane, F'"})
distance(axes, 0, F * 1e3, f"F = {F * 1e3:.0f} mm")
distance(axes, 0, end * 1e3, f"F' = F/$\\alpha$ = {end * 1e3:.1f} mm", row=0.09)
distance(axes, start, 0, f"{z * 1e3:.0f} mm")
say_scale(figure, axes, "blue: the real camera; red: the synthetic one")
run.save(figure)
