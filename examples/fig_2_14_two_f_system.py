"""Figure 2.14: the 2f system, its rays, and the light of two points on its way through."""

import numpy as np
from closed import LAM
from common import BLUE, RED, begin, number
from matplotlib.colors import to_rgb
from two_f import PITCH, D, F, Z

from clplen import Field, Grid, plot, propagate, thin_lens
from clplen.plot import rays_through
from clplen.wave import imaging_system

N, BESIDE = 1010, 190  # samples along y; the second point is so many above the axis
run = begin(__doc__, __file__)
system = imaging_system(F, diameter=D)
grid = Grid((N, 1), PITCH)  # nothing varies along x: the lens is cylindrical
points = np.zeros((2, N, 1))
points[0, N // 2], points[1, N // 2 + BESIDE] = 1 / PITCH, 1 / PITCH
(_, _, _), (at, _, behind), (end, _, image) = system.trace(
    Field.from_array(points, grid, wavelength=LAM, device=run.device))

height = BESIDE * PITCH
rays = rays_through(system, height=height)
number("rays meet behind the point / mm", rays.images[0].z * 1e3, 480.0, 1e-9)
number("rays meet at a height of / mm", rays.images[0].height * 1e3, -1.254, 1e-9)
lit = np.abs(image.to_numpy()[:, :, 0]) ** 2
for name, row, reference in zip(("on the axis", "beside it"), lit, (0.0, -1.254), strict=True):
    number(f"wave: image of the point {name} at / mm", grid.y[row.argmax()] * 1e3, reference, 1e-9)
fine = Grid((1201, 1), 0.1e-6)
near = np.abs(propagate(behind, Z, out_grid=fine).to_numpy()[0, :, 0])
zero = fine.y[600 + near[600:].argmin()]
number("wave: first zero beside the image / um", zero * 1e6, LAM * Z / D * 1e6, 0.1)

figure = plot.system(system, height=height)
axes = figure.axes[0]
limits, y = axes.axis(), grid.y
shown = np.abs(y) < limits[3]
places = np.linspace(0, end, 49 if run.quick else 481)[1:-1]
before = thin_lens(behind, -F)  # what passes the lens, without its phase
light = [propagate(before if z < at else behind, z - at).to_numpy()[:, shown, 0] for z in places]
light = np.moveaxis(np.abs(light) ** 2, 0, 2)  # [point, y, z]
light = 0.28 * np.sqrt(light / light.max(axis=(0, 1)))  # of a colour, in each plane the brightest
paper = 1 - sum(layer[..., None] * (1 - np.array(to_rgb(colour)))
                for layer, colour in zip(light, (BLUE, RED), strict=True))
axes.imshow(paper.clip(0, 1), extent=(0, end, y[shown][0], y[shown][-1]), origin="lower",
            aspect="auto", interpolation="antialiased", zorder=0)
axes.axis(limits)
for filled in [part for part in axes.collections if part.get_alpha() == 0.1]:  # the light instead
    filled.remove()
axes.text(0.006, 0.97 * limits[3], "shading: the computed light,\ngrey where it is of both points",
          va="top", size=8, color="0.35")
run.save(figure)
