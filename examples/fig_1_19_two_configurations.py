"""Figure 1.19: plenoptic cameras 2.0, Keplerian (m > 0) and Galilean (m < 0)."""

import numpy as np
import rays
from common import BLUE, begin, number
from drawing import new_figure

MAGNIFICATIONS = {"Keplerian": 0.4, "Galilean": -0.3}
PLACE = -0.05e-3  # of the second point's main image

run = begin(__doc__, __file__)
figure = new_figure(10, 6.6)
panels = figure.subplots(2, 1)
for axes, (name, m) in zip(panels, MAGNIFICATIONS.items(), strict=True):
    camera = rays.focused(run, m, match="pupil", pixels=4)
    rays.stage(axes, (-33, 58), (-0.36, 0.36))
    rays.draw_camera(axes, camera)
    for x0, colour in ((0.0, BLUE), (-PLACE, rays.PURPLE)):
        point, D = (x0, 0.0), camera.aperture_diameter
        u = np.sort(np.concatenate([rays.through(camera, point, np.arange(11), at)
                                    for at in (-20e-6, 20e-6)]))
        u = u[np.abs(u) <= D / 2]
        hits = rays.draw_rays(axes, camera, point, u, colour, lw=0.9)
        if m < 0:
            rays.go_on(axes, camera, point, u, colour)
        c = rays.centres(camera)[np.abs(hits[2][:, None] - rays.centres(camera)).argmin(axis=1)]
        worst = np.abs(hits[3] - (c + m * (c - rays.image(camera, point)[1]))).max()
        number(f"{name}: spots from x + m (x - X), at most / um", worst * 1e6, 0, 1e-3, ".3f")
    lens, array, sensor = rays.planes(camera)[1:] * 1e3
    F = camera.image_distance * 1e3
    rays.mark_plane(axes, F, 0.3)
    rays.names(axes, {-F: "focused plane", lens: "main lens", array - 0.8: "array",
                      sensor + 1: "sensor",
                      F: "main image" if m > 0 else "main image,\nvirtual object"})
    rays.mark_plane(axes, -F, 0.3)
    a, b = camera.a * 1e3, camera.b * 1e3
    rays.distance(axes, 0, F, f"F = {F:.0f} mm", 0.14 if m < 0 else 0)
    rays.distance(axes, min(F, array), max(F, array), f"a = {a:.1f} mm")
    rays.distance(axes, array, sensor, rf"b = {b:.1f} mm {'>' if b > 5 else '<'} $f_\mu$",
             0 if m > 0 else 0.07)
    number(f"{name}: 1/a + 1/b - 1/f_mu, times f_mu", 5 / a + 5 / b - 1, 0, 1e-9)
    axes.set_title(f"{name}, m = {m:g}", loc="left", weight="bold", pad=22)
rays.say_scale(figure, panels[0], "dotted: as if there were no array")
run.save(figure)
