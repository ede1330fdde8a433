"""Figure 1.9: f-numbers matched and not: the sub-image of a point against its lenslet's cell."""

import numpy as np
from common import BLUE, GREEN, ORANGE, RED, begin, number
from drawing import LIGHT, bar, new_figure
from matplotlib.colors import PowerNorm
from matplotlib.patches import Polygon

from clplen import MicrolensArray, PlenopticCamera, PointSources
from clplen.analysis import crosstalk

DIAMETERS = {2.4: (0.14, RED), 3.6: (0.107, ORANGE), 4.8: (0.24, GREEN)}  # mm
COUNT, SHOWN, P, F_MU, F = 51, 3, 150.0, 10.0, 240.0  # lenslets, those shown, um, mm, mm

run = begin(__doc__, __file__)
array = MicrolensArray(P * 1e-6, F_MU * 1e-3, count=COUNT, fill="full")
outside, raws = {}, {}
for D in DIAMETERS if run.quick else sorted({*np.arange(12, 52, 3) / 10, *DIAMETERS}):
    camera = PlenopticCamera.type1(focal_length=F / 2e3, mla=array, wavelength=532e-9,
                                   aperture_diameter=D * 1e-3, device=run.device,
                                   pixels_per_lenslet=12 if run.quick else 20)
    raw = camera.expose(PointSources([(0, 0, 0)]))
    raws[D] = raw.to_numpy()
    outside[D] = crosstalk(raws[D], raw.cells, cell=(COUNT // 2, COUNT // 2))
for D, (expected, _) in DIAMETERS.items():
    number(f"D = {D:.1f} mm: light outside the cell", outside[D], expected, 0.02, ".3f")

figure = new_figure(10, 6.6)
panels = figure.subplot_mosaic("aaaxxx;bbccdd", height_ratios=[1, 1.3])
side, curve = panels["a"], panels["x"]
n, edge = SHOWN * round(camera.pixels_per_lenslet), SHOWN * P / 2
part = slice((camera.grid.shape[0] - n) // 2, (camera.grid.shape[0] + n) // 2)
lines, turn = (np.arange(SHOWN + 1) - SHOWN / 2) * P, np.linspace(0, 2 * np.pi, 99)
for axes, (D, (_, colour)) in zip([panels[k] for k in "bcd"], DIAMETERS.items(), strict=True):
    values, half = raws[D][part, part], D * 1e3 * F_MU / F / 2
    drawn = axes.imshow(values / values.max(), cmap=LIGHT, norm=PowerNorm(0.5, 0, 1),
                        extent=(-edge, edge, edge, -edge))
    axes.hlines(lines[1:-1], -edge, edge, color="w", lw=0.7)
    axes.vlines(lines[1:-1], -edge, edge, color="w", lw=0.7)
    axes.plot(half * np.cos(turn), half * np.sin(turn), color="c", lw=1, ls="--")
    axes.set(xlabel="x / um", ylabel="y / um" if D == 2.4 else "")
    axes.set_title(f"D = {D:.1f} mm: {outside[D]:.3f} outside", color=colour)
    side.add_patch(Polygon([(0, 0), (F_MU, half), (F_MU, -half)], fc=colour, alpha=0.4, lw=1.4,
                           ec=colour, zorder=5 - D))
    side.text(F_MU + 0.2, half - 9, f"{D:.1f} mm", color=colour, va="center")
    curve.plot(D, outside[D], "o", color=colour, ms=7, zorder=4)
bar(figure, drawn, panels["d"], "energy of a pixel / largest (square root)")
side.hlines(lines, 0, F_MU, color="0.6", lw=0.8, ls="--")
side.vlines([0] * SHOWN, lines[:-1] + 6, lines[1:] - 6, color=BLUE, lw=5)
side.vlines(F_MU, -edge, edge, color="k", lw=2)
side.set(xlabel="z from the array / mm", ylabel="x / um", xlim=(-0.5, 12), ylim=(-edge, edge),
         title="light of a point in focus, from the middle lenslet to the sensor")
curve.plot([*outside], [*outside.values()], color="0.4", lw=1)
curve.axvline(P * F / F_MU * 1e-3, color=ORANGE, lw=1, ls=":")
curve.set(xlabel="D, main lens / mm", ylabel="share of the light outside",
          ylim=(0, 1.08 * max(outside.values())), title="simulated; dotted: matched, D = p F/f")
figure.supxlabel("white, dashed grey: cells; dashed cyan: the geometrical image of the main lens")
run.save(figure)
