"""A heart, a star and a moon of lights at three distances, through a plenoptic camera by waves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clplen import plot
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.device import Device
from clplen.files import replacing
from clplen.io import write_depth, write_html, write_lightfield, write_picture, write_stack
from clplen.lightfield.depth.depth_maps import DepthMap
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.lightfield.stacks import focal_stack
from clplen.outputs import MARK
from clplen.plot.depths import distances as distance_figure
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.intensity import add_scaled

Array = np.ndarray[Any, np.dtype[np.float64]]

FOCUS = 0.40  # distance of the plane in focus from the main lens, in metres
LIGHTS_PER_THING = 80
FIELD = 0.46  # half width of the scene over the width of the array
PLANES = 31  # number of planes of the focal stack and of the depth map
MIN_SEPARATION = 6  # pixels from other things at which the distance of a thing is read
TITLE = "A heart, a star and a moon of lights"
MIN_BRIGHTNESS = 0.1  # brightness of a light, relative to the brightest pixel
FILES = (  # that `run` writes
    "demo.html", "depth.pfm", "depth.png", "lightfield.h5", "raw.png", "raw.tif", "refocused.png",
    "stack.tif", "tables.txt", "views.png",
)  # fmt: skip


@dataclass(frozen=True)
class Thing:
    """A closed outline that carries lights, across the optical axis.

    Attributes
    ----------
    name : str
        Name in titles and tables.
    distance : float
        Distance from the main lens in metres.
    centre : tuple of float
        (x, y) of its middle in the picture, from -1 to 1, y downwards.
    size : float
        Radius in the picture, where the picture reaches from -1 to 1.
    outline : numpy.ndarray
        Corners (x, y) of the outline, shape (n, 2), radius about 1.
    """

    name: str
    distance: float
    centre: tuple[float, float]
    size: float
    outline: Array

    @property
    def dz(self) -> float:
        """Distance behind the plane in focus, in metres; negative in front of it."""
        return self.distance - FOCUS

    def lights(self) -> Array:
        """Return the equally spaced positions (x, y) of the lights in the picture, shape (n, 2)."""
        corners = np.vstack([self.outline, self.outline[:1]])
        lengths = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        at = np.arange(LIGHTS_PER_THING) / LIGHTS_PER_THING * lengths[-1]
        positions = np.stack([np.interp(at, lengths, axis) for axis in corners.T], axis=-1)
        return np.asarray(self.centre) + self.size * positions


def heart() -> Array:
    """Return the outline of a heart."""
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    y = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)
    return np.stack([16 * np.sin(t) ** 3, -y], axis=-1) / 17


def star() -> Array:
    """Return the outline of a star of five rays."""
    angles = (np.arange(10) / 5 - 0.5) * np.pi
    radii = np.where(np.arange(10) % 2, 0.42, 1.0)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)


def moon(*, opening: float = 0.75, inner_radius: float = 0.78) -> Array:
    """Return the outline of a crescent: two arcs between tips at +-`opening` radians."""
    tip_x, tip_y = np.cos(opening), np.sin(opening)
    middle = tip_x - np.sqrt(inner_radius**2 - tip_y**2)
    inner_angle = np.arctan2(tip_y, tip_x - middle)
    outer = np.linspace(opening, 2 * np.pi - opening, 200)
    inner = np.linspace(2 * np.pi - inner_angle, inner_angle, 200)
    arcs = (
        np.stack([np.cos(outer), np.sin(outer)], axis=-1),
        np.stack([middle + inner_radius * np.cos(inner), inner_radius * np.sin(inner)], axis=-1),
    )
    return np.vstack(arcs)


THINGS = (
    Thing("heart", 0.30, (-0.40, 0.42), 0.50, heart()),
    Thing("star", 0.40, (0.04, 0.00), 0.58, star()),
    Thing("moon", 0.56, (0.46, -0.44), 0.50, moon()),
)
STEPS = 5 + len(THINGS)  # of `run`


def camera(device: Device, *, count: int = 101) -> Plenoptic1:
    """Return a camera of 50 mm at f/4.9, focused at 0.4 m, with 9 x 9 pixels a lenslet."""
    lenslets = MicrolensArray(100e-6, 560e-6, count=count, fill="full")
    return PlenopticCamera.type1(
        focal_length=50e-3,
        mla=lenslets,
        wavelength=550e-9,
        pixels_per_lenslet=9,
        object_distance=FOCUS,
        pixels=PixelArray(),
        device=device,
    )


def images_on_array(cam: Plenoptic1, thing: Thing) -> Array:
    """Return the images (x, y) of the lights on the array in lenslets from the axis."""
    return FIELD * cam.mla.count[0] * thing.lights()


def sources(cam: Plenoptic1, thing: Thing) -> PointSources:
    """Return the lights of a thing in front of a camera, so that its pictures show it upright."""
    positions = images_on_array(cam, thing) * cam.mla.pitch / float(cam.array_scale(thing.dz))
    return PointSources(np.column_stack([positions, np.full(len(positions), thing.dz)]))


def expose(cam: Plenoptic1, *, step: Callable[[str], None]) -> RawImage:
    """Return the raw image of all things, each light a wave of its own."""
    total = cam.device.zeros(cam.grid.shape, np.float32)
    for thing in THINGS:
        step(f"light of the {thing.name}")
        add_scaled(total, cam.expose(sources(cam, thing)).data, 1.0, cam.device)
    return cam.raw_image(total)


def estimate(cam: Plenoptic1, lf: LightField) -> tuple[DepthMap, Array]:
    """Return a depth map and the distances in metres where there is a light, else NaN."""
    nearest, farthest = (cam.alpha(thing.dz) for thing in (THINGS[0], THINGS[-1]))
    margin = 0.3 * (farthest - nearest)
    depth = depth_map(lf, alphas=np.linspace(nearest - margin, farthest + margin, PLANES))
    brightness = lf.render().to_numpy()
    bright = brightness > MIN_BRIGHTNESS * brightness.max()
    return depth, np.where(bright, FOCUS + depth.z, np.nan)


def measured(cam: Plenoptic1, distances: Array) -> dict[str, float]:
    """Return the median distance in metres on each thing, apart from the others' lights."""
    rows, columns = np.indices(distances.shape)
    near = {}
    for thing in THINGS:
        positions = images_on_array(cam, thing) + (cam.mla.count[0] - 1) / 2
        apart = [np.hypot(columns - x, rows - y) for x, y in positions]
        near[thing.name] = np.min(apart, axis=0)
    result = {}
    for name, apart in near.items():
        others = np.min([near[other] for other in near if other != name], axis=0)
        result[name] = float(np.nanmedian(distances[(apart < 1) & (others > MIN_SEPARATION)]))
    return result


def camera_table(cam: Plenoptic1) -> str:
    """Return what the camera is made of, a line for each part with what it is for."""
    ny, nx = cam.mla.count
    pixels = round(cam.pixels_per_lenslet)
    f_number = cam.focal_length / cam.aperture_diameter
    lens = f"{1e3 * cam.focal_length:g} mm at f/{f_number:.2g}"
    rows = (
        ("main lens", lens, "forms an image on the array of lenslets"),
        ("lenslets", f"{nx} x {ny}", "each sees one place of the image: a pixel of a picture"),
        ("behind each", f"{pixels} x {pixels} pixels", "each sees that place from one direction"),
        ("light field", f"{pixels} x {pixels} views", f"pictures of {nx} x {ny} pixels"),
    )
    return _table("A plenoptic camera, simulated by wave optics", rows)


def depth_table(estimates: dict[str, float]) -> str:
    """Return the true and the estimated distances of the things."""
    rows = []
    for thing in THINGS:
        value = estimates[thing.name]
        error = 100 * (value / thing.distance - 1)
        rows.append(
            (thing.name, f"{1e3 * thing.distance:.0f} mm", f"{1e3 * value:.0f} mm ({error:+.1f} %)")
        )
    return _table("Distance from the camera: true, and estimated from the light field", rows)


def _table(title: str, rows: Sequence[tuple[str, str, str]]) -> str:
    widths = [max(len(row[k]) for row in rows) for k in range(2)]
    lines = [f"  {a:{widths[0]}}  {b:{widths[1]}}  {c}" for a, b, c in rows]
    return "\n".join([title, *lines])


def run(
    folder: Path,
    device: Device,
    *,
    say: Callable[[str], None],
    step: Callable[[str], None],
    count: int = 101,
) -> None:
    """Simulate the exposure, process the light field, and write pictures, data and a page."""
    cam = camera(device, count=count)
    tables = [camera_table(cam)]
    say(tables[0])
    raw = expose(cam, step=step)
    step("light field")
    lf = LightField.from_raw(raw)
    write_picture(folder / "raw.tif", raw.to_numpy(), description="energy a pixel, linear")
    write_lightfield(folder / "lightfield.h5", lf)
    step("focal stack")
    alphas = [cam.alpha(thing.dz) for thing in THINGS]
    pictures = [refocus(lf, alpha=alpha) for alpha in alphas]
    stack = focal_stack(lf, alphas=np.linspace(alphas[0], alphas[-1], PLANES))
    write_stack(folder / "stack.tif", stack)
    step("depth")
    depth, distances = estimate(cam, lf)
    write_depth(folder / "depth.pfm", depth)
    tables.append(depth_table(measured(cam, distances)))
    say(tables[1])
    step("figures")
    titles = [f"focused on the {thing.name}" for thing in THINGS]
    plot.save(plot.raw_image(raw, details=_details(cam)), folder / "raw.png")
    mosaic = plot.views(lf, max_views=5, scale="root")
    mosaic.axes[0].set_title(_views_title(lf.shape[0]), fontsize="medium")
    plot.save(mosaic, folder / "views.png")
    triplet = plot.refocused(pictures, titles, scale="root")
    triplet.suptitle("One exposure, refocused on three distances")
    plot.save(triplet, folder / "refocused.png")
    chart = distance_figure(1e3 * distances)
    chart.axes[0].set_title(_distance_title(), fontsize="medium")
    plot.save(chart, folder / "depth.png")
    step("page")
    subjects = {
        "light field": lf,
        "focal stack": stack,
        "raw image": raw,
    }
    write_html(folder / "demo.html", subjects, title=TITLE, depth=depth)
    with replacing(folder / "tables.txt") as temporary:
        temporary.write_text("\n\n".join([*tables, f"{MARK}."]) + "\n", encoding="utf-8")


def _views_title(views: int) -> str:
    return (
        f"The scene seen from {views} x {views} points of the main lens (5 x 5 of them shown).\n"
        "The corner views are dark: they lie beyond the edge of the round lens."
    )


def _distance_title() -> str:
    true = ", ".join(f"{thing.name} {1e3 * thing.distance:.0f} mm" for thing in THINGS)
    return f"Estimated distance, less exact where outlines cross\n(true: {true})"


def _details(cam: Plenoptic1) -> dict[str, tuple[float, float]]:
    """Return a place (y, x) on the sensor in metres for each thing, on one of its lights."""
    pitch = cam.mla.pitch * (1 + cam.lenslet_focal_length / cam.image_distance)
    positions = {thing.name: pitch * images_on_array(cam, thing)[0] for thing in THINGS}
    return {name: (float(y), float(x)) for name, (x, y) in positions.items()}
