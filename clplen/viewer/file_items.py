"""What files hold, as items of a page: light fields, raw images, stacks, volumes, maps."""

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
_MOST_SAMPLES = 40_000_000  # of a page whose light field is read part by part
# Options that tell that a file is a light field.
_TELLING = ("views", "pattern", "white", "grid", "calibration", "order", "positions", "lattice")


class FocusedImage(Protocol):
    """A raw image of a focused camera, and the white image of its camera where one is given."""

    raw: Any
    white: Values | None

    @property
    def flat(self) -> Values | None:
        """The white image, of one channel."""


@dataclass(frozen=True)
class PageBuilder:
    """How files become the items of a page."""

    content: Content  # what items are added to
    options: PageOptions
    layout: dict[str, Any]  # words of layout as the command line has them
    selector: str | None  # of the device
    depth: bool  # whether the depth map of a light field is computed
    # Path -> `FocusedImage` and its planes m, or None for other files.
    focused: Callable[[Path], tuple[FocusedImage, Values] | None]
    note: Callable[[str], None]  # says a sentence to the user
    depth_file: Path | None = None  # where the depth map is read from instead
    # Bytes for a light field that is read part by part, of which the page has coarser views.
    memory: int | None = None
    # Files that stay open as long as the page is served.
    held: ExitStack = field(default_factory=ExitStack)
    # Those that were shown, in the order of their items.
    light_fields: list[LightField | StoredLightField] = field(default_factory=list)

    def device(self) -> Device:
        from clplen.compute.device import Device

        return Device.open(self.selector)

    def items(self, source: Path) -> list[Item]:
        """The items of a file or folder."""
        if not source.exists():
            raise FormatError(f"There is no file or folder {source}.")
        focused = None if self._is_ordinary(source) else self.focused(source)
        if focused is not None:
            return self._of_focused(*focused, source.stem)
        meant = any(self.layout[word] for word in _TELLING)
        item = None if meant else self._described(source)
        if item is not None:
            return [item]
        try:
            return [self.light_field(source)]
        except (ClplenError, ValueError):
            item = None if meant else self._undescribed(source)
            if item is None:
                raise
            return [item]

    def _is_ordinary(self, source: Path) -> bool:
        """Whether a raw image is that of a 1.0 camera, which decodes to a light field."""
        from clplen.io import read_raw
        from clplen.io.raw.raw_files import is_raw_file

        if not is_raw_file(source):
            return False
        camera = read_raw(source, device=self.device()).camera
        return camera is not None and camera.kind != "focused"

    def light_field(self, source: Path) -> Item:
        """A light field of any kind that `read_lightfield` knows."""
        from clplen.io import open_lightfield, read_lightfield
        from clplen.io.page.light_field_item import light_field_item

        device, options, depth = self.device(), self.options, None
        lf: LightField | StoredLightField
        if self.memory is None:
            lf = read_lightfield(source, device=device, **self.layout)
            depth = self._depth(lf)
        else:
            lf = self.held.enter_context(open_lightfield(source, device=device, **self.layout))
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
        given = words_of(self.layout)
        item["command"] = {"input": str(source), "options": option_words(given)}
        item["python"] = _python("lf = clplen.read_lightfield", source, given)
        return item

    def _depth(self, lf: LightField) -> DepthMap | None:
        from clplen.io import read_depth
        from clplen.lightfield.focus_and_depth import depth_map

        if self.depth_file is not None:
            found = read_depth(self.depth_file)
            if found.disparity.shape != lf.shape[2:4]:
                sizes = [f"{y} x {x}" for y, x in (found.disparity.shape, lf.shape[2:4])]
                raise FormatError(
                    f"{self.depth_file} has {sizes[0]} pixels (y, x), the views have {sizes[1]}: "
                    "give the map of this light field."
                )
            return found
        if not self.depth or np.count_nonzero(lf.weights) < 2:
            return None
        try:
            return depth_map(lf)
        except ClplenError as error:
            self.note(f"the page has no depth map: {error}")
            return None

    def _described(self, source: Path) -> Item | None:
        """What tells by itself that it is a stack, a volume or a map; None if nothing does."""
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

    def _undescribed(self, source: Path) -> Item | None:
        """Pictures of other programs; None if there are none."""
        from clplen.io.formats import picture

        suffix = source.suffix.lower()
        try:
            if suffix in _SERIES:
                return self._volumes_in_time(source) or self._series(source, {})
            return self._picture(source) if suffix in picture.SUFFIXES else None
        except (ClplenError, ValueError):
            return None

    def _series(self, source: Path, about: dict[str, Any]) -> Item:
        """A focal stack, a volume, or other pictures that are alike, of one time or several."""
        from clplen.io.formats import tiff
        from clplen.io.page.volume_item import volume_item
        from clplen.io.store.picture_series import open_series

        with open_series(source, what="a series", max_bytes=self.layout["max_bytes"]) as series:
            values, call = series.read(), "read_volume"
        words: dict[str, Any] = {"dtype": values.dtype}
        voxel: tuple[float | None, float, float] | None = None
        if series.pixel is not None:
            voxel = (None, *series.pixel)
        if "disparities" in about:
            alphas = about.get("alphas") or [None]
            ratio = ("alpha", "", np.array(alphas, np.float64))
            plain = ("disparity", "", np.array(about["disparities"], np.float64))
            words["planes"] = plain if None in alphas else ratio
            call = "read_stack"
        if series.axes[:2] != "tz" or values.ndim != 4:
            is_tiff = source.suffix.lower() in tiff.SUFFIXES
            times = tiff.stack_axes(source)["T"] if is_tiff else 1
            if series.axes[:2] == "tz":
                times = len(values)
            times = times if len(values) % times == 0 else 1
            values = values.reshape(times, -1, *values.shape[1:])
        item = volume_item(values, self.content, voxel=voxel, **words, **self._words(source))
        item["python"] = f"data = clplen.io.{call}({str(source)!r})"
        return item

    def _volumes_in_time(self, source: Path) -> Item | None:
        """Volumes of several times, or of one channel; None if there are none."""
        from clplen.io import open_volumes

        try:
            series = open_volumes(source, max_bytes=self.layout["max_bytes"])
        except (ClplenError, ValueError):
            return None
        is_one = len(series) > 1 or (series.shape[1] > 1 and series.planes is not None)
        return self._volumes(source) if is_one else None

    def _volumes(self, source: Path) -> Item:
        """Volumes with the places of their voxels, of one time or several."""
        from clplen.io import open_volumes
        from clplen.io.formats.untrusted import require_room
        from clplen.io.page.html_page import step_of
        from clplen.io.page.volume_item import volume_item

        series = open_volumes(source, max_bytes=self.layout["max_bytes"])
        total = 8 * math.prod(series.shape)
        limit = self.layout["max_bytes"]
        require_room(total, path=source, what="the series", max_bytes=limit)
        values = np.stack(list(series))
        words: dict[str, Any] = {"dtype": values.dtype, "table": "magma"}
        if series.planes is not None and len(series.planes) > 1:
            words["planes"] = ("z", "m", series.planes)
        if series.voxel is not None:
            words["voxel"] = (step_of(series.planes), *series.voxel)
        item = volume_item(values, self.content, **words, **self._words(source))
        call = "read_volume" if len(series) == 1 else "open_volumes"
        item["python"] = f"data = clplen.io.{call}({str(source)!r})"
        return item

    def _words(self, source: Path) -> dict[str, Any]:
        return {"name": source.stem, "downscale": self.options.downscale}

    def _array(self, source: Path) -> Item | None:
        """A NumPy file of a map, picture or volume; None if it is a light field."""
        from clplen.io.formats.npy import map_npy

        values = map_npy(source, what="an array")
        if values.ndim >= 4:
            return None
        if values.ndim not in (2, 3) or values.dtype.kind not in "uif":
            raise FormatError(f"{source} holds {values.dtype} of shape {values.shape}: no picture.")
        return self._result(source, np.array(values), "numpy.load")

    def _map(self, source: Path) -> Item:
        """The disparity of a depth map."""
        from clplen.io import read_depth

        return self._result(source, read_depth(source), "clplen.io.read_disparity")

    def _picture(self, source: Path) -> Item:
        """An ordinary picture."""
        from clplen.io import read_picture

        return self._result(source, read_picture(source), "clplen.io.read_picture")

    def _result(self, source: Path, thing: Any, call: str) -> Item:
        """A depth map or an array, with the call that reads it."""
        from clplen.io.page.html_page import item_of

        item = item_of(thing, self.content, name=source.stem, depth=None, options=self.options)
        item["python"] = f"data = {call}({str(source)!r})"
        return item

    def _of_focused(self, opened: FocusedImage, ms: Values, name: str) -> list[Item]:
        """A raw image of a focused camera: everything in focus, planes, m, and the raw image."""
        from clplen.io.page.volume_item import volume_item
        from clplen.lightfield.focused.focused_depth import focused_depth, focused_maps
        from clplen.lightfield.focused.focused_picture import PictureGrid
        from clplen.lightfield.focused.focused_rendering import focused_stack, render_focused

        found = focused_depth(opened.raw, white=opened.flat)
        step = self.layout["step"]
        sharp = render_focused(
            opened.raw, method="depth", depth=found, white=opened.white, step=step
        )
        stack = focused_stack(opened.raw, ms=ms, white=opened.white, step=step)
        maps = focused_maps(
            opened.raw,
            found,
            grid=PictureGrid.over(found.geometry, found.geometry.patch(found.median), step),
        )
        shown: list[tuple[str, Values, dict[str, Any]]] = [
            ("sharp", sharp.to_numpy()[None, None], {}),
            ("planes", stack.to_numpy()[None], {"planes": ("m", "", ms)}),
            ("depth", maps.m[None, None], {"unit": "m = b/a", "table": "viridis"}),
            ("raw", opened.raw.to_numpy()[None, None], {}),
        ]
        n = self.options.downscale
        return [
            volume_item(values, self.content, name=f"{name}, {what}", downscale=n, **words)
            for what, values, words in shown
        ]


def series_of_times(items: list[Item], name: str) -> Item:
    """One item of several alike, one for each time."""
    first = items[0]
    same = all(
        item["kind"] == "volume" and item["shape"][1:] == first["shape"][1:] for item in items
    )
    if not same:
        raise ShapeError("--time takes volumes, stacks or pictures of one size, one file a time.")
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
    """So that a page holds the views of a light field."""
    return max(1, math.ceil(math.sqrt(math.prod(shape) / _MOST_SAMPLES)))


def words_of(layout: dict[str, Any]) -> dict[str, Any]:
    """The words of layout that were given."""
    from clplen.io.lightfields.layout import Layout

    return {
        name: value for name, value in Layout(**layout).user_options().items() if name != "force"
    }


def option_words(given: dict[str, Any]) -> list[str]:
    """Words of layout as the command line has them."""
    words: list[str] = []
    for name, value in given.items():
        option = f"--{name.replace('_', '-')}"
        if name == "devignette":
            words.append(option if value else "--no-devignette")
        elif value is True:
            words.append(option)
        elif isinstance(value, tuple):
            words += [option, *map(str, value)]
        else:
            words += [option, str(value)]
    return words


def _python(call: str, source: Path, given: dict[str, Any]) -> str:
    """A call that reads a file."""
    plain = {name: str(v) if isinstance(v, Path) else v for name, v in given.items()}
    words = "".join(f", {name}={value!r}" for name, value in plain.items())
    return f"{call}({str(source)!r}{words})"
