"""Figure 3.17: the camera of section 1.5, drawn to scale from the camera object."""

import numpy as np
from common import BLUE, COLOURS, GREEN, RED, mm, number, start

from clplen import demo
from clplen.plot.base import new_figure


def draw_system(axes, camera):
    """Main lens, lenslets and sensor, with three rays of each point (dotted: to its image)."""
    F, z_obj, f_mu, D, edge = 1e3 * np.array([
        camera.image_distance, camera.object_distance, camera.lenslet_focal_length,
        camera.aperture_diameter, camera.grid.extent[0] / 2])
    u = np.array([-D, 0, D]) / 2
    for name, point in demo.POINTS.items():
        colour, alpha = COLOURS[name], camera.alpha(point[2])
        z, y, image = -z_obj - point[2] * 1e3, point[1] * 1e3, camera.image_of(point)[0, 1] * 1e3
        hits, end = image + u * (1 - alpha), max(F / alpha, F)
        axes.plot([z, 0, F], [np.full(3, y), u, hits], "-", color=colour, lw=0.9)
        axes.plot([F, end], [hits, hits + (image - u) / F * (end - F)], ":", color=colour, lw=0.9)
        axes.plot([z, F / alpha], [y, image / alpha], "o", color=colour, ms=3)
        axes.annotate(f"{name}: dz = {mm(point[2])}", (z, y), (-4, 10 if y > 0 else -14),
                      textcoords="offset points", color=colour, ha="left" if y > 0 else "right")
    for z, low, high, colour, text in (
        (-z_obj, -edge, edge, "0.8", "focused plane"), (0, D / 2, edge, "0.6", ""),
        (0, -edge, -D / 2, "0.6", ""), (0, -D / 2, D / 2, "k", "main lens in its stop"),
        (F, -edge, edge, BLUE, "lenslets, sensor"), (F + f_mu, -edge, edge, "k", "")):
        axes.plot([z, z], [low, high], color=colour, lw=2, zorder=1)
        axes.text(z, edge + 0.5, text, ha="center")
    axes.set(xlabel="z from the main lens / mm", ylabel="y / mm", aspect=12, xlim=(-340, 350),
             ylim=(-edge - 1, edge + 2.4),
             title=f"F = {F:g} mm, D = {D:.3g} mm; heights drawn 12 times larger")


def draw_lenslets(axes, camera, middle):
    """Five lenslets, with the rays from the rim and the centre of the main lens through them."""
    F, f_mu, p = camera.image_distance, camera.lenslet_focal_length, camera.lenslet_pitch
    for k in range(middle - 2, middle + 3):
        axes.plot([F * 1e3] * 2, (k + np.array([-0.46, 0.46])) * p * 1e3, color=BLUE, lw=4)
        axes.axhspan((k - 0.5) * p * 1e3, (k + 0.5) * p * 1e3, color="0.95" if k % 2 else "0.88")
        for u, colour in zip((-0.5, 0, 0.5), (GREEN, "0.4", RED), strict=True):
            z, slope = np.array([-f_mu / 5, f_mu]), (k * p - u * camera.aperture_diameter) / F
            axes.plot((F + z) * 1e3, (k * p + z * slope) * 1e3, color=colour, lw=1)
    axes.axvline((F + f_mu) * 1e3, color="k", lw=2)
    axes.set(xlabel="z / mm", ylabel="y / mm", aspect=7, ylim=(middle + np.array([-3, 4])) * p * 1e3,
             title=f"cells {middle - 2} to {middle + 2} from the axis; heights 7 times larger")


example = start(__doc__, __file__)
table = example.camera.describe()
REFERENCES = {"aperture": 3.6e-3, "working f-number": 66.67, "independent views": 4.23}
for name, reference in REFERENCES.items():
    number(name, table[name], reference, ".4g")
figure = new_figure(9, 7)
grid = figure.add_gridspec(2, 2, height_ratios=[1.1, 1])
draw_system(figure.add_subplot(grid[0, :]), example.camera)
for column, middle in enumerate((0, 25)):
    draw_lenslets(figure.add_subplot(grid[1, column]), example.camera, middle)
example.save(figure)
