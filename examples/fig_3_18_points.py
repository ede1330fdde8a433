"""Figure 3.18: the three points in object space."""

from typing import Any

import numpy as np
from common import COLOURS, PAPER, number, start
from matplotlib.figure import Figure

from clplen import demo

HALF, DEEP = 10, 50  # mm: half of the thesis' volume of 20 x 20 x 100 mm

example = start(__doc__, __file__)
camera = example.camera
middle = (camera.mla.count[0] - 1) / 2
for name, reference in {"A": 25.263, "B": 0.0, "C": -16.552}.items():
    lenslet = demo.array_position(camera, name)[0] - middle
    number(f"{name}: image, in lenslets from the axis", lenslet, reference, 1e-3, ".3f")

figure = Figure(figsize=(7.5, 4.2))
axes: Any = figure.add_axes((0, 0.03, 0.98, 1), projection="3d")
axes.set_box_aspect((2.2, 1, 1), zoom=1.15)
corners = HALF * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
for depth in (-DEEP, 0, DEEP):
    axes.plot(np.full(5, depth), *corners.T, color="0.5", lw=1, ls="-" if depth else "--")
for x, y in corners[:4]:
    axes.plot([-DEEP, DEEP], [x, x], [y, y], color="0.5", lw=1)
axes.plot([-DEEP, DEEP], [0, 0], [0, 0], color="0.3", lw=0.8, ls="-.")
axes.text(0, HALF, HALF + 1, "focused plane", color="0.3", ha="center")
for name, position in demo.POINTS.items():
    x, y, z = (length * 1e3 for length in position)
    axes.plot([z, z, z], [0, x, x], [0, 0, y], color=COLOURS[name], lw=1.2, ls=":")
    axes.plot([z], [x], [y], "o", color=COLOURS[name], ms=7)
    axes.text(z, x, y + (2 if y >= 0 else -4), f"{name} ({x:g}, {y:g}, {z:g}) mm", ha="center",
              color=COLOURS[name], bbox=PAPER)
axes.set(xlabel="dz / mm, away from the lens", ylabel="x / mm", zlabel="y / mm",
         xticks=(-DEEP, 0, DEEP), yticks=(-HALF, 0, HALF), zticks=(-HALF, 0, HALF))
axes.xaxis.labelpad = 10
axes.grid(False)
axes.view_init(elev=20, azim=-62)
example.save(figure)
