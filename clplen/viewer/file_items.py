"""Items of a page from files: light fields, raw images, stacks, volumes, maps."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from clplen.errors import ClplenError, FormatError, ShapeError

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.io.page.light_field_item import PageOptions
    from clplen.io.page.samples import Content
    from clplen.lightfield.depth.depth_maps import DepthMap
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.stored_light_field import StoredLightField

Values = np.ndarray[Any, Any]
Item = dict[str, Any]

_SERIES = (".tif", ".tiff", ".zarr")
MAX_SAMPLES = 40_000_000  # of a light field in tiles; keeps the page small enough for browsers
# Options that apply to light fields only.
_LIGHT_FIELD_OPTIONS = (
    "views",
    "pattern",
    "white",
    "grid",
    "calibration",
    "order",
    "positions",
    "lattice",
)


class FocusedImage(Protocol):
    """Raw image of a focused camera, with the white image of the camera if available."""

    raw: Any
    white: Values | None

    @property
    def flat(self) -> Values | None:
        """White image with a single channel."""


@dataclass(frozen=True)
class PageBuilder:
    """Builder of the items of a page from files."""

    content: Content  # receives the items
    options: PageOptions
    layout: dict[str, Any]  # layout settings of the command line
    selector: str | None  # device
    depth: bool  # True to compute the depth maps of light fields
    # Path -> `FocusedImage` and its planes m, or None for other files.
    focused: Callable[[Path], tuple[FocusedImage, Values] | None]
    note: Callable[[str], None]  # prints a note for the user
    depth_file: Path | None = None  # depth map to read instead of computing it
    # Memory limit in bytes for light fields in tiles, whose views are downscaled in the page.
    memory: int | None = None
    # Files that stay open while the page is served.
    open_files: ExitStack = field(default_factory=ExitStack)
    # Light fields of the page, in the order of their items.
    light_fields: list[LightField | StoredLightField] = field(default_factory=list)

    def device(self) -> Device:
        from clplen.compute.device import Device

        return Device.open(self.selector)

    def items(self, source: Path) -> list[Item]:
        """Return the items of a file or folder."""
        if not source.exists():
            raise FormatError(f"The file or folder {source} does not exist: check its name.")
        focused = None if self._is_standard_raw(source) else self.focused(source)
        if focused is not None:
            return self._focused_items(*focused, source.stem)
        is_light_field = any(self.layout[name] for name in _LIGHT_FIELD_OPTIONS)
        item = None if is_light_field else self._self_describing_item(source)
        if item is not None:
            return [item]
        try:
            return [self.light_field(source)]
        except (ClplenError, ValueError):
            item = None if is_light_field else self._plain_item(source)
            if item is None:
                raise
            return [item]

    def _is_standard_raw(self, source: Path) -> bool:
        """Return True for a raw image of a standard camera, which decodes to a light field."""
        from clplen.io import read_raw
        from clplen.io.raw.raw_files import is_raw_file

        if not is_raw_file(source):
            return False
        camera = read_raw(source, device=self.device()).camera
        return camera is not None and camera.kind != "focused"

    def light_field(self, source: Path) -> Item:
        """Return the item of a light field in any format of `read_lightfield`."""
        from clplen.io import open_lightfield, read_lightfield
        from clplen.io.page.light_field_item import light_field_item

        device, options, depth = self.device(), self.options, None
        lf: LightField | StoredLightField
        if self.memory is None:
            lf = read_lightfield(source, device=device, **self.layout)
            depth = self._depth(lf)
        else:
            lf = self.open_files.enter_context(
                open_lightfield(source, device=device, **self.layout)
            )
            options = replace(options, downscale=max(options.downscale, _downscale(lf.shape)))
        self.light_fields.append(lf)
        item = light_field_item(
            lf,
            self.content,
            name=source.stem,
            options=options,
            device=device,
            depth=depth,
            depth_file=None if self.depth_file is None else str(self.depth_file),
            srgb=self.layout["srgb"] or getattr(lf, "linear", False),
        )
        settings = layout_settings(self.layout)
        item["command"] = {"input": str(source), "options": option_arguments(settings)}
        item["python"] = _python("lf = clplen.read_lightfield", source, settings)
        return item

    def _depth(self, lf: LightField) -> DepthMap | None:
        from clplen.io import read_depth
        from clplen.lightfield.focus_and_depth import depth_map

        if self.depth_file is not None:
            depth = read_depth(self.depth_file)
            if depth.disparity.shape != lf.shape[2:4]:
                sizes = [f"{y} x {x}" for y, x in (depth.disparity.shape, lf.shape[2:4])]
                raise FormatError(
                    f"{self.depth_file} has {sizes[0]} pixels (y, x), the views have {sizes[1]}: "
                    "give the map of this light field."
                )
            return depth
        if not self.depth or np.count_nonzero(lf.weights) < 2:
            return None
        try:
            return depth_map(lf)
        except ClplenError as error:
            self.note(f"the page has no depth map: {error}")
            return None

    def _self_describing_item(self, source: Path) -> Item | None:
        """Return the item of a file that stores its kind (stack, volume or map), else None."""
        from clplen.io.store.picture_series import describe_series

        suffix = source.suffix.lower()
        if suffix == ".npy":
            return self._array(source)
        if suffix == ".pfm":
            return self._map(source)
        about = describe_series(source) if suffix in _SERIES else {}
        if {"disparity", "confidence"} <= set(about):
            return self._map(source)
        if "disparities" in about:
            return self._series(source, about)
        return self._volumes(source) if "planes_um" in about else None

    def _plain_item(self, source: Path) -> Item | None:
        """Return the item of pictures from other programs, else None."""
        from clplen.io.formats import picture

        suffix = source.suffix.lower()
        try:
            if suffix in _SERIES:
                return self._volumes_in_time(source) or self._series(source, {})
            return self._picture(source) if suffix in picture.SUFFIXES else None
        except (ClplenError, ValueError):
            return None

    def _series(self, source: Path, about: dict[str, Any]) -> Item:
        """Return the item of a focal stack, a volume or a series of pictures."""
        from clplen.io.formats import tiff
        from clplen.io.page.volume_item import volume_item
        from clplen.io.store.picture_series import open_series

        with open_series(source, what="a series", max_bytes=self.layout["max_bytes"]) as series:
            values, call = series.read(), "read_volume"
        settings: dict[str, Any] = {"dtype": values.dtype}
        voxel: tuple[float | None, float, float] | None = None
        if series.pixel is not None:
            voxel = (None, *series.pixel)
        if "disparities" in about:
            alphas = about.get("alphas") or [None]
            ratio = ("alpha", "", np.array(alphas, np.float64))
            plain = ("disparity", "", np.array(about["disparities"], np.float64))
            settings["planes"] = plain if None in alphas else ratio
            call = "read_stack"
        if series.axes[:2] != "tz" or values.ndim != 4:
            is_tiff = source.suffix.lower() in tiff.SUFFIXES
            times = tiff.stack_axes(source)["T"] if is_tiff else 1
            if series.axes[:2] == "tz":
                times = len(values)
            times = times if len(values) % times == 0 else 1
            values = values.reshape(times, -1, *values.shape[1:])
        settings |= self._common_settings(source)
        item = volume_item(values, self.content, voxel=voxel, **settings)
        item["python"] = f"data = clplen.io.{call}({str(source)!r})"
        return item

    def _volumes_in_time(self, source: Path) -> Item | None:
        """Return the item of volumes of several times or a single channel, else None."""
        from clplen.io import open_volumes

        try:
            series = open_volumes(source, max_bytes=self.layout["max_bytes"])
        except (ClplenError, ValueError):
            return None
        is_one = len(series) > 1 or (series.shape[1] > 1 and series.planes is not None)
        return self._volumes(source) if is_one else None

    def _volumes(self, source: Path) -> Item:
        """Return the item of volumes with the positions of their voxels."""
        from clplen.io import open_volumes
        from clplen.io.formats.untrusted import require_room
        from clplen.io.page.html_page import step_of
        from clplen.io.page.volume_item import volume_item

        series = open_volumes(source, max_bytes=self.layout["max_bytes"])
        total = 8 * math.prod(series.shape)
        limit = self.layout["max_bytes"]
        require_room(total, path=source, what="the series", max_bytes=limit)
        values = np.stack(list(series))
        settings: dict[str, Any] = {"dtype": values.dtype, "table": "magma"}
        if series.planes is not None and len(series.planes) > 1:
            settings["planes"] = ("z", "m", series.planes)
        if series.voxel is not None:
            settings["voxel"] = (step_of(series.planes), *series.voxel)
        item = volume_item(values, self.content, **settings, **self._common_settings(source))
        call = "read_volume" if len(series) == 1 else "open_volumes"
        item["python"] = f"data = clplen.io.{call}({str(source)!r})"
        return item

    def _common_settings(self, source: Path) -> dict[str, Any]:
        return {"name": source.stem, "downscale": self.options.downscale}

    def _array(self, source: Path) -> Item | None:
        """Return the item of a NumPy file of a map, picture or volume; None for a light field."""
        from clplen.io.formats.npy import map_npy

        values = map_npy(source, what="an array")
        if values.ndim >= 4:
            return None
        if values.ndim not in (2, 3) or values.dtype.kind not in "uif":
            raise FormatError(
                f"{source} must hold a numeric array of two or three axes, got {values.dtype} of "
                f"shape {values.shape}."
            )
        return self._result(source, np.array(values), "numpy.load")

    def _map(self, source: Path) -> Item:
        """Return the item of the disparities of a depth map."""
        from clplen.io import read_depth

        return self._result(source, read_depth(source), "clplen.io.read_disparity")

    def _picture(self, source: Path) -> Item:
        """Return the item of a picture."""
        from clplen.io import read_picture

        return self._result(source, read_picture(source), "clplen.io.read_picture")

    def _result(self, source: Path, thing: Any, call: str) -> Item:
        """Return the item of a depth map or array, with the call that reads it."""
        from clplen.io.page.html_page import item_of

        item = item_of(thing, self.content, name=source.stem, depth=None, options=self.options)
        item["python"] = f"data = {call}({str(source)!r})"
        return item

    def _focused_items(self, image: FocusedImage, ms: Values, name: str) -> list[Item]:
        """Return all-in-focus picture, planes, m and raw image of a focused camera as items."""
        from clplen.io.page.volume_item import volume_item
        from clplen.lightfield.focused.focused_depth import focused_depth, focused_maps
        from clplen.lightfield.focused.focused_picture import PictureGrid
        from clplen.lightfield.focused.focused_rendering import focused_stack, render_focused

        depth = focused_depth(image.raw, white=image.flat)
        step = self.layout["step"]
        sharp = render_focused(image.raw, method="depth", depth=depth, white=image.white, step=step)
        stack = focused_stack(image.raw, ms=ms, white=image.white, step=step)
        maps = focused_maps(
            image.raw,
            depth,
            grid=PictureGrid.over(depth.geometry, depth.geometry.patch(depth.median), step),
        )
        pictures: list[tuple[str, Values, dict[str, Any]]] = [
            ("sharp", sharp.to_numpy()[None, None], {}),
            ("planes", stack.to_numpy()[None], {"planes": ("m", "", ms)}),
            ("depth", maps.m[None, None], {"unit": "m = b/a", "table": "viridis"}),
            ("raw", image.raw.to_numpy()[None, None], {}),
        ]
        n = self.options.downscale
        return [
            volume_item(values, self.content, name=f"{name}, {what}", downscale=n, **settings)
            for what, values, settings in pictures
        ]


def series_of_times(items: list[Item], name: str) -> Item:
    """Join the items of several times into a time series."""
    first = items[0]
    is_uniform = all(
        item["kind"] == "volume" and item["shape"][1:] == first["shape"][1:] for item in items
    )
    if not is_uniform:
        raise ShapeError(
            "--time needs volumes, stacks or pictures of equal size, one file per time."
        )
    levels = [(item["samples"]["low"], item["samples"]["step"]) for item in items]
    blobs = [blob for item in items for blob in item["samples"]["blobs"]]
    times = sum(item["shape"][0] for item in items)
    ends = np.array([item["shown"]["range"] for item in items])
    span = [float(ends[:, 0].min()), float(ends[:, 1].max())]
    white = max(item["shown"]["white"] for item in items)
    return {
        **first,
        "name": name,
        "shape": [times, *first["shape"][1:]],
        "samples": {**first["samples"], "blobs": blobs, "levels": levels},
        "shown": {**first["shown"], "white": white, "range": span},
    }


def _downscale(shape: tuple[int, ...]) -> int:
    """Return the downscaling factor that limits the samples of a page."""
    return max(1, math.ceil(math.sqrt(math.prod(shape) / MAX_SAMPLES)))


def layout_settings(layout: dict[str, Any]) -> dict[str, Any]:
    """Return the layout settings that differ from the defaults."""
    from clplen.io.lightfields.layout import Layout

    return {
        name: value for name, value in Layout(**layout).user_options().items() if name != "force"
    }


def option_arguments(settings: dict[str, Any]) -> list[str]:
    """Return layout settings as arguments of the command line."""
    arguments: list[str] = []
    for name, value in settings.items():
        option = f"--{name.replace('_', '-')}"
        if name == "devignette":
            arguments.append(option if value else "--no-devignette")
        elif value is True:
            arguments.append(option)
        elif isinstance(value, tuple):
            arguments += [option, *map(str, value)]
        else:
            arguments += [option, str(value)]
    return arguments


def _python(call: str, source: Path, settings: dict[str, Any]) -> str:
    """Return a Python call that reads a file."""
    plain = {name: str(v) if isinstance(v, Path) else v for name, v in settings.items()}
    arguments = "".join(f", {name}={value!r}" for name, value in plain.items())
    return f"{call}({str(source)!r}{arguments})"
