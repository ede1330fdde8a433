"""Figure 3.17: the camera of section 1.5, drawn to scale from the camera object."""

import numpy as np
from common import BLUE, COLOURS, GREEN, RED, mm, new_figure, number, start

from clplen import demo


def draw_system(axes, camera):
    """Main lens, lenslets and sensor, with three rays of each point (dotted: to its image)."""
    F, z_obj, f_mu, D, edge = 1e3 * np.array([
        camera.image_distance, camera.object_distance, camera.lenslet_focal_length,
        camera.aperture_diameter, camera.grid.extent[0] / 2])
    u = np.array([-D, 0, D]) / 2
    for name, point in demo.POINTS.items():
        colour, alpha = COLOURS[name], camera.alpha(point[2])
        z, y, image = -z_obj - point[2] * 1e3, point[1] * 1e3, camera.image_of(point)[0, 1] * 1e3
        hits = image + u * (1 - alpha)
        axes.plot([z, 0, F], [np.full(3, y), u, hits], "-", color=colour, lw=0.9)
        axes.plot([F, F / alpha], [hits, np.full(3, image / alpha)], ":", color=colour, lw=0.9)
        axes.annotate(f"{name}, dz = {mm(point[2])}", (z, y), (0, 7 if y <= 0 else -14),
                      textcoords="offset points", color=colour, ha="center")
    for z, low, high, colour, text in (
        (-z_obj, -edge, edge, "0.7", "focused plane"), (0, D / 2, edge, "0.6", ""),
        (0, -edge, -D / 2, "0.6", ""), (0, -D / 2, D / 2, "k", "main lens and its stop"),
        (F, -edge, edge, BLUE, "lenslets, sensor"), (F + f_mu, -edge, edge, "k", "")):
        axes.plot([z, z], [low, high], color=colour, lw=2)
        axes.text(z, edge + 0.4, text, ha="center")
    axes.set(xlabel="z from the main lens / mm", ylabel="y / mm", aspect=12,
             title=f"F = {F:g} mm, D = {D:.3g} mm; heights drawn 12 times larger\n")


def draw_lenslets(axes, camera, middle):
    """Five lenslets with rays from the rim and the centre of the main lens to the sensor."""
    F, f_mu, p = camera.image_distance, camera.lenslet_focal_length, camera.lenslet_pitch
    for k in range(middle - 2, middle + 3):
        axes.plot([F * 1e3] * 2, (k + np.array([-0.46, 0.46])) * p * 1e3, color=BLUE, lw=3)
        axes.axhline((k - 0.5) * p * 1e3, color="0.8", lw=0.6, ls="--")
        for u, colour in zip((-0.5, 0, 0.5), (GREEN, "0.4", RED), strict=True):
            z = np.array([-f_mu / 5, f_mu])
            y = k * p + z * (k * p - u * camera.aperture_diameter) / F
            axes.plot((F + z) * 1e3, y * 1e3, color=colour, lw=1)
    axes.axvline((F + f_mu) * 1e3, color="k", lw=2)
    axes.set(xlabel="z / mm", ylabel="y / mm", aspect=7,
             title=f"lenslets {middle - 2} to {middle + 2} from the axis; heights 7 times larger")


example = start(__doc__, __file__)
table = example.camera.describe()
for name, reference in {"aperture": 3.6e-3, "working f-number": 200 / 3, "angle a pixel": 5e-4,
                        "independent views": 4.23, "Airy limit": 113.93e-6}.items():
    number(name, table[name], reference, ".6g")
figure = new_figure(9, 6.5)
grid = figure.add_gridspec(2, 2, height_ratios=[1.1, 1])
draw_system(figure.add_subplot(grid[0, :]), example.camera)
draw_lenslets(figure.add_subplot(grid[1, 0]), example.camera, 0)
draw_lenslets(figure.add_subplot(grid[1, 1]), example.camera, 25)
example.save(figure)
