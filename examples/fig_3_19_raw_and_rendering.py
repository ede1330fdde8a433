"""Figure 3.19: raw image of the three points, and the rendering of all views."""

import numpy as np
from common import number, pixels, start

from clplen import LightField, demo
from clplen.plot import base

MAXIMA = {"A": 8.9e-4, "B": 2.09e-3, "C": 1.13e-3}  # of the raw image, each point having energy 1


def show(axes, values, decades, pitch):
    """An image on a logarithmic scale, in mm from its middle."""
    norm = base.norm_of(values, "log", decades)
    return axes.imshow(base.for_display(values, norm), cmap=base.LIGHT, norm=norm,
                       extent=base.centred(values.shape, pitch * 1e3),
                       interpolation="antialiased", interpolation_stage="data")


example = start(__doc__, __file__)
camera = example.camera
raw = demo.scene(camera)
values, rendering = raw.to_numpy(), pixels(LightField.from_raw(raw).render())
number("sum of the raw image", values.sum(dtype=float), 3.0)

figure = base.new_figure(9.5, 7.6)
grid = figure.add_gridspec(2, 6, height_ratios=[1.45, 1])
left, right = figure.add_subplot(grid[0, :3]), figure.add_subplot(grid[0, 3:])
drawn = show(left, values, 5, camera.pixel_pitch)
base.bar(figure, drawn, left, "energy per pixel (logarithmic)", extend="min")
drawn = show(right, rendering, 3, camera.lenslet_pitch)
base.bar(figure, drawn, right, "mean of the views (logarithmic)", extend="min")
left.set(title="raw image", xlabel="x on the sensor / mm", ylabel="y on the sensor / mm")
right.set(title="rendering, one pixel a lenslet", xlabel="x on the lenslets / mm",
          ylabel="y on the lenslets / mm")
magnified = 1 + camera.lenslet_focal_length / camera.image_distance
pitch, reach = camera.lenslet_pitch * 1e3, 4.5 * camera.lenslet_pitch * 1e3
for column, (name, reference) in enumerate(MAXIMA.items()):
    centre = camera.image_of(demo.POINTS[name])[0] * 1e3
    for axes, (x, y) in ((left, centre * magnified), (right, centre)):
        axes.annotate(name, (x + reach, y - reach), color="w")
    x, y = centre * magnified
    panel = figure.add_subplot(grid[1, 2 * column : 2 * column + 2])
    show(panel, values, 5, camera.pixel_pitch)
    panel.set(xlim=(x - reach, x + reach), ylim=(y + reach, y - reach), xlabel="x / mm",
              title=f"raw image at {name}, lines between lenslets")
    for edge in pitch * (np.arange(camera.mla.count[0] + 1) - camera.mla.count[0] / 2):
        panel.axhline(edge, color="w", lw=0.4, alpha=0.5)
        panel.axvline(edge, color="w", lw=0.4, alpha=0.5)
    rows, columns = (np.abs(base.coordinates(n, camera.pixel_pitch) - c) < reach
                     for n, c in zip(raw.shape, (y, x), strict=True))
    number(f"{name}: largest pixel", values[np.ix_(rows, columns)].max(), reference, ".3g")
example.save(figure)
