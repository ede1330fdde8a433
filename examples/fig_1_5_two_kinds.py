"""Figure 1.5: the plenoptic cameras 1.0 and 2.0, their main lens focused at infinity."""

import numpy as np
import rays
from common import BLUE, RED, begin, number
from drawing import new_figure

TILT = 2.2e-3  # rad, of the second bundle

run = begin(__doc__, __file__)
first = rays.standard(run, distant=True)
second = rays.focused(run, 0.4, focal_length=30e-3, object_distance=rays.FAR, match="pupil",
                 pixels=3)
seen = {}
figure = new_figure(9, 6.2)
panels = figure.subplots(2, 1)
for axes, camera in zip(panels, (first, second), strict=True):
    rays.stage(axes, (-9, 57), (-0.36, 0.36))
    rays.draw_camera(axes, camera)
    D = camera.aperture_diameter
    for x0, colour in ((0.0, BLUE), (-TILT * rays.FAR, RED)):
        u = np.linspace(-D / 2, D / 2, 7) * 0.999
        if camera is second:  # by the middle of each lenslet, where two rays lie side by side
            u = np.concatenate([rays.through(camera, (x0, 0.0), np.arange(11), at)
                                for at in (-12e-6, 12e-6)])
            u = np.sort(u[np.abs(u) <= D / 2])
        seen[camera is second, colour] = rays.draw_rays(axes, camera, (x0, 0.0), u, colour, lw=0.9)
    lens, array, sensor = rays.planes(camera)[1:] * 1e3
    rays.names(axes, {lens: "main lens", array: "array", sensor: "sensor"})
f, f_mu = first.focal_length * 1e3, first.mla.f * 1e3
number("1.0: place of the tilted bundle on the array / um",
       seen[False, RED][2].mean() * 1e6, TILT * f * 1e3, 0.02, ".2f")
rays.distance(panels[0], 0, f, f"f = {f:.0f} mm")
rays.distance(panels[0], f, f + f_mu, rf"$f_\mu$ = {f_mu:.0f} mm", 0.07)
z = rays.image(second, (0.0, 0.0))[0] * 1e3
a, b = second.a * 1e3, second.b * 1e3
rays.mark_plane(panels[1], z, 0.3)
rays.names(panels[1], {z: "main image"})
number("2.0: 1/a + 1/b, times f_mu", f_mu / a + f_mu / b, 1, 1e-9)
number("2.0: m = b/a", b / a, 0.4, 1e-9)
rays.distance(panels[1], 0, z, f"f = {f:.0f} mm")
rays.distance(panels[1], z, z + a, f"a = {a:.1f} mm")
rays.distance(panels[1], z + a, z + a + b, f"b = {b:.0f} mm")
panels[0].set_title("plenoptic camera 1.0", loc="left", fontweight="bold", pad=20)
panels[1].set_title("plenoptic camera 2.0", loc="left", fontweight="bold", pad=20)
rays.say_scale(figure, panels[0], "blue, red: two distant points")
run.save(figure)
