"""Figure 1.4: a plenoptic camera: main lens, array of lenslets, sensor."""

import numpy as np
import rays
from common import BLUE, GREEN, ORANGE, begin, number
from drawing import new_figure
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

SHOWN = 5  # lenslets across, from the front


def front(axes: Axes, pitch: float, side: float, face: str, **lines: object) -> None:
    """Cells of a pitch that fill a square, seen from the front; in um from the axis."""
    axes.add_patch(Rectangle((-side / 2, -side / 2), side, side, fc=face, lw=0))
    edges = (np.arange(round(side / pitch) + 3) - round(side / pitch) // 2 - 1.5) * pitch
    edges = edges[np.abs(edges) < side / 2]
    axes.vlines(edges, -side / 2, side / 2, **lines)
    axes.hlines(edges, -side / 2, side / 2, **lines)
    axes.set(xlim=(-side / 2, side / 2), ylim=(-side / 2, side / 2), aspect="equal",
             xlabel="x / um")


run = begin(__doc__, __file__)
camera = rays.standard(run, pixels=15)
D, F, f_mu = camera.aperture_diameter, camera.image_distance, camera.sensor_distance
points = [(-rays.centres(camera)[k] * camera.object_distance / F, 0.0) for k in (5, 8)]
figure = new_figure(9, 6.4)
panels = figure.subplot_mosaic("aaa;bcd", height_ratios=[1.1, 1])
side = panels["a"]
z = rays.planes(camera) * 1e3
rays.stage(side, (-33, 38), (-0.33, 0.33))
rays.draw_camera(side, camera, pixels=False)
for point, colour, where in zip(points, (BLUE, ORANGE), ("on", "off"), strict=True):
    hits = rays.draw_rays(side, camera, point, np.linspace(-D, D, 5) / 2 * 0.999, colour)
    number(f"sub-image {where} the axis: width / um", np.ptp(hits[3]) / 0.999 * 1e6,
           D * f_mu / F * 1e6, 1e-3, ".3f")
rays.names(side, dict(zip(z, ("focused plane", "main lens", "array", "sensor"), strict=True)))
for start, end, text in zip(z, z[1:], ("2f", "F = 2f", r"$f_\mu$"), strict=False):
    rays.distance(side, start, end, f"{text} = {end - start:.0f} mm")
pitch = camera.mla.pitch * 1e6 * (1 + f_mu / F)
number("pitch of the sub-images / um", pitch, 60, 1e-9, ".3f")

front(panels["b"], camera.mla.pitch * 1e6, pitch * SHOWN, rays.GLASS, color=rays.RIM, lw=1)
panels["b"].set(title="the array from the front", ylabel="y / um")
front(panels["c"], camera.pixel_pitch * 1e6, pitch * SHOWN, "0.93", color="0.75", lw=0.3)
front(panels["d"], camera.pixel_pitch * 1e6, pitch, "0.93", color="0.6", lw=0.8)
for axes in (panels["c"], panels["d"]):
    for k in range(-2, 3):
        for i in range(-2, 3):
            axes.add_patch(Circle((k * pitch, i * pitch), D * f_mu / F * 5e5, fc=GREEN, alpha=0.3))
panels["c"].set_title("the sensor: an image of the\nmain lens behind each lenslet")
panels["d"].set_title("one of them: 15 x 15 pixels,\na direction each")
rays.say_scale(figure, side, where="top:")
run.save(figure)
