"""Figure 1.17: rendering sums up the directions of each place: columns of the (x, u) slice."""

import numpy as np
from common import BLUE, GREEN, RED, begin, number, pixels
from drawing import LIGHT, bar, new_figure
from extended import show

from clplen import LightField, MicrolensArray, PlenopticCamera, SurfaceScene
from clplen.cameras import Bars, Plane, uniform

GROUPS = {"far": (14, -0.16), "in focus": (0, 0.0), "near": (-14, 0.22)}  # X and d, lenslets
COLOURS = dict(zip(GROUPS, (RED, GREEN, BLUE), strict=True))

run = begin(__doc__, __file__)
array = MicrolensArray(150e-6, 10e-3, count=45, fill="full")
cam = PlenopticCamera.type1(focal_length=0.12, mla=array, wavelength=532e-9, pixels_per_lenslet=20,
                            device=run.device)
bars = [Plane(d, texture=uniform(1.0), outline=Bars((0, X), 30, count=2, period=6, width=3))
        for X, d in GROUPS.values()]
lf = LightField.from_raw(cam.expose(SurfaceScene(bars), model="rays"))
views, picture = lf.to_numpy().astype(float), pixels(lf.render())
count, rows, columns = lf.shape[0], *lf.shape[2:]
row = rows // 2
found = views[:, :, row].sum(axis=0)  # (u, x), summed over v
line, p, du = found.sum(axis=0) / count**2, cam.lenslet_pitch * 1e3, abs(lf.spacing[1]) * 1e3
worst = np.abs(line - picture[row]).max() / picture.max()
number("row of the rendering less the columns' sums", worst, 0, 1e-5, ".6f")
x, u = (np.arange(columns) - (columns - 1) / 2) * p, -(np.arange(count) - (count - 1) / 2) * du
for name, (X, d) in GROUPS.items():
    near = np.abs(x - X * p) < 6.4 * p
    inner = np.abs(u) < 1.2
    place = (found[inner][:, near] * x[near]).sum(axis=1) / found[inner][:, near].sum(axis=1)
    number(f"bars {name}: dx/du", np.polyfit(u[inner], place, 1)[0], d * p / du, 0.005, ".3f")

figure = new_figure(10.5, 6.4)
panels = figure.subplot_mosaic("ps;pl", width_ratios=[1, 1.7], height_ratios=[1.5, 1])
show(panels["p"], picture, cam.lenslet_pitch)
panels["p"].axhline(0, color="c", lw=1.2, ls="--")
panels["p"].set_title("rendering, and one of its rows")
side, end = columns * p / 2, count * du / 2
drawn = panels["s"].imshow(found / count, cmap=LIGHT, vmin=0, extent=(-side, side, -end, end),
                           aspect="auto", interpolation="nearest")
edges = (np.arange(columns + 1) - columns / 2) * p
panels["s"].vlines(edges, -end, end, color="w", lw=0.2, alpha=0.6)
panels["s"].hlines(np.linspace(-end, end, count + 1), -side, side, color="w", lw=0.2, alpha=0.6)
panels["l"].stairs(line, edges, color="0.8", fill=True)
panels["l"].stairs(line, edges, color="k")
for name, (X, _) in GROUPS.items():
    chosen = columns // 2 + X + 2
    panels["s"].axvspan(*edges[chosen:chosen + 2], fill=False, ec="c", lw=1.5)
    panels["l"].axvspan(*edges[chosen:chosen + 2], color="c", alpha=0.35)
    panels["l"].text(X * p, line.max() * 1.06, name, ha="center", color=COLOURS[name])
panels["s"].set(ylabel="u on the main lens / mm", xlim=(side, -side),
                title="slice (x, u) of this row, in boxes p x du, mean over v")
panels["l"].set(xlim=(side, -side), ylim=(0, 1.2 * line.max()), ylabel="mean over u and v",
                xlabel="x / mm")
bar(figure, drawn, panels["s"], "value of a sample")
run.save(figure)
