"""Figure 1.21: zoom on the raw image of figure 1.20; the spot moves from lenslet to lenslet."""

import numpy as np
from common import begin, number
from drawing import bar, new_figure
from matplotlib.patches import Circle
from spots import QUICK, show, spots

SHOWN = 7  # lenslets

run = begin(__doc__, __file__, quick=QUICK)
found = spots(run, 0.3)
camera = found.camera
number("m from the pitch of the spots", found.m, 0.2888, 0.015)
row = slice(30 - SHOWN // 2, 31 + SHOWN // 2)
moved = (found.centres - found.lenslets)[30, row, 1] * 1e6
number("spot left and right of the middle: moved by / um", (moved[4] - moved[2]) / 2,
       camera.m * camera.mla.pitch * 1e6, 7, ".1f")

figure = new_figure(10.6, 5)
left, right = figure.subplots(1, 2, width_ratios=[1.15, 1])
drawn = show(left, found, SHOWN)
law = (1 + camera.m) * found.lenslets[28:33, 28:33].reshape(-1, 2) * 1e3
left.plot(law[:, 1], law[:, 0], "o", mfc="none", mec="c", ms=10)
blur = camera.aperture_diameter * camera.a / camera.image_distance * 500
left.add_patch(Circle((0, 0), blur, fill=False, ec="c", ls="--", lw=1))
left.set_title(f"{SHOWN} x {SHOWN} lenslets and their cells")
bar(figure, drawn, left, "energy of a pixel / largest (square root)")
cut = found.raw.to_numpy()[found.raw.shape[0] // 2].astype(float)
x = (np.arange(cut.size) - (cut.size - 1) / 2) * camera.pixel_pitch * 1e3
right.plot(x, cut / cut.max(), color="k", lw=1)
edge = SHOWN / 2 * camera.mla.pitch * 1e3
for line in np.linspace(-edge, edge, SHOWN + 1):
    right.axvline(line, color="0.7", lw=0.8)
for c in found.lenslets[30, 28:33, 1] * 1e3:
    right.axvline(c, color="0.7", lw=0.8, ls=":")
    right.axvline(c * (1 + camera.m), color="c", lw=1, ls="--")
right.set(xlim=(-edge, edge), ylim=(0, 1.05), xlabel="x / mm", ylabel="energy / largest",
          title="the middle row of pixels")
figure.supxlabel("cyan: spots at x (1 + m) and the blur of the point on the array, D a/F; grey: "
                 "cells, dotted their middles")
run.save(figure)
