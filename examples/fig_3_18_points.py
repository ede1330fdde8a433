"""Figure 3.18: the three points in object space."""

import numpy as np
from common import COLOURS, mm, new_figure, number, start

from clplen import demo

HALF = 10  # mm, of the thesis' volume of 20 x 20 x 100 mm

example = start(__doc__, __file__)
camera = example.camera
middle = (camera.mla.count[0] - 1) / 2
for name, reference in {"A": 25.263, "B": 0.0, "C": -16.552}.items():
    lenslet = demo.place(camera, name)[0] - middle
    number(f"{name}: image, in lenslets from the axis", lenslet, reference, ".3f")

figure = new_figure(7, 5)
axes = figure.add_subplot(projection="3d")
axes.set_box_aspect((2, 1, 1))
corners = HALF * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
for depth in (-50, 0, 50):
    axes.plot(np.full(5, depth), *corners.T, color="0.6", lw=1, ls="-" if depth else "--")
for x, y in corners[:4]:
    axes.plot([-50, 50], [x, x], [y, y], color="0.8", lw=0.8)
axes.plot([-50, 50], [0, 0], [0, 0], color="0.3", lw=0.8, ls="-.")
for name, position in demo.POINTS.items():
    x, y, z = (length * 1e3 for length in position)
    axes.plot([z, z, z], [0, x, x], [0, 0, y], color=COLOURS[name], lw=1, ls=":")
    axes.plot([z], [x], [y], "o", color=COLOURS[name], ms=8)
    axes.text(z, x, y + 1.5, f"{name} ({x:+.0f}, {y:+.0f}, {z:+.0f}) mm", color=COLOURS[name])
axes.set(xlabel="dz / mm (positive: farther from the lens)", ylabel="x / mm", zlabel="y / mm")
axes.view_init(elev=18, azim=-66)
example.save(figure)
