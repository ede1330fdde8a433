"""Figure 1.8: the rays of figure 1.7 in phase space, whose boxes are p wide and du high."""

import numpy as np
import rays
from common import BLUE, GREEN, RED, begin, number
from drawing import bar, new_figure
from matplotlib.patches import Rectangle

from clplen import LightField, PointSources
from clplen.lightfield import phase_space

POINTS = {"A": 7, "B": 3}  # their lenslets
COLOURS = (GREEN, RED, BLUE)  # pixels 1, 2, 3

run = begin(__doc__, __file__)
camera = rays.standard(run)
F, p = camera.image_distance, camera.mla.pitch * 1e6
places = [-rays.centres(camera)[k] * camera.object_distance / F for k in POINTS.values()]
raw = camera.expose(PointSources([(x, 0.0, 0.0) for x in places]), model="rays")
lf = LightField.from_raw(raw)
found = phase_space(lf, y=5, v=1)
light = np.maximum(lf.to_numpy().astype(float).sum(axis=(0, 2)), 0)  # summed over v and y
du, u, x = -lf.spacing[1] * 1e6, found.direction * 1e6, found.position * 1e6
number("a box: p / um", x[1] - x[0], p, 1e-3, ".3f")
number("a box: du = dx F/f_mu / um", du, 120, 1e-3, ".3f")
number("light of A and B in their six boxes", light[:, list(POINTS.values())].sum() / light.sum(),
       1, 0.02, ".3f")

figure = new_figure(10, 4.4)
left, right = figure.subplots(1, 2, sharey=True, width_ratios=[1, 1.12])
for k in range(1, 10):
    for n in range(3):
        mine = k in POINTS.values()
        left.add_patch(Rectangle((x[k] - p / 2, u[n] - du / 2), p, du, ec="0.4", lw=0.8,
                                 fc=COLOURS[n] if mine else "w", alpha=0.75 if mine else 1))
        left.text(x[k] - 0.06 * p * mine, u[n] - 0.3 * du, f"{k}, {n + 1}", va="center", size=8,
                  ha="right" if mine else "center",
                  color="w" if mine else "0.5", weight="bold" if mine else "normal")
edges = (x[1] - p / 2, x[9] + p / 2, u[2] - du / 2, u[0] + du / 2)
drawn = right.imshow(light[:, 1:10], extent=(*edges[:2], *edges[2:]), cmap="gray_r", vmin=0,
                     aspect="auto")
for axes in (left, right):
    for name, k in POINTS.items():
        axes.plot([x[k]] * 2, [u[2] - 0.65 * du, u[0] + 0.65 * du], "-", lw=1.2,
                  color="k" if axes is left else "c", zorder=1.5)
        axes.text(x[k], u[0] + 0.7 * du, name, ha="center", weight="bold")
        axes.plot(np.full(3, x[k]), u, "o", mfc="w", mec="k", ms=4)
    axes.set(xlabel="x on the array / um", xlim=edges[:2], ylim=(1.3 * edges[2], 1.3 * edges[3]))
left.set(ylabel="u on the main lens / um", yticks=u[::-1],
         title="boxes (x, u) = (lenslet, pixel): what a pixel takes in")
right.set_title("the same from a raw image of A and B (by rays), summed over y and v")
bar(figure, drawn, right, "light in a box")
figure.supxlabel("lines: all rays of a point in focus; dots: the three rays of figure 1.7. A pixel "
                 "farther up sees the lens farther down")
run.save(figure)
