"""Figure 1.22: directions that a plenoptic camera 2.0 samples: d/a each, d/b in all."""

import numpy as np
import rays
from common import BLUE, GREEN, ORANGE, begin, number
from drawing import new_figure
from matplotlib.patches import Polygon

from clplen.analysis import sampling_of

LENSLETS = dict(zip((4, 5, 6), (GREEN, ORANGE, BLUE), strict=True))

run = begin(__doc__, __file__)
camera = rays.focused(run, 1 / 3)
a, b, d = camera.a * 1e3, camera.b * 1e3, camera.mla.diameter * 1e3
z, found, F = rays.planes(camera) * 1e3, sampling_of(camera), camera.image_distance * 1e3
number("step of directions d/a / mrad", found.angular_step * 1e3, 60 / 20, 1e-6, ".3f")
number("range of directions d/b / mrad", found.angular_range * 1e3, 60 / (20 / 3), 1e-6, ".3f")
number("directions of a place, a/b", found.views, 3, 1e-6, ".3f")

figure = new_figure(11, 4.8)
left, right = figure.subplots(1, 2, width_ratios=[1.45, 1])
rays.stage(left, (F - 2.5, z[3] + 1.5), (-0.16, 0.16))
rays.draw_camera(left, camera)
rays.mark_plane(left, F, 0.15)
rays.stripes(right, camera, dict.fromkeys(range(11), "0.8") | LENSLETS)
for name, (k, colour) in zip("ABC", LENSLETS.items(), strict=True):
    u = np.concatenate([rays.through(camera, (0, 0), k, at) for at in (-d / 2001, d / 2001)])
    hits = rays.draw_rays(left, camera, (0, 0), u, colour, lw=1.2) * 1e3
    fan = [(F, 0), (z[2], hits[2, 0]), (z[3], hits[3, 0]), (z[2], hits[2, 1])]
    left.add_patch(Polygon(fan, fc=colour, alpha=0.25, lw=0, zorder=2))
    middle = rays.centres(camera)[k] * 1e3
    left.text(z[2] + 0.4, middle + 0.015, name, color=colour, weight="bold", size=10, zorder=7)
    right.text(middle + 0.075, -75 / a, name, weight="bold", size=11, ha="center", va="center")
    right.plot([0, 0], (middle + np.array([-d, d]) / 2) / a * 1e3, color=colour, lw=3.5,
               solid_capstyle="butt")
style = {"arrowstyle": "<|-|>", "color": "k", "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
for x, half, text in ((-0.008, d / a / 2, "d/a = 3 mrad"), (-0.155, d / b / 2, "d/b = 9 mrad")):
    right.annotate("", (x, half * 1e3), (x, -half * 1e3), arrowprops=style)
    right.text(x - 0.004, 0, text, rotation=90, ha="right", va="center", size=8)
for edge in (-d / b / 2, d / b / 2):
    right.plot([-0.165, 0.02], [edge * 1e3] * 2, color="k", lw=0.6, ls=":")
right.set(xlim=(-0.2, 0.2), ylim=(-6.2, 6.2), title="boxes: dx/m wide, d/a high")
rays.names(left, {F: "main image", z[2]: "array", z[3]: "sensor"})
rays.distance(left, F, z[2], f"a = {a:.0f} mm")
rays.distance(left, z[2], z[3], f"b = {b:.2f} mm")
rays.say_scale(figure, left, "three lenslets see the point, each in one direction",
          where="left:")
run.save(figure)
