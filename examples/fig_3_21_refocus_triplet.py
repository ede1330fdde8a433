"""Figure 3.21: the three points refocused at alpha = .7368, 1 and 1.1724."""

import numpy as np
from common import number, pixels, start

from clplen import LightField, demo, plot, refocus

# Peaks of each point over the highest of the rendering, at the three alphas.
PEAKS = {"A": (0.2653, 0.0525, 0.0260), "B": (0.0467, 1, 0.0933), "C": (0.0245, 0.0831, 0.2061)}

example = start(__doc__, __file__)
camera = example.camera
lf = LightField.from_raw(demo.scene(camera))
images = [refocus(lf, alpha=alpha) for alpha in demo.REFOCUS_ALPHAS]
highest = pixels(lf.render()).max()
for name, references in PEAKS.items():
    x, y = (round(place) for place in demo.array_position(camera, name))
    for alpha, image, reference in zip(demo.REFOCUS_ALPHAS, images, references, strict=True):
        peak = pixels(image)[y - 8 : y + 9, x - 8 : x + 9].max() / highest
        number(f"{name}: peak at alpha = {alpha:.4f}", peak, reference, 2e-3)

titles = [rf"$\alpha$ = {alpha:.4f}: {name} in focus"
          for name, alpha in zip(PEAKS, demo.REFOCUS_ALPHAS, strict=True)]
places = np.array([demo.array_position(camera, name) for name in PEAKS])
part = slice(round(places.min()) - 11, round(places.max()) + 12)
figure = plot.refocused(images, titles, scale="log", region=(part, part))
for axes in figure.axes[: len(images)]:
    axes.set(xlabel="x / lenslets", ylabel="y / lenslets" if axes is figure.axes[0] else "")
    for name, place in zip(PEAKS, places, strict=True):
        axes.annotate(name, place, (18, 12), textcoords="offset points", color="w")
example.save(figure)
