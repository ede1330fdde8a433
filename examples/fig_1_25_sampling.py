"""Figure 1.25: how a plenoptic camera 2.0 samples two points: lenslets tell directions."""

import rays
from common import GREEN, RED, begin, number
from drawing import new_figure

from clplen.analysis import sampling_of

POINTS = {RED: (4e-6, (4, 5, 6)), GREEN: (64e-6, (5, 6, 7))}  # x of the main image, lenslets

run = begin(__doc__, __file__)
camera = rays.focused(run, 1 / 3)
z, F, a = rays.planes(camera) * 1e3, camera.image_distance * 1e3, camera.a
found = sampling_of(camera)
number("places along the axis, 99 pixels times m", found.spatial_samples, 33, 1e-6, ".3f")
number("pitch of places dx/m / um", found.spatial_pitch * 1e6, 20, 1e-6, ".3f")
number("step of directions d/a / mrad", found.angular_step * 1e3, 3, 1e-6, ".3f")

figure = new_figure(11, 4.8)
left, right = figure.subplots(1, 2, width_ratios=[1.45, 1])
rays.stage(left, (F - 2.5, z[3] + 1.6), (-0.2, 0.2))
rays.draw_camera(left, camera)
rays.mark_plane(left, F, 0.18)
rays.stripes(right, camera, {k: "0.62" if k % 2 else "0.8" for k in range(2, 10)})
for colour, (X, lenslets) in POINTS.items():
    point = (-X * camera.object_distance / camera.image_distance, 0.0)
    u = rays.through(camera, point, lenslets)
    hits = rays.draw_rays(left, camera, point, u, colour, lw=1.4)
    left.plot(F, rays.image(camera, point)[1] * 1e3, "o", color=colour, ms=6, mec="k", zorder=6)
    right.axvline(X * 1e3, color=colour, lw=1, ls=":")
    for n, (k, s) in enumerate(zip(lenslets, hits[3], strict=True), 1):
        rays.light_pixel(left, camera, s, colour)
        c = rays.centres(camera)[k]
        number(f"{'red' if colour == RED else 'green'}, lenslet {'ABCD'[k - 4]}: spot / um",
               s * 1e6, (c + camera.m * (c - X)) * 1e6, 1e-3, ".3f")
        slope = (c - X) / a * 1e3
        right.plot(X * 1e3, slope, "o", color=colour, ms=8, mec="k", mew=0.5)
        side = -1 if colour == RED else 1
        right.text(X * 1e3 + side * 0.01, slope, f"{n}, lenslet {'ABCD'[k - 4]}", va="center",
                   ha="right" if side < 0 else "left", weight="bold")
for k in range(4, 8):
    rays.note(left, z[2] + 0.45, rays.centres(camera)[k] * 1e3 + 0.02, "ABCD"[k - 4], weight="bold")
right.set(xlim=(-0.15, 0.21), ylim=(-6.5, 6.5), title="boxes: dx/m wide, d/a high")
rays.names(left, {F: "main image", z[2]: "array", z[3]: "sensor"})
rays.distance(left, F, z[2], f"a = {a * 1e3:.0f} mm")
rays.distance(left, z[2], z[3], f"b = {camera.b * 1e3:.2f} mm")
rays.say_scale(figure, left, "each point is seen by three lenslets, in three directions",
          where="left:")
run.save(figure)
