"""Figure 5.3: the image of a point over z: on the native plane, and behind the lenslets."""

import microscope as lfm
import numpy as np
from common import BLUE, GREEN, RED, begin, number
from drawing import bar, new_figure
from matplotlib.colors import LogNorm

from clplen import PointSources

DEPTHS = {-20e-6: (115, 21, 0.708), -10e-6: (67, 9, np.nan), 0.0: (40, 1, np.nan),
          10e-6: (67, 9, np.nan), 20e-6: (115, 25, 1.292)}  # float64 simulation
SHOWN = 7  # lenslets
LEAST = 0.01  # of the brightest lenslet: one that is lit

run = begin(__doc__, __file__, quick="fewer planes in the curves")
cam = lfm.camera(run)
n = round(cam.pixels_per_lenslet)
z = np.union1d(np.arange(-30, 31, 15 if run.quick else 2) * 1e-6, list(DEPTHS))
points = [PointSources([(0, 0, one)]) for one in z]
native = [cam.objective.fields(one, cam.grid, run.device).intensity().to_numpy()[0].astype(float)
          for one in points]
sensor = [cam.expose(one).to_numpy().astype(float) for one in points]
rms = np.array([np.sqrt((one.sum(axis=0) * cam.grid.x**2).sum()) for one in native]) * 1e6
cells = [one.reshape(-1, n, len(one) // n, n).sum(axis=(1, 3)) for one in sensor]
lit = np.array([np.count_nonzero(one > LEAST * one.max()) for one in cells])
apart = np.array([lfm.spot_pitch(cam, one, depth) for one, depth in zip(sensor, z, strict=True)])

figure = new_figure(11.5, 7.4)
upper, lower = figure.subfigures(2, 1, height_ratios=[1.9, 1])
panels, norm = upper.subplots(2, len(DEPTHS)), LogNorm(1e-4, 1)
for column, (depth, (radius, lenslets, pitch)) in zip(panels.T, DEPTHS.items(), strict=True):
    k, place = int(np.argmin(np.abs(z - depth))), f"z = {depth * 1e6:+.0f} um" if depth else "z = 0"
    number(f"{place}: rms of x on the native plane / um", rms[k], radius, 0.02 * radius, ".1f")
    number(f"{place}: lenslets above 1 %", lit[k], lenslets, 0, ".0f")
    if np.isfinite(pitch):
        number(f"{place}: pitch of the spots / p", apart[k], pitch, 0.003, ".3f")
    for axes, light in zip(column, (native[k], sensor[k]), strict=True):
        drawn = lfm.draw_frame(axes, cam, light, SHOWN, norm)
    column[0].set_title(place)
for axes, word in zip(panels[:, 0], ("native plane", "sensor"), strict=True):
    axes.set_ylabel(word)
bar(upper, drawn, panels, "light / largest")

known = list(zip(*DEPTHS.values(), strict=True))
curves = lower.subplots(1, 3)
lfm.draw_curve(curves[0], z, rms, BLUE, DEPTHS, known[0], "rms of x / um")
lfm.draw_curve(curves[1], z, lit, RED, DEPTHS, known[1], "lenslets above 1 %")
lfm.draw_curve(curves[2], z, apart, GREEN, DEPTHS, known[2], "pitch of the spots / p")
lfm.draw_pitch(curves[2], cam, z.max())
figure.supxlabel(f"{SHOWN} x {SHOWN} lenslets of 125 um; dots: float64 simulation; dashed: rays, "
                 r"$1 + n f_\mu/(M^2 z)$")
run.save(figure)
