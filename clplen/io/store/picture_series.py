"""Series of linear pictures with a description, in OME-TIFF or OME-Zarr by the suffix."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import check_finite, float64_array
from clplen.errors import FormatError
from clplen.files import PathLike, require_file
from clplen.io.formats import tiff
from clplen.io.formats.untrusted import require_room
from clplen.io.store import zarr_files
from clplen.io.store.ome_tiff import CHANNELS, write_ome
from clplen.io.store.ome_zarr import write_omezarr
from clplen.io.store.picture_blocks import Array, Block
from clplen.io.store.zarr_files import open_checked, storage

Part = tuple[slice, slice, Array]

_ALL = slice(None)
_BLOCK_BYTES = 16 << 20  # of an OME-Zarr read at a time; at least one chunk high and deep
_ALTERNATIVE = "write .tif"
_MICROMETRES = ("µm", "micrometer")


def is_series(path: PathLike) -> bool:
    """Return True if the suffix is that of OME-TIFF or OME-Zarr."""
    return Path(path).suffix.lower() in (*tiff.SUFFIXES, zarr_files.SUFFIX)


def is_ome(path: PathLike) -> bool:
    """Return True for the suffixes ``.zarr`` and ``.ome.tif``."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    tiffs = ([".ome", suffix] for suffix in tiff.SUFFIXES)
    return suffixes[-1:] == [zarr_files.SUFFIX] or suffixes[-2:] in tiffs


def write_series(
    path: PathLike, blocks: Iterable[Block], what: str, *, replace: bool, **settings: Any
) -> None:
    """Write OME-TIFF or OME-Zarr, by the suffix; ``what`` is the subject of messages."""
    if not is_series(path):
        raise ValueError(f"{what} written as .tif or .zarr, got {Path(path).name}.")
    spacing = float64_array(settings.get("spacing") or ())
    check_finite(spacing=spacing[~np.isnan(spacing)])
    if Path(path).suffix.lower() == zarr_files.SUFFIX:
        write_omezarr(path, blocks, replace=replace, **settings)
    else:
        write_ome(path, blocks, **settings)


@dataclass(frozen=True)
class OpenSeries:
    """Pictures of an open file and their description."""

    shape: tuple[int, ...]  # (n, y, x) or (n, y, x, c)
    dtype: np.dtype[Any]  # as stored
    # Return an iterator over (planes, rows, values), values of shape (planes, rows, x[, c]).
    parts: Callable[[], Iterator[Part]]
    # Description passed to `write_series`; empty for files of other programs.
    about: dict[str, Any] = field(default_factory=dict)
    pixel: tuple[float, float] | None = None  # (dy, dx) in metres, if stored
    axes: str = ""  # letters of the axes that an OME-Zarr names, in stored order

    def read(self, out: Array | None = None) -> Array:
        """Read all pictures, part by part, into an array."""
        out = np.empty(self.shape, self.dtype) if out is None else out
        with np.errstate(over="ignore", invalid="ignore"):  # casts of untrusted numbers
            for planes, rows, values in self.parts():
                part = out[planes, rows]
                part[...] = values.reshape(part.shape)
        return out


@contextmanager
def open_series(
    path: PathLike, *, what: str, kinds: str = ".tif and .zarr", max_bytes: int | None = None
) -> Iterator[OpenSeries]:
    """Open an OME-TIFF, an OME-Zarr, or a TIFF whose pages have equal shape."""
    path = Path(path)
    noun, suffix = what.partition(" ")[2], path.suffix.lower()
    require_file(path, noun, folder=True)
    with ExitStack() as files:
        with unreadable(path, noun):
            if suffix == zarr_files.SUFFIX:
                series = _open_zarr(files, path, what, max_bytes)
            elif suffix in tiff.SUFFIXES:
                series = _open_tiff(path, noun, max_bytes)
            else:
                raise ValueError(f"{noun}s are {kinds}")
        description, shape = read_description(path), series.shape
        if len(shape) == 3 and not series.axes and description.about.get(CHANNELS) == 1:
            shape = (*shape, 1)
        if len(shape) not in (3, 4) or series.dtype.kind not in "uif" or 0 in shape:
            raise FormatError(f"{path} is not a {noun}: it holds {series.dtype} of shape {shape}.")

        def parts() -> Iterator[Part]:
            with unreadable(path, noun):
                yield from series.parts()

        yield replace(
            series, shape=shape, parts=parts, about=description.about, pixel=description.pixel
        )


@contextmanager
def unreadable(path: Path, noun: str) -> Iterator[None]:
    """Turn any exception of a parser into a FormatError."""
    try:
        yield
    except FormatError:
        raise
    except Exception as error:
        raise FormatError(f"{path} is not a readable {noun} ({str(error)[:200]}).") from error


def _open_tiff(path: Path, noun: str, max_bytes: int | None) -> OpenSeries:
    size = path.stat().st_size
    require_room(size, path=path, what=f"the {noun}", max_bytes=max_bytes)
    shape, dtype = tiff.stack_shape(path, max_bytes=max_bytes)

    def parts() -> Iterator[Part]:
        for number, picture in enumerate(tiff.read_tiff_pages(path, max_bytes=max_bytes)):
            yield slice(number, number + 1), _ALL, picture[None]

    return OpenSeries(shape, dtype, parts)


def _open_zarr(files: ExitStack, path: Path, what: str, max_bytes: int | None) -> OpenSeries:
    """Open an OME-Zarr at full size as (n, y, x[, c]), with the letters of its axes."""
    group = files.enter_context(open_checked(path, _ALTERNATIVE, max_bytes))
    level, axes = group["0"], axes_in(group)
    bound = storage(level, path, what, max_bytes)
    dtype, shape = np.dtype(level.dtype), tuple(int(n) for n in level.shape)
    nbytes = math.prod(shape) * dtype.itemsize
    bound.require(nbytes, what)
    if len(shape) == 2:
        return OpenSeries((1, *shape), dtype, lambda: iter([(_ALL, _ALL, level[...][None])]))
    colours = len(shape) == 4 and axes.startswith("c")
    chunks, axis = level.chunks, 1 if colours else 0  # axis of the planes
    steps = chunks[axis], chunks[axis + 1]
    row_bytes = nbytes // max(1, math.prod(shape[axis : axis + 2]))  # in a plane
    rows = max(1, _BLOCK_BYTES // max(1, steps[0] * steps[1] * row_bytes)) * steps[1]

    def parts() -> Iterator[Part]:
        for plane, row in product(range(0, shape[axis], steps[0]), range(0, shape[axis + 1], rows)):
            block = slice(plane, plane + steps[0]), slice(row, row + rows)
            values = np.asarray(level[(slice(None),) * axis + block])
            yield *block, np.moveaxis(values, 0, -1) if colours else values

    return OpenSeries((*shape[1:], shape[0]) if colours else shape, dtype, parts, axes=axes)


def axes_in(group: Any) -> str:
    """Return the letters of the axes that an OME-Zarr names; empty without names."""
    try:
        return "".join(str(axis["name"])[:1].lower() for axis in multiscales(group)["axes"])
    except (KeyError, IndexError, TypeError):
        return ""


def multiscales(group: Any) -> dict[str, Any]:
    """Return the first pyramid description of an OME-Zarr, OME-NGFF 0.4 or 0.5."""
    attributes = dict(group.attrs)
    return dict(attributes.get("ome", attributes)["multiscales"][0])


@dataclass(frozen=True)
class SeriesDescription:
    """Description of the pictures in a file; empty or None where not stored."""

    about: dict[str, Any] = field(default_factory=dict)  # passed to `write_series`
    pixel: tuple[float, float] | None = None  # (dy, dx) in metres
    planes: tuple[float, float] | None = None  # z of plane 0 and plane distance in metres


def read_description(path: PathLike) -> SeriesDescription:
    """Return the description of the pictures in a file; empty if the file does not exist."""
    path = Path(path)
    try:
        if path.suffix.lower() != zarr_files.SUFFIX:
            root = ome_of(path)
            return _description(_about_of_ome(root), *_steps_of_ome(root))
        with open_checked(path, _ALTERNATIVE) as group:
            about = group.attrs.get("clplen") if "0" in group else {}
            return _description(about, *_steps_of_zarr(group))
    except Exception:  # foreign or missing file
        return SeriesDescription()


def describe_series(path: PathLike) -> dict[str, Any]:
    """Return the description passed to `write_series`; empty if the file does not exist."""
    return read_description(path).about


def _description(about: Any, first: float, steps: dict[str, Any]) -> SeriesDescription:
    """Build a SeriesDescription from steps in micrometres."""
    sizes = {}
    for axis, step in steps.items():
        try:
            sizes[axis] = 1e-6 * float(step)
        except (TypeError, ValueError):
            continue
    sizes = {axis: size for axis, size in sizes.items() if 0 < size < math.inf}
    return SeriesDescription(
        dict(about) if isinstance(about, dict) else {},
        (sizes["y"], sizes["x"]) if {"y", "x"} <= set(sizes) else None,
        (1e-6 * first, sizes["z"]) if "z" in sizes and math.isfinite(first) else None,
    )


def ome_of(path: Path) -> ET.Element:
    """Return the OME description of a TIFF."""
    with tiff.open_tiff(path) as file:
        text = file.pages.first.description or "<OME/>"
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # may expand without limit
        raise ValueError("a description with entities")
    return ET.fromstring(text)


def _about_of_ome(root: ET.Element) -> Any:
    texts = (item.text for item in root.iter() if item.tag.endswith("Description"))
    try:
        return json.loads(next(texts) or "")
    except (StopIteration, ValueError, RecursionError):
        return {}


def _steps_of_ome(root: ET.Element) -> tuple[float, dict[str, Any]]:
    pixels = next((item for item in root.iter() if item.tag.endswith("Pixels")), None)
    if pixels is None:
        return 0.0, {}
    sizes = {axis: pixels.get(f"PhysicalSize{axis.upper()}") for axis in "zyx"}
    units = {axis: pixels.get(f"PhysicalSize{axis.upper()}Unit", "µm") for axis in "zyx"}
    return 0.0, {axis: size for axis, size in sizes.items() if units[axis] in _MICROMETRES}


def _steps_of_zarr(group: Any) -> tuple[float, dict[str, Any]]:
    try:
        scales = multiscales(group)
        units = {str(axis["name"]): axis.get("unit") for axis in scales["axes"]}
        transformations = {}
        for transformation in scales["datasets"][0]["coordinateTransformations"]:
            for name in {"scale", "translation"} & set(transformation):
                transformations[name] = dict(zip(units, transformation[name], strict=True))
        first = float(transformations.get("translation", {}).get("z", 0))
        steps = transformations["scale"].items()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        return 0.0, {}
    return first, {axis: step for axis, step in steps if units[axis] in _MICROMETRES}
