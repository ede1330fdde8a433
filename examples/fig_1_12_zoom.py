"""Figure 1.12: zoom on the raw image; every lenslet's sub-image is a picture of the main lens."""

import numpy as np
from common import begin, number
from drawing import bar, new_figure
from extended import QUICK, camera, card, expose, show
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from clplen import LightField

PLACE = (0.2, 0.14)  # (y, x) of the zoom's middle, of the sensor from its middle
SHOWN = (27, 7)  # sub-images across
ACROSS = {25: (9, 5)}  # of the reduced camera


def frame(axes: Axes, middle: np.ndarray, half: float) -> None:
    """Show so much to either side of a place, turned."""
    y, x = middle
    axes.set(xlim=(x + half, x - half), ylim=(y - half, y + half))


run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
raw = expose(cam, card(cam))
lf = LightField.from_raw(raw)
views, place = lf.to_numpy().astype(float), np.arange(lf.shape[1]) - (lf.shape[1] - 1) / 2
energy = views.sum(axis=(0, 1, 2))
moved = np.einsum("vuyx,u->x", views, place) / np.maximum(energy, 1e-9)
weight = np.where(energy > 0.05 * energy.max(), energy, 0)
slope = np.polyfit(np.arange(energy.size), moved, 1, w=np.sqrt(weight))[0]
pitch = 1e3 * raw.pixel_pitch * np.array(raw.sub_images.column_step)[1]
number("pitch of the sub-images / um", pitch * 1e3 + slope * raw.pixel_pitch * 1e6,
       cam.lenslet_pitch * (1 + cam.lenslet_focal_length / cam.image_distance) * 1e6, 0.1, ".2f")

nearest = np.rint(np.array(PLACE) * cam.mla.count) * pitch
figure = new_figure(11, 5.6)
panels = figure.subplots(1, 2)
for axes, shown in zip(panels, ACROSS.get(cam.mla.count[0], SHOWN), strict=True):
    drawn = show(axes, raw.to_numpy(), cam.pixel_pitch)
    frame(axes, nearest, shown / 2 * pitch)
    for n in np.arange(shown + 1) - shown / 2:
        axes.axhline(nearest[0] + n * pitch, color="w", lw=0.5, alpha=0.6)
        axes.axvline(nearest[1] + n * pitch, color="w", lw=0.5, alpha=0.6)
    axes.set_title(f"{shown} x {shown} sub-images of {pitch * 1e3:.2f} um")
half = shown / 2 * pitch
panels[0].add_patch(Rectangle(nearest[::-1] - half, 2 * half, 2 * half, fill=False, ec="c", lw=1.5))
bar(figure, drawn, panels, "energy of a pixel")
run.save(figure)
