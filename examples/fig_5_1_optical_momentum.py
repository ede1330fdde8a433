"""Figure 5.1: optical momentum p = n sin(theta): kept by layers, even steps of it on the pupil."""

import numpy as np
from common import BLUE, GREEN, ORANGE, begin, number
from drawing import new_figure
from matplotlib.axes import Axes
from microscope import camera, draw_objective, draw_pixels, fermat

LAYERS = {"water": (1.33, 1.0), "glass": (1.52, 0.8), "air": (1.0, 1.0)}  # n, thickness
COLOURS = (BLUE, GREEN, ORANGE)
P = 0.5


def draw_layers(axes: Axes, circles: Axes) -> None:
    """A ray through layers, and its momenta: lengths n, all of one component along x."""
    n, thick = np.array(list(LAYERS.values())).T
    end = (thick * P / np.sqrt(n**2 - P**2)).sum()
    steps, z = fermat(n, thick, end), np.concatenate([[0], np.cumsum(thick)])
    for name, index, t, dx, left, x, colour in zip(
            LAYERS, n, thick, steps, z[:-1], np.cumsum(steps) - steps, COLOURS, strict=True):
        sine = dx / np.hypot(t, dx)
        number(f"{name}: n sin(theta) of the shortest path", index * sine, P, 1e-4)
        axes.axvspan(left, left + t, color=colour, alpha=0.15 * index, lw=0)
        axes.plot([left, left + t], [x, x + dx], color=colour, lw=2)
        axes.plot([left, left + 0.55 * t], [x, x], color="0.4", lw=0.8, ls="--")
        axes.text(left + t / 2, -0.26, f"{name}\nn = {index:g}\n"
                  rf"$\theta$ = {np.degrees(np.arcsin(sine)):.1f}°", ha="center", va="center")
        turn = np.linspace(0, np.pi / 2, 91)
        circles.plot(index * np.cos(turn), index * np.sin(turn), color=colour, lw=1,
                     label=f"{name}, {index:g}")
        circles.annotate("", (np.sqrt(index**2 - P**2), P), (0, 0),
                         arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6,
                                     "shrinkA": 0, "shrinkB": 0})
    axes.plot(0, 0, "ko", ms=5, clip_on=False, zorder=3)
    axes.set(xlim=(0, z[-1]), ylim=(-0.5, 1.35), aspect="equal", xticks=[], yticks=[],
             title="a ray from a point in water: the shortest optical path")
    circles.axhline(P, color="0.4", ls="--", lw=1)
    circles.set(xlim=(0, 2.1), ylim=(0, 1.6), aspect="equal", xlabel=r"n cos($\theta$)",
                ylabel=r"p = n sin($\theta$)", title=f"its momenta: p = {P:g} in all layers")
    circles.legend(loc="upper right", title="radius n")


run = begin(__doc__, __file__)
cam = camera(run)
figure = new_figure(11, 7.2)
panels = figure.subplot_mosaic("ab;cd", height_ratios=[1, 1.1])
draw_layers(panels["a"], panels["b"])
momenta = np.linspace(-cam.na, cam.na, 11)
draw_objective(panels["c"], cam, momenta)
rim = np.sqrt(np.count_nonzero(cam.objective.pupil(cam.grid, 0.0)) / np.pi) / cam.grid.extent[0]
number("radius of the wave's pupil, by its area / mm", rim * cam.wavelength * cam.tube_lens * 1e3,
       cam.na * cam.focal_length * 1e3, 0.02, ".3f")
step = draw_pixels(panels["d"], cam, momenta)
number("p of a pixel behind a lenslet", step, 2 * cam.na / cam.pixels_per_lenslet, 1e-9)
figure.supxlabel("below: M = 20, NA = 0.5, eleven rays in even steps of p; left to scale, "
                 "right heights drawn larger than lengths")
run.save(figure)
