"""Figure 3.19: raw image of the three points, and the rendering of all views."""

import numpy as np
from common import number, pixels, start
from drawing import bar, coordinates, log_norm, new_figure, show
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from clplen import LightField, demo

MAXIMA = {"A": 8.936e-4, "B": 2.093e-3, "C": 1.135e-3}  # of the raw image, in a float64 simulation
SHOWN = 6.2  # mm to either side of the axis


def show_log(axes: Axes, values: np.ndarray, decades: int, pitch: float) -> AxesImage:
    """An image on a logarithmic scale, in mm from its middle."""
    norm = log_norm(values, decades)
    return show(axes, np.maximum(values, norm.vmin), pitch, norm=norm,
                interpolation="antialiased", interpolation_stage="data")


example = start(__doc__, __file__)
camera = example.camera
raw = demo.scene(camera)
values, rendering = raw.to_numpy(), pixels(LightField.from_raw(raw).render())
number("sum of the raw image", values.sum(dtype=float), 3.0, 1e-3)

figure = new_figure(9, 7.4)
above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.2, 1])[:, 0]
left, right = above.subplots(1, 2)
shown = min(SHOWN, camera.grid.extent[0] * 500)
bars = [(left, show_log(left, values, 5, camera.pixel_pitch), "energy per pixel"),
        (right, show_log(right, rendering, 3, camera.lenslet_pitch), "mean of the views")]
for axes, drawn, label in bars:
    bar(figure, drawn, axes, f"{label} (logarithmic)", extend="min")
    axes.set(xlim=(-shown, shown), ylim=(shown, -shown), xlabel="x / mm", ylabel="y / mm")
left.set_title("raw image, the middle of the sensor")
right.set_title("rendering, one pixel a lenslet")
magnified = 1 + camera.lenslet_focal_length / camera.image_distance
pitch, reach = camera.lenslet_pitch * 1e3, 4.5 * camera.lenslet_pitch * 1e3
for panel, (name, reference) in zip(below.subplots(1, 3), MAXIMA.items(), strict=True):
    centre = camera.image_of(demo.POINTS[name])[0] * 1e3
    right.text(centre[0] + reach, centre[1] - reach, name, color="w")
    x, y = centre * magnified
    left.text(x + reach, y - reach, name, color="w")
    show_log(panel, values, 5, camera.pixel_pitch)
    panel.set(xlim=(x - reach, x + reach), ylim=(y + reach, y - reach), xlabel="x / mm",
              ylabel="y / mm", title=f"raw image at {name}")
    panel.locator_params(nbins=5)
    for edge in pitch * (np.arange(camera.mla.count[0] + 1) - camera.mla.count[0] / 2):
        panel.axhline(edge, color="w", lw=0.5, alpha=0.6)
        panel.axvline(edge, color="w", lw=0.5, alpha=0.6)
    rows, columns = (np.abs(coordinates(n, camera.pixel_pitch) - c) < reach
                     for n, c in zip(raw.shape, (y, x), strict=True))
    number(f"{name}: largest pixel", values[np.ix_(rows, columns)].max(), reference, 3e-6, ".3e")
below.supxlabel("lines: borders between lenslets; colours as above")
example.save(figure)
