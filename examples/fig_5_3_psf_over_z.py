"""Figure 5.3: the image of a point over z: on the native plane, and behind the lenslets."""

import microscope as lfm
import numpy as np
from common import BLUE, RED, begin, number

from clplen import PointSources
from clplen.plot.base import LIGHT, bar, new_figure

DEPTHS = {-20e-6: (115, 21), -10e-6: (67, 9), 0.0: (40, 1), 10e-6: (67, 9), 20e-6: (115, 25)}
SHOWN = 7  # lenslets
LEAST = 0.01  # of the brightest lenslet: one that is lit

run = begin(__doc__, __file__, quick="fewer planes in the curves")
cam = lfm.camera(run)
p, dx = cam.mla.pitch, cam.pixel_pitch
n, side = round(cam.pixels_per_lenslet), SHOWN * p * 500
z = np.array(list(DEPTHS)) if run.quick else np.arange(-30, 31, 2) * 1e-6
z = np.union1d(z, list(DEPTHS))
points = [PointSources([(0, 0, one)]) for one in z]
native = [cam.objective.fields(one, cam.grid, run.device).intensity().to_numpy()[0].astype(float)
          for one in points]
sensor = [cam.expose(one).to_numpy().astype(float) for one in points]
rms = np.array([np.sqrt((one.sum(axis=0) * cam.grid.x**2).sum()) for one in native]) * 1e6
cells = [one.reshape(-1, n, len(one) // n, n).sum(axis=(1, 3)) for one in sensor]
lit = np.array([np.count_nonzero(one > LEAST * one.max()) for one in cells])

figure = new_figure(11.5, 7.4)
panels = figure.subplot_mosaic("abcde;fghij;kkkll", height_ratios=[1, 1, 0.9])
half, middle = SHOWN * n // 2 + 1, len(cam.grid.x) // 2
near = slice(middle - half, middle + half + 1)
for above, below, (depth, (radius, lenslets)) in zip("abcde", "fghij", DEPTHS.items(), strict=True):
    k = int(np.argmin(np.abs(z - depth)))
    number(f"z = {depth * 1e6:+.0f} um: rms of x on the native plane / um", rms[k], radius,
           0.02 * radius, ".1f")
    number(f"z = {depth * 1e6:+.0f} um: lenslets above 1 %", lit[k], lenslets, 0, ".0f")
    for axes, light in ((panels[above], native[k]), (panels[below], sensor[k])):
        reach = (half + 0.5) * dx * 1e3
        drawn = axes.imshow((light[near, near] / light.max()) ** 0.25, cmap=LIGHT, vmin=0, vmax=1,
                            extent=(-reach, reach, reach, -reach))
        for edge in (np.arange(SHOWN + 1) - SHOWN / 2) * p * 1e3:
            axes.axhline(edge, color="w", lw=0.3, alpha=0.6)
            axes.axvline(edge, color="w", lw=0.3, alpha=0.6)
        axes.set(xlim=(-side, side), ylim=(side, -side), xticks=[], yticks=[])
    panels[above].set_title(f"z = {depth * 1e6:+.0f} um" if depth else "z = 0")
for axes, found, colour, words, place in ((panels["k"], rms, BLUE, "rms of x / um", 0),
                                          (panels["l"], lit, RED, "lenslets above 1 %", 1)):
    axes.plot(z * 1e6, found, "-", color=colour, lw=1)
    axes.plot([one * 1e6 for one in DEPTHS], [one[place] for one in DEPTHS.values()], "ko", ms=4)
    axes.set(xlabel="z / um", ylabel=words, ylim=(0, None))
bar(figure, drawn, [panels[k] for k in "ej"], "(light / largest)^(1/4)")
panels["a"].set_ylabel("native plane")
panels["f"].set_ylabel("sensor")
figure.supxlabel(f"{SHOWN} x {SHOWN} lenslets of 125 um; dots: float64 simulation")
run.save(figure)
