"""Figure 3.17: the camera of section 1.5, drawn to scale from the camera object."""

import numpy as np
from common import BLUE, COLOURS, ORANGE, PAPER, mm, number, start
from drawing import new_figure
from matplotlib.axes import Axes

from clplen import demo
from clplen.cameras import Plenoptic1


def draw_system(axes: Axes, camera: Plenoptic1) -> None:
    """Main lens, lenslets and sensor, with three rays of each point (dotted: to its image)."""
    F, z_obj, D = 1e3 * np.array([camera.image_distance, camera.object_distance,
                                  camera.aperture_diameter])
    u, edge = np.array([-D, 0, D]) / 2, camera.grid.extent[0] * 500
    for name, point in demo.POINTS.items():
        colour, alpha, (_, y, dz) = COLOURS[name], camera.alpha(point[2]), 1e3 * np.array(point)
        image, z, end = camera.image_of(point)[0, 1] * 1e3, -z_obj - dz, max(F / alpha, F)
        hits = image + u * (1 - alpha)
        axes.plot([z, 0, F], [np.full(3, y), u, hits], "-", color=colour, lw=0.9)
        axes.plot([F, end], [hits, hits + (hits - u) / F * (end - F)], ":", color=colour, lw=0.9)
        axes.plot([z, F / alpha], [y, image / alpha], "o", color=colour, ms=3)
        axes.text(z, y + (0.8 if y > 0 else -1.4), f"{name}: dz = {mm(point[2])}", color=colour,
                  ha="left" if y > 0 else "right", bbox=PAPER)
    planes = (-z_obj, 0, F, F + camera.lenslet_focal_length * 1e3)
    axes.vlines(planes, -edge, edge, color=("0.8", "0.6", BLUE, "k"), lw=2, zorder=1)
    axes.vlines(0, -D / 2, D / 2, color="k", lw=3, zorder=1)
    for z, text in zip(planes, ("focused plane", "main lens", "lenslets, sensor"), strict=False):
        axes.text(z, edge + 0.5, text, ha="center")
    axes.set(xlabel="z from the main lens / mm", ylabel="y / mm", aspect=12, xlim=(-340, 350),
             ylim=(-edge - 1, edge + 2.4), title="heights drawn 12 times larger than lengths")


def draw_lenslets(axes: Axes, camera: Plenoptic1, middle: int) -> None:
    """Five lenslets in their cells, and rays from three heights of the main lens through them."""
    F, f_mu, p, D = 1e3 * np.array([camera.image_distance, camera.lenslet_focal_length,
                                    camera.lenslet_pitch, camera.aperture_diameter])
    for k in range(middle - 2, middle + 3):
        axes.axhspan((k - 0.5) * p, (k + 0.5) * p, color="0.95" if k % 2 else "0.88")
        axes.vlines(F, (k - 0.44) * p, (k + 0.44) * p, color=BLUE, lw=4)
        for u, colour in zip((-D / 2, 0, D / 2), (ORANGE, "0.4", "#882288"), strict=True):
            z = np.array([-f_mu / 5, f_mu])
            axes.plot(F + z, k * p + z * (k * p - u) / F, color=colour, lw=1.2)
    axes.axvline(F + f_mu, color="k", lw=2)
    axes.set(xlabel="z / mm", ylabel="y / mm", aspect=7, ylim=((middle - 3) * p, (middle + 4) * p),
             title=f"lenslets {middle - 2} to {middle + 2}; heights 7 times larger")


example = start(__doc__, __file__)
number("aperture D / mm", example.camera.aperture_diameter * 1e3, 3.6, 1e-6)
number("views that are independent", example.camera.describe()["independent views"], 4.23, 0.005)
figure = new_figure(9, 6.6)
panels = figure.subplot_mosaic("aa;bc", height_ratios=[1.15, 1])
draw_system(panels["a"], example.camera)
draw_lenslets(panels["b"], example.camera, 0)
draw_lenslets(panels["c"], example.camera, 25)
figure.supxlabel("rays: rim (orange, purple) and centre (grey) of the main lens; bands: cells")
example.save(figure)
