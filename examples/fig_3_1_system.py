"""Figure 3.1: the simulated camera to scale: what is conjugate with what, and how wide D is."""

import numpy as np
from arrays import draw_sub_images
from common import BLUE, RED, begin, number
from drawing import new_figure
from matplotlib.axes import Axes
from rays import distance, draw_camera, draw_rays, names, planes, stage, trace
from slices import camera

from clplen.cameras import Plenoptic1

BESIDE = 12  # lenslets from the axis


def draw_system(axes: Axes, cam: Plenoptic1) -> None:
    """From the object to the sensor."""
    u, (start, lens, array, sensor) = np.array([-0.5, 0, 0.5]) * cam.aperture_diameter, planes(cam)
    stage(axes, (start * 1e3 - 15, sensor * 1e3 + 25), (-3.2, 3.2))
    draw_camera(axes, cam, pixels=False)
    for beside, colour in ((0, BLUE), (BESIDE, RED)):
        point = (-beside * cam.lenslet_pitch, 0.0)  # 2f and 2f: the image is as large
        y = draw_rays(axes, cam, point, u, colour) * 1e3
        z = planes(cam) * 1e3
        axes.fill_between(z[:3], y[:3, 0], y[:3, -1], color=colour, alpha=0.12, lw=0)
        axes.plot(z[[0, 2]], y[[0, 2], 1], "o", color=colour, ms=4, zorder=6)
    axes.vlines(start * 1e3, -3, 3, color="0.6", lw=1.6)
    names(axes, {start * 1e3: "object plane", 0: f"main lens, f = {cam.focal_length * 1e3:.0f} mm, "
                 f"D = {cam.aperture_diameter * 1e3:.1f} mm", array * 1e3: "lenslets and sensor"})
    distance(axes, start * 1e3, lens, f"$z_1$ = 2f = {-start * 1e3:.0f} mm")
    distance(axes, lens, array * 1e3, f"$z_2$ = 2f = {array * 1e3:.0f} mm")
    distance(axes, array * 1e3, sensor * 1e3, "")
    axes.text(sensor * 1e3 + 22, -0.055, f"$z_3$ = $f_\\mu$ = {(sensor - array) * 1e3:.0f} mm",
              ha="right", va="top", size=8, transform=axes.get_xaxis_transform())


run = begin(__doc__, __file__)
cam = camera(run)
F, p, D = cam.image_distance, cam.lenslet_pitch, cam.aperture_diameter
heights = trace(cam, (0.0, 0.0), np.array([-0.5, 0.25, 0.5]) * D)
number("aperture D that the camera takes / mm", D * 1e3, 3.6, 1e-6)
number("rays of the axis point on the array, apart / um", np.ptp(heights[2]) * 1e6, 0, 1e-6)
number("picture of the main lens under a lenslet / um", np.ptp(heights[3]) * 1e6, 150, 1e-6)
rim = cam.ray_matrix()[0] @ [[-p / 2, p / 2], [-p / 2 / F, p / 2 / F]]
number("blur of that picture / um", np.ptp(rim) * 1e6, 6.25, 1e-6)
figure = new_figure(9.4, 6.6)
above, below = figure.subplots(2, 1, height_ratios=[1.2, 1])
draw_system(above, cam)
draw_sub_images(below, cam)
figure.supxlabel("lengths to scale, heights larger; below: rays from the lower rim (orange), the "
                 "middle and the upper rim (purple) of the main lens; bands: the cells")
run.save(figure)
