"""Figure 3.7: two renderings of one raw image, with the full aperture and with 2 pixels of it."""

import numpy as np
from common import BLUE, ORANGE, number, pixels, start
from drawing import bar, new_figure
from extended import camera, card, compare, expose, show

from clplen import LightField, demo

KEPT = (30, 24, 18, 12, 6, 2)  # N'
TOTALS = (1, 0.791, 0.493, 0.214, 0.0463, 0.00466)  # of A + B + C, in a float64 simulation
GEOMETRY = (1, 0.788, 0.453, 0.201, 0.0503, 0.0056)  # the pupil's disc inside the square

example = start(__doc__, __file__)
points = LightField.from_raw(demo.scene(example.camera))
totals = [pixels(points.render(aperture=n, total=True)).sum() for n in KEPT]
for n, total, reference in list(zip(KEPT, totals, TOTALS, strict=True))[1:]:
    number(f"points A, B, C: total with N' = {n}", total / totals[0], reference, 3e-3, ".4f")

cam = camera(example, pixels=30)
scene = card(cam)
lf = LightField.from_raw(expose(cam, scene))
count = lf.shape[0]
kept = [round(n * count / 30) for n in KEPT]
seen = [pixels(lf.render(aperture=n, total=True)).sum() for n in kept]
figure = new_figure(11.4, 3.9)
*panels, right = figure.subplots(1, 3)
for axes, n in zip(panels, (count, 2), strict=True):
    mean = pixels(lf.render(aperture=n))
    compare(cam, scene, mean)
    drawn = show(axes, mean, cam.lenslet_pitch)
    total = pixels(lf.render(aperture=n, total=True)).sum() / seen[0]
    print(f"  the card, N' = {n}: {100 * total:.3g} % of the light, mean {mean.mean():.3e}")
    axes.set_title(f"N' = {n}: {100 * total:.3g} % of the light")
    bar(figure, drawn, axes, "mean of the views")
right.plot(KEPT, GEOMETRY, "k-", lw=1, label="pupil's disc in a square")
right.plot(KEPT, np.array(totals) / totals[0], "o", color=BLUE, label="three points, N = 30")
right.plot(np.array(kept) * 30 / count, np.array(seen) / seen[0], "x", color=ORANGE,
           label=f"the card, N = {count}")
right.set(xlabel="30 N'/N", ylabel="total / total of the full aperture", yscale="log")
right.legend()
example.save(figure)
