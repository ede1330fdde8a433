"""Figure 3.15: the light field before and after its shear: lines tilt alike, no light is lost."""

import numpy as np
from common import BLUE, GREEN, RED, begin, mm, number
from drawing import bar, new_figure
from slices import BESIDE, DEPTHS, QUICK, axes_of, camera, draw_slice, sheared, slope, summed, three

SHOWN = 27  # lenslets
COLOURS = {"closer": BLUE, "in focus": GREEN, "farther": RED}

run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
lf, places = three(cam)
alpha, (u, x) = cam.alpha(DEPTHS["closer"]), axes_of(lf)
slices = {"as taken": summed(lf), rf"sheared by $\alpha$ = {alpha:.4f}": sheared(lf, alpha)}
before, after = slices.values()
number("light after the shear over that before", after.sum() / before.sum(), 1.0, 1e-3)
for name, X in places.items():
    found = [slope(light, u, x - X, within=1.2e-3, reach=BESIDE / 2) for light in slices.values()]
    number(f"{name}: change of dx/du", found[1] - found[0], alpha - 1, 0.02)

figure = new_figure(10, 6.8)
panels = figure.subplots(2, 2, sharex=True, height_ratios=[1.6, 1])
ends = np.array([-0.5, 0.5]) * cam.aperture_diameter
corners = np.array([-1, 1, 1, -1, -1]) * (SHOWN / 2 - 4) * cam.lenslet_pitch
highest = max(light.sum(axis=0).max() for light in slices.values())
for (above, below), (title, light), shear in zip(panels.T, slices.items(), (0, 1 - alpha),
                                                 strict=True):
    drawn = draw_slice(above, lf, light, SHOWN)
    rim = ends[[0, 0, 1, 1, 0]]
    above.plot((corners - shear * rim) * 1e3, rim * 0.99e3, color="w", lw=1, ls=":")
    line = light.sum(axis=0) / highest
    below.bar(x * 1e3, line, cam.lenslet_pitch * 1e3, color="0.5")
    for name, X in places.items():
        tilt, colour = 1 - cam.alpha(DEPTHS[name]) - shear, COLOURS[name]
        above.plot((X + tilt * ends) * 1e3, ends * 1e3, "--", color="c", lw=1)
        near = np.abs(x - X) < BESIDE / 2
        below.annotate(f"{name}, dz = {mm(DEPTHS[name])}", (X * 1e3, line[near].max()),
                       (0, 14 if shear and not X else 3),
                       textcoords="offset points", ha="center", color=colour)
    above.set(title=title, ylabel="u on the main lens / mm")
    below.set(xlabel=r"x on the array / mm" if not shear else r"X = $\alpha$ x' / mm",
              ylabel="sum over u / largest", ylim=(0, 1.15))
bar(figure, drawn, list(panels[0]), "square root of the light / largest")
figure.supxlabel("dashed: rays of the points; dotted: a part of the light field, whose area the "
                 "shear keeps")
run.save(figure)
