"""Figure 3.11: the sign of the slope: on the array rays still converge, or have crossed."""

import numpy as np
from common import begin, mm, number
from drawing import new_figure
from matplotlib.axes import Axes
from rays import image, mark_plane, names, stage
from slices import COLOURS, DEPTHS, QUICK, axes_of, camera, draw_slice, slope, summed, taken, zones

from clplen.cameras import Plenoptic1

SHOWN = 11  # lenslets
# dx/du and dx/dtheta of the light over those of the rays, in a float64 simulation
OVER_TRUE = {"closer": (0.943, 0.907), "farther": (0.922, 0.931)}


def draw_rays(axes: Axes, cam: Plenoptic1, dz: float, name: str) -> None:
    """Rays of the zones of the main lens about the array, as if it were not there."""
    F, end = cam.image_distance * 1e3, image(cam, (0.0, dz))[0] * 1e3
    stage(axes, (175, 350), (-1.0, 1.0))
    axes.set_title(f"{name}, dz = {mm(dz)}", pad=17)
    z = np.array([175, 350])
    for (u,), colour in zip(zones(cam) * 1e3, COLOURS, strict=True):
        axes.plot(z, u * (1 - z / end), color=colour, lw=1.2)
        axes.plot(F, u * (1 - F / end), "o", color=colour, ms=4, zorder=4)
    mark_plane(axes, F, 1, "k")
    axes.plot(end, 0, "ko", ms=4, zorder=5)
    names(axes, {F: "array", end: "image"})


run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
figure = new_figure(11, 6.6)
panels = figure.subplots(2, 3, width_ratios=[1.35, 1, 1])
for row, name in zip(panels, OVER_TRUE, strict=True):
    dz, lf = DEPTHS[name], taken(cam, DEPTHS[name])
    true, apart = 1 - cam.alpha(dz), cam.image_distance * (1 - 1 / cam.alpha(dz))
    draw_rays(row[0], cam, dz, name)
    by_angle = lf.resample("point-angle", views=(34, 46))
    for axes, field, line, end in ((row[1], lf, true, 1.8), (row[2], by_angle, apart, 11.5)):
        light, (u, x) = summed(field), axes_of(field)
        found = slope(light, u, x, within=1.15e-3 * abs(true / line), reach=8.5 * cam.lenslet_pitch)
        number(f"{name}: dx/d{'u' if field is lf else 'theta'} over that of rays", found / line,
               OVER_TRUE[name][field is by_angle], 0.01 if field is lf else 0.03, ".3f")
        draw_slice(axes, field, light, SHOWN)
        axes.plot(line * np.array([-end, end]), [-end, end], "--", color="c", lw=1.2)
        axes.locator_params(axis="x", nbins=5)
        axes.set(xlabel="x on the array / mm", ylim=(-end, end))
    row[1].set(ylabel="u on the main lens / mm", title=rf"dx/du = 1 - $\alpha$ = {true:+.3f}")
    row[2].set(ylabel=r"$\theta$ = (x - u)/F / mrad",
               title=rf"dx/d$\theta$ = F - F' = {apart * 1e3:+.1f} mm")
figure.supxlabel("slices: square root of the light by waves; dashed: the rays; "
                 "over physical angles the sign is the other one;\nyellow: "
                 "upper rim of the main lens")
run.save(figure)
