"""Figure 3.6: rendering in the (x, u) slice: a sum over all directions, or over fewer of them."""

import numpy as np
from common import BLUE, number, start
from drawing import new_figure
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Rectangle

from clplen.cameras import Plenoptic1

SHOWN = 7  # lenslets
APERTURES = (30, 12, 2)  # N', pixels of a sub-image across that are kept


def draw_slice(axes: Axes, camera: Plenoptic1, kept: int) -> None:
    """Samples p wide and du high; a pixel of the rendering is the sum of those of its column."""
    count = round(camera.pixels_per_lenslet)
    p = camera.lenslet_pitch * 1e6
    du = camera.pixel_pitch * camera.image_distance / camera.lenslet_focal_length * 1e3
    u, x = (np.arange(count) - count / 2) * du, (np.arange(SHOWN) - SHOWN / 2) * p
    inside = np.abs(np.arange(count) - (count - 1) / 2) < kept / 2
    for chosen, face in ((inside, "w"), (~inside, "0.75")):
        cells = [Rectangle((left, low), p, du) for left in x for low in u[chosen]]
        axes.add_collection(PatchCollection(cells, facecolor=face, edgecolor="0.4", lw=0.6))
    middle = [Rectangle((x[SHOWN // 2], low), p, du) for low in u[inside]]
    axes.add_collection(PatchCollection(middle, facecolor=BLUE, edgecolor="0.2", alpha=0.6))
    for end in u[inside][[0, -1]] + np.array([0, du]):
        axes.axhline(end, color="C1", ls="--", lw=1)
    axes.annotate("one pixel of\nthe rendering", (0, 1.02 * u[0]), (0, 1.3 * u[0]), ha="center",
                  va="top", color=BLUE, arrowprops={"arrowstyle": "<-", "color": BLUE})
    width = kept * du
    axes.set(xlim=(1.02 * x[0], -1.02 * x[0]), ylim=(1.55 * u[0], -1.1 * u[0]),
             xlabel="x on the array / um", yticks=np.linspace(-1.8, 1.8, 7),
             title=f"N' = {kept}: {width:.2f} mm of the main lens, f/"
             f"{camera.image_distance * 1e3 / width:.0f}")


example = start(__doc__, __file__)
camera = example.camera
step = camera.pixel_pitch * camera.image_distance / camera.lenslet_focal_length
number("one pixel on the main lens / um", step * 1e6, 120, 1e-6, ".3f")
number("all 30 of them / mm", 30 * step * 1e3, camera.aperture_diameter * 1e3, 1e-6, ".3f")
figure = new_figure(10, 5.2)
panels = figure.subplots(1, len(APERTURES), sharey=True)
for axes, kept in zip(panels, APERTURES, strict=True):
    draw_slice(axes, camera, kept)
panels[0].set_ylabel("u on the main lens / mm")
figure.supxlabel("blue: summed up; grey: not considered; dashed: the synthetic aperture")
example.save(figure)
