"""Figure 5.2: phase space of a microscope: points lie along x = z p/n, refocusing keeps areas."""

import microscope as lfm
import numpy as np
from common import begin, number
from slices import slope

from clplen.plot.base import bar, new_figure

DEPTHS = (-20e-6, 0.0, 20e-6)  # metres
SLAB = (10e-6, 30e-6, 16e-6)  # from z to z, wide
SLOPE = 1.115  # of M^2 z/n, 1.11 to 1.12 in a float64 simulation
PIXELS = 8.5  # from the middle of a sub-image that count

run = begin(__doc__, __file__, quick="fewer points in the slab")
cam = lfm.camera(run)
figure = new_figure(11, 6.8)
panels = figure.subplots(2, 3, sharey=True)
for axes, z in zip(panels[0], DEPTHS, strict=True):
    lf = lfm.taken(cam, [(0, 0, z)])
    p, x = lfm.axes_of(cam, lf)
    light = lfm.summed(lf)
    drawn = lfm.draw_slice(axes, light, p, x)
    lfm.draw_lines(axes, cam, z)
    axes.set_title("point in focus")
    if z:
        within, scale = PIXELS * (p[1] - p[0]), z / cam.medium_index
        found = slope(light, p, x, within=within, reach=np.inf) / scale
        number(f"z = {z * 1e6:+.0f} um: dx/dtheta over M^2 z/n", found, SLOPE, 0.01, ".3f")
        rays = lfm.through(cam, 0, p[np.abs(p) < within], z)
        print(f"  rays alone, tan(theta) against sin(theta): "
              f"{np.polyfit(p[np.abs(p) < within], rays, 1)[0] / scale:.3f}")
        kept = lfm.area(lfm.sheared(lf, cam.disparity(z)), p, x) / lfm.area(light, p, x)
        number("area after refocusing over that before", kept, 1, 0.01, ".3f")
        axes.set_title(f"point at z = {z * 1e6:+.0f} um: dx/dp = {found:.3f} z/n")

near, far, wide = SLAB
middle, counts = (near + far) / 2, (5, 3) if run.quick else (13, 9)
places = [(x0, 0, z) for x0 in np.linspace(-wide / 2, wide / 2, counts[0])
          for z in np.linspace(near, far, counts[1])]
lf = lfm.taken(cam, places)
p, x = lfm.axes_of(cam, lf)
slices = {0.0: lfm.summed(lf), middle: lfm.sheared(lf, cam.disparity(middle))}
before, after = (lfm.area(light, p, x) for light in slices.values())
number("slab: area after refocusing over that before", after / before, 1, 0.01, ".3f")
for axes, (focus, light) in zip(panels[1], slices.items(), strict=False):
    lfm.draw_slice(axes, light, p, x)
    for z in (near, far):
        axes.plot(*lfm.outline(cam, z, wide, focus), "c--", lw=1)
    axes.set_title(f"slab from {near * 1e6:g} to {far * 1e6:g} um, focus {focus * 1e6:g} um")
for found in lfm.draw_bands(panels[1, 2], cam, DEPTHS, wide):
    number("area that rays of a line fill / um", found, 2 * cam.na * wide * 1e6, 1e-3, ".3f")
for axes in panels[:, 0]:
    axes.set_ylabel(r"p = n sin($\theta$)")
bar(figure, drawn, list(panels[0]), "square root of the light / largest")
figure.supxlabel("dashed: x = z p/n, and rays of the slab's planes; dotted: x = z tan(theta)")
run.save(figure)
