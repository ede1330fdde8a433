"""Figure 3.19: raw image of the three points, and the rendering of all views."""

import numpy as np
from common import new_figure, number, pixels, start
from matplotlib.colors import LogNorm

from clplen import LightField, demo, plot

NAMES = tuple(demo.POINTS)
MAXIMA = dict(zip(NAMES, (8.9e-4, 2.09e-3, 1.13e-3), strict=True))


def show(figure, axes, values, extent, decades, label):
    """An image in mm on a logarithmic scale."""
    norm = LogNorm(values.max() * 10.0**-decades, values.max())
    drawn = axes.imshow(np.maximum(values, norm.vmin), cmap=plot.LIGHT, norm=norm, extent=extent,
                        interpolation="antialiased", interpolation_stage="data")
    if label:
        figure.colorbar(drawn, ax=axes, label=label, extend="min", shrink=0.85, pad=0.02)


example = start(__doc__, __file__)
camera = example.camera
raw = demo.scene(camera)
rendering = pixels(LightField.from_raw(raw).render())
values = raw.to_numpy()
number("sum of the raw image", values.sum(dtype=float), 3.0)
magnified = 1 + camera.lenslet_focal_length / camera.image_distance
centres = {name: camera.image_of(demo.POINTS[name])[0] * 1e3 for name in NAMES}
half = camera.grid.extent[0] * 500
extent = (-half, half, half, -half)

figure = new_figure(9.5, 7.6)
grid = figure.add_gridspec(2, 6, height_ratios=[1.45, 1])
left, right = figure.add_subplot(grid[0, :3]), figure.add_subplot(grid[0, 3:])
show(figure, left, values, extent, 5, "energy per pixel (logarithmic)")
show(figure, right, rendering, extent, 3, "mean of the views (logarithmic)")
left.set(title="raw image", xlabel="x on the sensor / mm", ylabel="y on the sensor / mm")
right.set(title="rendering: one pixel a lenslet", xlabel="x on the lenslets / mm")
for column, name in enumerate(NAMES):
    x, y = centres[name] * magnified
    panel, reach = figure.add_subplot(grid[1, 2 * column : 2 * column + 2]), 4.5 * raw.pixel_pitch
    show(figure, panel, values, extent, 5, "")
    reach = 4.5 * camera.lenslet_pitch * 1e3
    panel.set(xlim=(x - reach, x + reach), ylim=(y + reach, y - reach), title=f"raw image at {name}")
    rows, columns = (np.abs(np.linspace(-half, half, n, endpoint=False) - c) < reach
                     for n, c in zip(raw.shape, (y, x), strict=True))
    number(f"{name}: largest pixel of the raw image", values[np.ix_(rows, columns)].max(),
           MAXIMA[name], ".3e")
    for axes, scale in ((left, magnified), (right, 1)):
        axes.annotate(name, centres[name] * scale, (14, 10), textcoords="offset points", color="w")
example.save(figure)
