"""Figure 1.10: points in and out of focus as rays, and as lines of phase space."""

import numpy as np
import rays
from common import BLUE, GREEN, RED, begin, mm, number
from drawing import LIGHT, bar, new_figure
from matplotlib.colors import PowerNorm

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources

POINTS = {"A": (-1.1e-3, -60e-3), "B": (0.0, 0.0), "C": (2e-3, 100e-3)}  # (x, dz)
COLOURS = dict(zip(POINTS, (BLUE, GREEN, RED), strict=True))

run = begin(__doc__, __file__)
array = MicrolensArray(150e-6, 10e-3, count=41, fill="full")
camera = PlenopticCamera.type1(focal_length=0.12, mla=array, wavelength=532e-9, device=run.device,
                               pixels_per_lenslet=14)
lf = LightField.from_raw(camera.expose(PointSources([(x, 0, dz) for x, dz in POINTS.values()])))
light = np.maximum(lf.to_numpy().astype(float).sum(axis=(0, 2)), 0)  # (u, x)
u = (np.arange(light.shape[0]) - (light.shape[0] - 1) / 2) * lf.spacing[1]
x = (np.arange(light.shape[1]) - (light.shape[1] - 1) / 2) * lf.spacing[3]

figure = new_figure(11, 5.2)
left, right = figure.subplots(1, 2, width_ratios=[1.35, 1])
rays.stage(left, (-352, 262), (-3.2, 3.2))
rays.draw_camera(left, camera, pixels=False)
ends = camera.aperture_diameter / 2 * np.array([-1, 1])
for name, point in POINTS.items():
    colour, alpha = COLOURS[name], camera.alpha(point[1])
    rays.draw_rays(left, camera, point, np.linspace(*ends, 7) * 0.999, colour, lw=0.8)
    left.plot((-camera.object_distance - point[1]) * 1e3, point[0] * 1e3, "o", color=colour, ms=5)
    low = 0.2 if point[0] > 0 else -0.5
    left.text((-camera.object_distance - point[1]) * 1e3 - 5, point[0] * 1e3 + low,
              f"{name}: {mm(point[1])}", color=colour)
    X = camera.on_array([(point[0], 0, point[1])])[0, 0]
    right.plot((X + ends * (1 - alpha)) * 1e3, ends * 1e3, "c--", lw=1.3)
    right.text((X + ends[1] * (1 - alpha)) * 1e3, 1.93, name, color=colour, ha="center",
               weight="bold", size=10)
    near = np.abs(x - X) < 1e-3
    weight = light[:, near] ** 2 * (np.abs(u) < 0.65 * ends[1])[:, None]
    place = (weight * x[near]).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-30)
    slope = np.polyfit(u, place, 1, w=np.sqrt(weight.sum(axis=1)))[0]
    number(f"{name}, dz = {mm(point[1])}: dx/du", slope, 1 - alpha, 0.06, ".3f")
z = rays.planes(camera) * 1e3
rays.names(left, {z[0]: "focused plane", z[1]: "main lens", z[2]: "array, sensor"})
rays.distance(left, z[0], z[1], f"2f = {-z[0]:.0f} mm")
rays.distance(left, z[1], z[2], f"2f = {z[2]:.0f} mm")
p, du = lf.spacing[3] * 1e3, abs(lf.spacing[1]) * 1e3
edges = (x[0] * 1e3 - p / 2, x[-1] * 1e3 + p / 2, u[-1] * 1e3 - du / 2, u[0] * 1e3 + du / 2)
drawn = right.imshow(light / light.max(), extent=edges, cmap=LIGHT, aspect="auto",
                     norm=PowerNorm(0.5, 0, 1))
right.vlines(np.arange(-20.5, 21) * p, *edges[2:], color="w", lw=0.3, alpha=0.4)
right.hlines(np.arange(-5, 6) * du, *edges[:2], color="w", lw=0.3, alpha=0.4)
right.set(xlim=(-2.5, 2.5), ylim=(edges[2], 2.25), xlabel="x on the array / mm",
          ylabel="u on the main lens / mm", title="simulated, in boxes p x du")
bar(figure, drawn, right, "light / largest (square root)")
rays.say_scale(figure, left, r"dashed: x = X + u (1 - $\alpha$)", where="left:")
run.save(figure)
