"""Figure 3.16: flow chart of the shearing operator, with what each stage makes of a light field."""

import numpy as np
from common import begin, number, pixels
from drawing import new_figure, show
from matplotlib.axes import Axes
from slices import DEPTHS, QUICK, axes_of, camera, draw_slice, sheared, summed, three

from clplen import refocus

SHOWN = 31  # lenslets
STAGES = ("captured light field\nL(x, u)",
          "1 new coordinates\n" r"x = $\alpha$ x' + u (1 - $\alpha$)",
          "2 interpolation\nL'(x', u) = L(x, u)",
          "3 sum over u and v\n" r"I(x') = $\alpha^2 \Sigma$ L'")


def show_root(axes: Axes, image: np.ndarray, pitch: float) -> None:
    """A picture as the slices are shown."""
    show(axes, np.sqrt(np.maximum(image, 0) / image.max()), pitch, near=SHOWN * pitch * 500)
    axes.set(xlabel="x' / mm", ylabel="y' / mm")


run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
lf, places = three(cam)
alpha, (u, x) = cam.alpha(DEPTHS["closer"]), axes_of(lf)
before, after = pixels(lf.render()), pixels(refocus(lf, alpha=alpha, rescale=True))
number("light of the refocused picture over that before", after.sum() / before.sum(), 1.0, 0.03)
near = np.abs(x[:, None] - places["closer"] / alpha) < 1e-3
weight = (after**2)[np.ix_(np.abs(x) < 1e-3, near[:, 0])]
place = np.average(x[near[:, 0]], weights=weight.sum(axis=0))
number("the closer point lies at x' / mm", place * 1e3, places["closer"] / alpha * 1e3, 0.075)

figure = new_figure(12, 3.5)
panels = figure.subplots(1, 4, gridspec_kw={"wspace": 0.12})
light = summed(lf)
for axes, values in zip(panels, (light, light, sheared(lf, alpha, rescale=True)), strict=False):
    draw_slice(axes, lf, values, SHOWN)
    axes.set(xlabel="x / mm", ylabel="u / mm")
ends = np.array([-0.5, 0.5]) * cam.aperture_diameter
for x_new in x[::3]:
    panels[1].plot((alpha * x_new + ends * (1 - alpha)) * 1e3, ends * 1e3, color="c", lw=0.8)
panels[2].set_xlabel("x' / mm")
show_root(panels[3], after, cam.lenslet_pitch)
for axes, title in zip(panels, STAGES, strict=True):
    axes.set_box_aspect(1)
    axes.set_title(title, bbox={"boxstyle": "round,pad=0.35", "fc": "#d7e8f4", "ec": "#33536b"},
                   pad=12)
for axes in panels[:-1]:
    axes.annotate("", (1.2, 1.17), (1.02, 1.17), xycoords="axes fraction", annotation_clip=False,
                  arrowprops={"arrowstyle": "-|>", "lw": 1.6, "color": "#33536b"})
figure.supxlabel(rf"$\alpha$ = {alpha:.4f} focuses on the closer point; cyan: lines of equal x'")
run.save(figure)
