"""Series of linear pictures in OME-TIFF or OME-Zarr, by the suffix, with what is said of them."""

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
from clplen.io.store.zarr_files import opened_store, storage

Part = tuple[slice, slice, Array]

_ALL = slice(None)
_BLOCK = 16 << 20  # bytes of an OME-Zarr read at a time, at least one chunk high and deep
_INSTEAD = "write .tif"
_MICROMETRES = ("µm", "micrometer")


def is_series(path: PathLike) -> bool:
    """Whether a name is one of OME-TIFF or OME-Zarr, by its suffix."""
    return Path(path).suffix.lower() in (*tiff.SUFFIXES, zarr_files.SUFFIX)


def is_ome(path: PathLike) -> bool:
    """Whether a name is one of OME-Zarr, or of an OME-TIFF that says so (``.ome.tif``)."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    tiffs = ([".ome", suffix] for suffix in tiff.SUFFIXES)
    return suffixes[-1:] == [zarr_files.SUFFIX] or suffixes[-2:] in tiffs


def write_series(
    path: PathLike, blocks: Iterable[Block], what: str, *, replace: bool, **known: Any
) -> None:
    """Write OME-TIFF or OME-Zarr, by the suffix; messages call it ``what``."""
    if not is_series(path):
        raise ValueError(f"{what} written as .tif or .zarr, not as {Path(path).name}.")
    spacing = float64_array(known.get("spacing") or ())
    check_finite(spacing=spacing[~np.isnan(spacing)])
    if Path(path).suffix.lower() == zarr_files.SUFFIX:
        write_omezarr(path, blocks, replace=replace, **known)
    else:
        write_ome(path, blocks, **known)


@dataclass(frozen=True)
class OpenSeries:
    """Pictures of an open file, and what it says of them."""

    shape: tuple[int, ...]  # (n, y, x) or (n, y, x, c)
    dtype: np.dtype[Any]  # as stored
    # Returns an iterator over (planes, rows, values), values of shape (planes, rows, x[, c]).
    parts: Callable[[], Iterator[Part]]
    # The description that `write_series` was given; empty for files of other programs.
    about: dict[str, Any] = field(default_factory=dict)
    pixel: tuple[float, float] | None = None  # (dy, dx) in metres, where the file says them
    axes: str = ""  # a letter for each axis that an OME-Zarr names, in its own order; else empty

    def read(self, out: Array | None = None) -> Array:
        """Read all pictures, into a given array part by part."""
        out = np.empty(self.shape, self.dtype) if out is None else out
        with np.errstate(over="ignore", invalid="ignore"):  # casts of hostile numbers
            for planes, rows, values in self.parts():
                part = out[planes, rows]
                part[...] = values.reshape(part.shape)
        return out


@contextmanager
def open_series(
    path: PathLike, *, what: str, kinds: str = ".tif and .zarr", max_bytes: int | None = None
) -> Iterator[OpenSeries]:
    """Open an OME-TIFF, an OME-Zarr, or a TIFF whose pages are alike."""
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
        said, shape = read_description(path), series.shape
        if len(shape) == 3 and not series.axes and said.about.get(CHANNELS) == 1:
            shape = (*shape, 1)
        if len(shape) not in (3, 4) or series.dtype.kind not in "uif" or 0 in shape:
            raise FormatError(f"{path} holds {series.dtype} of shape {shape}, no {noun}.")

        def parts() -> Iterator[Part]:
            with unreadable(path, noun):
                yield from series.parts()

        yield replace(series, shape=shape, parts=parts, about=said.about, pixel=said.pixel)


@contextmanager
def unreadable(path: Path, noun: str) -> Iterator[None]:
    """Make a FormatError of what parsers raise on damaged files."""
    try:
        yield
    except FormatError:
        raise
    except Exception as error:
        raise FormatError(f"{path} is no {noun} that can be read ({str(error)[:200]}).") from error


def _open_tiff(path: Path, noun: str, max_bytes: int | None) -> OpenSeries:
    size = path.stat().st_size
    require_room(size, path=path, what=f"the {noun}", max_bytes=max_bytes)
    shape, dtype = tiff.stack_shape(path, max_bytes=max_bytes)

    def parts() -> Iterator[Part]:
        for number, picture in enumerate(tiff.read_tiff_pages(path, max_bytes=max_bytes)):
            yield slice(number, number + 1), _ALL, picture[None]

    return OpenSeries(shape, dtype, parts)


def _open_zarr(files: ExitStack, path: Path, what: str, max_bytes: int | None) -> OpenSeries:
    """The full size of an OME-Zarr as (n, y, x) or (n, y, x, c), and the letters of its axes."""
    group = files.enter_context(opened_store(path, _INSTEAD, max_bytes))
    level, axes = group["0"], axes_in(group)
    bound = storage(level, path, what, max_bytes)
    dtype, shape = np.dtype(level.dtype), tuple(int(n) for n in level.shape)
    nbytes = math.prod(shape) * dtype.itemsize
    bound.require(nbytes, what)
    if len(shape) == 2:
        return OpenSeries((1, *shape), dtype, lambda: iter([(_ALL, _ALL, level[...][None])]))
    colours = len(shape) == 4 and axes.startswith("c")
    chunks, axis = level.chunks, 1 if colours else 0  # of the planes
    steps = chunks[axis], chunks[axis + 1]
    row_bytes = nbytes // max(1, math.prod(shape[axis : axis + 2]))  # of one plane
    rows = max(1, _BLOCK // max(1, steps[0] * steps[1] * row_bytes)) * steps[1]

    def parts() -> Iterator[Part]:
        for plane, row in product(range(0, shape[axis], steps[0]), range(0, shape[axis + 1], rows)):
            place = slice(plane, plane + steps[0]), slice(row, row + rows)
            values = np.asarray(level[(slice(None),) * axis + place])
            yield *place, np.moveaxis(values, 0, -1) if colours else values

    return OpenSeries((*shape[1:], shape[0]) if colours else shape, dtype, parts, axes=axes)


def axes_in(group: Any) -> str:
    """A letter for each axis of an OME-Zarr; empty where it names none."""
    try:
        return "".join(str(axis["name"])[:1].lower() for axis in multiscales(group)["axes"])
    except (KeyError, IndexError, TypeError):
        return ""


def multiscales(group: Any) -> dict[str, Any]:
    """The first description of an OME-Zarr's pyramid, of OME-NGFF 0.4 or 0.5."""
    attributes = dict(group.attrs)
    return dict(attributes.get("ome", attributes)["multiscales"][0])


@dataclass(frozen=True)
class SeriesDescription:
    """What a file says of its pictures; empty or None where it says nothing."""

    about: dict[str, Any] = field(default_factory=dict)  # what `write_series` was given
    pixel: tuple[float, float] | None = None  # (dy, dx) in metres
    planes: tuple[float, float] | None = None  # z of plane 0 and the distance of planes, in metres


def read_description(path: PathLike) -> SeriesDescription:
    """What a file says of its pictures; nothing if there is no such file."""
    path = Path(path)
    try:
        if path.suffix.lower() != zarr_files.SUFFIX:
            root = ome_of(path)
            return _described(_about_of_ome(root), *_steps_of_ome(root))
        with opened_store(path, _INSTEAD) as group:
            about = group.attrs.get("clplen") if "0" in group else {}
            return _described(about, *_steps_of_zarr(group))
    except Exception:  # what other programs wrote, or nothing
        return SeriesDescription()


def describe_series(path: PathLike) -> dict[str, Any]:
    """What `write_series` was given as description; empty if there is no such file."""
    return read_description(path).about


def _described(about: Any, first: float, steps: dict[str, Any]) -> SeriesDescription:
    """Steps are those of axes whose unit is a micrometre."""
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
    """The OME description of a TIFF."""
    with tiff.open_tiff(path) as file:
        text = file.pages.first.description or "<OME/>"
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # could claim any amount of memory
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
        moves = {}
        for move in scales["datasets"][0]["coordinateTransformations"]:
            for name in {"scale", "translation"} & set(move):
                moves[name] = dict(zip(units, move[name], strict=True))
        first = float(moves.get("translation", {}).get("z", 0))
        steps = moves["scale"].items()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        return 0.0, {}
    return first, {axis: step for axis, step in steps if units[axis] in _MICROMETRES}
