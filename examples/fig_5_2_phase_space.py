"""Figure 5.2: phase space of a microscope: points lie along x = z p/n, refocusing keeps areas."""

import microscope as lfm
import numpy as np
from common import begin, number
from drawing import bar, new_figure
from slices import slope

SLOPES = {-20e-6: 1.064, 0.0: 0.0, 20e-6: 1.065}  # of z/n, float64 simulation, by z
PIXELS = 8.5  # from the middle of a sub-image that count
SLAB = (10e-6, 30e-6, 16e-6)  # from z to z, wide
KEPT, OWN = {"point": 1.0, "slab": 1.0}, {"point": 1.414, "slab": 1.138}  # areas over as taken
PLANES = np.arange(-30, 31, 10) * 1e-6

run = begin(__doc__, __file__, quick="coarser samples, fewer planes of the slab")
cam, steps = lfm.camera(run), 5 if run.quick else 10
figure = new_figure(13.5, 7)
panels = figure.subplot_mosaic("abcd;efgh")
points = {z: lfm.taken(cam, [(0, 0, z)], steps=steps) for z in SLOPES}
p, x = lfm.axes_of(cam, points[0.0])
for name, (z, lf) in zip("abc", points.items(), strict=True):
    light = lfm.summed(lf)
    lfm.draw_slice(panels[name], light, p, x, f"point at z = {z * 1e6:+.0f} um")
    lfm.draw_lines(panels[name], cam, z)
    if z:
        sharp = lfm.refocused(lf, [z], "cubic")[0]
        before, after = (slope(one, p, x, within=PIXELS * (p[1] - p[0]), reach=np.inf) / z
                         * cam.medium_index for one in (light, sharp))
        number(f"z = {z * 1e6:+.0f} um: dx/dtheta over M^2 z/n", before, SLOPES[z], 0.005, ".3f")
        number("the same after refocusing", after, SLOPES[z] - 1, 0.005, ".3f")
panels["b"].set_title("point in focus")
drawn = lfm.draw_slice(panels["d"], sharp, p, x, f"point at z = {z * 1e6:+.0f} um, refocused")
lfm.draw_lines(panels["d"], cam, z, focus=z)

places = lfm.slab(*SLAB, planes=3 if run.quick else 9)
slab, middle = lfm.taken(cam, places, steps=steps), (SLAB[0] + SLAB[1]) / 2
lfm.draw_slice(panels["e"], lfm.summed(slab), p, x, "slab from 10 to 30 um")
lfm.draw_slice(panels["f"], lfm.refocused(slab, [middle], "cubic")[0], p, x,
               f"slab, refocused to {middle * 1e6:g} um")
for z in SLAB[:2]:
    for name, focus in (("e", 0.0), ("f", middle)):
        panels[name].plot(*lfm.outline(cam, z, SLAB[2], focus), "c--", lw=1)
for found in lfm.draw_bands(panels["g"], cam, SLOPES, SLAB[2]):
    number("area that rays of a line fill / um", found, 2 * cam.na * SLAB[2] * 1e6, 1e-3, ".3f")
dense = {"point": points[20e-6], "slab": slab}
coarse = {"point": lfm.taken(cam, [(0, 0, 20e-6)]), "slab": lfm.taken(cam, places)}
planes = PLANES[1::2] if run.quick else PLANES
for fields, expected, way, within in ((dense, KEPT, "cubic", 0.01), (coarse, OWN, "linear", 3e-3)):
    for name, ratios in lfm.draw_areas(panels["h"], cam, fields, planes, way).items():
        worst = ratios[np.abs(ratios - 1).argmax()]
        number(f"{name}, {way}: area refocused over as taken", worst, expected[name], within, ".3f")
for name in "ae":
    panels[name].set_ylabel(r"p = n sin($\theta$)")
bar(figure, drawn, [panels[name] for name in "abcd"], "square root of the light / largest")
figure.supxlabel(r"dashed: x = z p/n, and rays of the slab's planes; dotted: x = z tan($\theta$)")
run.save(figure)
