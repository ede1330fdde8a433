"""Figure 1.13: the array of views, the raw image's pixels in order of direction."""

import numpy as np
from common import begin, number
from drawing import LIGHT, bar, new_figure
from extended import QUICK, camera, card, expose, ideal, like, mosaic

from clplen import LightField

run = begin(__doc__, __file__, quick=QUICK)
cam = camera(run)
scene = card(cam)
raw = expose(cam, scene)
lf = LightField.from_raw(raw)
whole, count = mosaic(lf, slice(None), slice(None)), lf.shape[0]
kept = whole.sum(dtype=float) / raw.to_numpy().sum(dtype=float)
number("share of the raw image in the views", kept, 0.964, 0.02, ".3f")
middle = lf.view((count - 1) / 2, (count - 1) / 2).to_numpy()
number("middle of the views: correlation with the ideal", like(ideal(cam, scene), middle), 1, 0.02)

figure = new_figure(10.6, 9.6)
axes = figure.subplots()
drawn = axes.imshow(whole, cmap=LIGHT, vmin=0, interpolation="antialiased",
                    interpolation_stage="data", extent=(count, 0, 0, count))
ends = cam.aperture_diameter * 500
ticks = np.linspace(-ends, ends, 7)
places = count / 2 - ticks / (abs(lf.spacing[1]) * 1e3)
axes.set_xticks(places, [f"{tick:.1f}" for tick in ticks])
axes.set_yticks(places, [f"{tick:.1f}" for tick in ticks])
axes.set(xlabel="u on the main lens / mm", ylabel="v on the main lens / mm",
         title=f"{count} x {count} views of {lf.shape[3]} x {lf.shape[2]} pixels, each turned")
bar(figure, drawn, axes, "value of a sample")
run.save(figure)
