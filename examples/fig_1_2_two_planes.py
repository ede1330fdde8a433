"""Figure 1.2: a ray by the two points in which it meets two planes, (u, v) and (x, y)."""

import numpy as np
import rays
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import new_figure

POINT = (0.12e-3, -0.10e-3, -8e-3)  # (x, y, dz) in metres
LENS = (-0.06e-3, 0.14e-3)  # (u, v)
HALF = 0.24  # of the planes, mm

run = begin(__doc__, __file__)
camera = rays.standard(run)
x0, y0, dz = POINT
z = rays.planes(camera, dz)[:3] * 1e3


def ray(u: float, v: float) -> np.ndarray:
    """(x, y) in mm on object, lens and array, of the point's ray through (u, v) in metres."""
    heights = [rays.trace(camera, one, at) for one, at in (((x0, dz), u), ((y0, dz), v))]
    return np.array(heights)[:, :3, 0].T * 1e3


found, law = ray(*LENS), camera.on_array([POINT])[0] + np.array(LENS) * (1 - camera.alpha(dz))
for name, place, expected in zip("xy", found[2], law, strict=True):
    number(f"{name} of the ray on the array / um", place * 1e3, expected * 1e6, 1e-3, ".3f")

figure = new_figure(9, 4.4)
axes = figure.subplots()
rays.space(axes, (z[0] - 2, z[2] + 4))
colours = (ORANGE, BLUE, GREEN)
for at, colour in zip(z, ("0.6", *colours[1:]), strict=True):
    rays.plane_in_space(axes, at, HALF, colour)
turn, radius = np.linspace(0, 2 * np.pi, 100), camera.aperture_diameter * 500
axes.fill(*rays.in_space(0, radius * np.cos(turn), radius * np.sin(turn)), fc=BLUE, alpha=0.15,
          ec=BLUE)
for angle in turn[:-1:11]:
    rim = ray(*(radius * 1e-3 * np.array([np.cos(angle), np.sin(angle)])))
    axes.plot(*rays.in_space(z, *rim.T), color="0.7", lw=0.6)
for at, (x, y), colour in zip(z[1:], found[1:], colours[1:], strict=True):
    axes.plot(*rays.in_space(at, [x, x, 0], [0, y, y]), color=colour, ls=":", lw=1.4)
axes.plot(*rays.in_space(z, *found.T), color=RED, lw=2)
words = ("a point of the object", "main lens\n(u, v) = ({:.0f}, {:.0f}) um",
         "array of lenslets\n(x, y) = ({:.1f}, {:.1f}) um")
for at, text, (x, y), colour in zip(z, words, found, colours, strict=True):
    axes.plot(*rays.in_space(at, x, y), "o", color=colour, ms=7, mec="k", mew=0.6)
    axes.text(at, 1.4 * rays.LARGER * HALF, text.format(x * 1e3, y * 1e3), ha="center",
              va="bottom", color="k" if at < 0 else colour)
for at, names in ((z[1], "uv"), (z[2], "xy")):
    rays.note(axes, *rays.in_space(at, HALF * 1.1, 0), names[0], ha="center")
    rays.note(axes, *rays.in_space(at, 0, -HALF * 1.08), names[1], ha="center")
rays.note(axes, *rays.in_space(z[2] / 2, *(found[1] + found[2]) / 2), "L(u, v, x, y)", color=RED,
          ha="center")
axes.text(*rays.in_space((z[0] + z[1]) / 2, 0.1, -HALF * 1.35), f"{-z[0]:.0f} mm", ha="center")
axes.text(*rays.in_space(z[2] / 2, 0.1, -HALF * 1.35), f"F = {z[2]:.0f} mm", ha="center")
figure.supxlabel("red: one ray of the light field; grey: rays through the rim of the lens; drawn "
                 f"to scale, heights {rays.LARGER:.0f} times larger than lengths")
run.save(figure)
