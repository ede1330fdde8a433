"""OME-Zarr of linear float32 pictures in chunks, with a pyramid for display and a description.

OME-NGFF 0.4 (Moore et al., Nature Methods 18, 1496, 2021; https://ngff.openmicroscopy.org/0.4) in
Zarr format 2, written with the package zarr. Chunks are not compressed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import fits_float64
from clplen.errors import FormatError, worded
from clplen.files import PathLike, check_space, filling
from clplen.io.formats.untrusted import reading
from clplen.io.store.picture_blocks import Array, Block, checked_blocks, write_rows
from clplen.io.store.zarr_files import FORMAT_2, open_checked, storage, zarr_package
from clplen.lightfield.raw.raw_image import Spacing
from clplen.outputs import MARK

_ALTERNATIVE = "write .tif"
_MAX_CHUNK = 512  # pixels along y and x
_MAX_LAST_LEVEL = 256  # pixels along the longer side of the last level
_COLOURS = ("FF0000", "00FF00", "0000FF")
_WHITE = "FFFFFF"

Limits = list[tuple[float, float]]  # smallest and largest value of each channel


def write_omezarr(
    path: PathLike,
    blocks: Iterable[Block],
    *,
    shape: tuple[int, ...],
    axes: str,
    description: dict[str, Any],
    spacing: Spacing | None,
    channels: tuple[str, ...] = (),
    depth: float | None = None,
    positions: Sequence[float] = (),
    durable: bool = False,
    replace: bool = False,
) -> None:
    """Write float32 pictures as an OME-Zarr image with its pyramid.

    Axes follow OME-NGFF: a colour stack (n, y, x, 3) is stored as (c, z, y, x). Level 0 has the
    samples; each further level averages 2 x 2 pixels (fewer at an odd edge), until the longer side
    has at most 256. Memory use is one block, one of its planes and a few chunks.
    """
    _zarr()
    sizes = level_sizes(shape, axes)
    first = positions[0] if depth is not None and positions else 0.0
    _require_replaceable(Path(path), sizes[0], replace)
    check_space(path, 4 * sum(map(math.prod, sizes)))
    with filling(path, durable, replace=True) as folder:
        levels = [
            create_level(folder, str(number), size, (*(1 for _ in size[:-2]), *chunk_sides(size)))
            for number, size in enumerate(sizes)
        ]
        with closing(checked_blocks(blocks, shape)) as parts:
            limits = _fill(folder / "0", levels[0].chunks, parts, axes, len(channels))
        for finer, coarser in pairwise(levels):
            _halve(finer, coarser)
        names = channels or _names(shape)
        group = _zarr().open_group(_zarr().storage.LocalStore(folder), mode="a", **FORMAT_2)
        group.attrs.update(
            {
                "multiscales": [multiscales(Path(path), sizes, axes, spacing, depth, first)],
                "omero": omero(names, limits, colour=not channels and len(names) == 3),
                "clplen": description,
                "software": MARK,
            }
        )


def _require_replaceable(target: Path, size: tuple[int, ...], replace: bool) -> None:
    """Raise FileExistsError unless the target is absent, empty or a replaceable OME-Zarr."""
    inode = _inode(target)
    if inode is None:
        return
    stored_size, is_empty = _size_of(target), target.is_dir() and not list(target.glob("*"))
    if _inode(target) != inode:  # another process has just replaced it
        _require_replaceable(target, size, replace)
    elif stored_size is None and not is_empty:
        raise FileExistsError(
            f"{target} exists already and is not an OME-Zarr: choose another name."
        )
    elif stored_size not in (None, size) and not replace:
        raise FileExistsError(
            f"{target} exists already with shape {stored_size} instead of {size}: "
            + worded(python="replace it (replace=True)", command="remove it", file="remove it")
            + ", or choose another name."
        )


def _inode(target: Path) -> int | None:
    """Return the inode of a folder, or None if it does not exist."""
    try:
        return target.stat().st_ino
    except FileNotFoundError:
        return None


def _size_of(target: Path) -> tuple[int, ...] | None:
    """Return the full-size shape of an OME-Zarr, or None for anything else."""
    try:
        with open_checked(target, _ALTERNATIVE) as group:
            attributes = dict(group.attrs)
            (first, *_) = attributes.get("ome", attributes)["multiscales"]
            return tuple(int(n) for n in group[first["datasets"][0]["path"]].shape)
    except Exception:  # zarr raises any exception on other data
        return None


def level_sizes(shape: tuple[int, ...], axes: str) -> list[tuple[int, ...]]:
    """Return the shapes of the levels, in the order of the stored axes."""
    planes, ny, nx, *colours = shape
    leading = (*colours, planes) if axes[0] in "ZC" else tuple(colours)
    sizes = [(*leading, ny, nx)]
    while max(ny, nx) > _MAX_LAST_LEVEL:
        ny, nx = -(-ny // 2), -(-nx // 2)
        sizes.append((*leading, ny, nx))
    return sizes


def chunk_sides(size: tuple[int, ...]) -> tuple[int, int]:
    """Return rows and columns of a chunk, chosen so that chunks are of nearly equal size."""
    rows, columns = (-(-n // -(-n // _MAX_CHUNK)) for n in size[-2:])
    return rows, columns


def create_level(folder: Path, name: str, size: tuple[int, ...], chunks: tuple[int, ...]) -> Any:
    """Create an uncompressed float32 array."""
    return _zarr().create(
        size,
        chunks=chunks,
        dtype="<f4",
        store=_zarr().storage.LocalStore(folder),  # a name may look like a URL
        path=name,
        compressor=None,
        fill_value=0,
        dimension_separator="/",
        **FORMAT_2,
    )


def _fill(
    folder: Path, chunks: tuple[int, ...], blocks: Iterable[Block], axes: str, channels: int
) -> Limits:
    """Write the blocks picture by picture; return the range of each channel."""
    limits = [(math.inf, -math.inf)] * max(channels, 1)
    for planes, rows, columns, values in blocks:
        for plane, picture in zip(range(planes.start, planes.stop), values, strict=True):
            plane_index = (plane,) if axes[0] in "ZC" else ()
            channel = plane if channels else 0
            limits[channel] = _wider(limits[channel], picture)
            for leading, samples in _pictures(plane_index, picture):
                inside = folder.joinpath(*map(str, leading))
                _write_picture(inside, chunks[-2:], rows.start, columns.start, samples)
    return limits


def _write_picture(
    folder: Path, sides: tuple[int, ...], top: int, left: int, picture: Array
) -> None:
    """Write a picture into the chunks of a plane that it overlaps.

    Chunks are raw samples: rows are written in place; zarr would rewrite the whole chunk.
    """
    height, width = sides
    ny, nx = picture.shape
    for i in range(top // height, -(-(top + ny) // height)):
        (folder / str(i)).mkdir(parents=True, exist_ok=True)
        for k in range(left // width, -(-(left + nx) // width)):
            y, x = max(top, i * height), max(left, k * width)  # start of the part in this chunk
            part = picture[y - top : (i + 1) * height - top, x - left : (k + 1) * width - left]
            name = folder / str(i) / str(k)
            with name.open("r+b" if name.exists() else "w+b") as file:
                file.truncate(4 * height * width)
                start = 4 * ((y - i * height) * width + x - k * width)
                write_rows(file, part.astype("<f4", copy=False), start=start, step=4 * width)


def _pictures(index: tuple[int, ...], picture: Array) -> Iterator[tuple[tuple[int, ...], Array]]:
    """Yield the colours of a picture with their leading indices."""
    if picture.ndim == 2:
        yield index, picture
    else:
        for colour in range(picture.shape[2]):
            yield (colour, *index), picture[..., colour]


def _wider(limits: tuple[float, float], picture: Array) -> tuple[float, float]:
    """Return a range extended to the finite values of a picture."""
    low, high = float(picture.min()), float(picture.max())
    if not (fits_float64(low) and fits_float64(high)):
        finite = picture[np.isfinite(picture)]
        if finite.size == 0:
            return limits
        low, high = float(finite.min()), float(finite.max())
    return min(limits[0], low), max(limits[1], high)


def _halve(finer: Any, coarser: Any) -> None:
    """Write the means of 2 x 2 pixels, chunk by chunk."""
    sides = coarser.chunks[-2:]
    for leading in np.ndindex(*coarser.shape[:-2]):
        for rows, columns in _tiles(coarser.shape[-2:], sides):
            target = (*leading, rows, columns)
            source = (*leading, *(slice(2 * part.start, 2 * part.stop) for part in (rows, columns)))
            coarser[target] = means(np.asarray(finer[source]))


def _tiles(shape: tuple[int, ...], sides: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    for top in range(0, shape[0], sides[0]):
        for left in range(0, shape[1], sides[1]):
            yield (
                slice(top, min(top + sides[0], shape[0])),
                slice(left, min(left + sides[1], shape[1])),
            )


def means(values: Array) -> Array:
    """Return the means of 2 x 2 pixels, or of the available pixels at an odd edge."""
    ny, nx = values.shape
    even = np.pad(values, ((0, ny % 2), (0, nx % 2)), mode="edge")
    with np.errstate(invalid="ignore"):  # NaN and infinite pixels
        rows = even[::2] + even[1::2]
        return np.float32(0.25) * (rows[:, ::2] + rows[:, 1::2])


def multiscales(
    path: Path,
    sizes: list[tuple[int, ...]],
    axes: str,
    spacing: Spacing | None,
    depth: float | None,
    first: float,
) -> dict[str, Any]:
    """Return axes and coordinate transformations; pixels of level k are 2^k times as large."""
    letters = ("C" if axes.endswith("S") else "") + axes.removesuffix("S")
    pixel = (1.0, 1.0) if spacing is None else tuple(abs(step) * 1e6 for step in spacing[2:])
    plane_distance = 1.0 if depth is None else abs(depth) * 1e6
    leading = [plane_distance if letter == "Z" else 1.0 for letter in letters[:-2]]
    offsets = [first * 1e6 if letter == "Z" else 0.0 for letter in letters[:-2]]
    datasets = []
    for level, _ in enumerate(sizes):
        scale = leading + [2**level * step for step in pixel]
        shift = offsets + [(2**level - 1) / 2 * step for step in pixel]
        transformations: list[dict[str, Any]] = [{"type": "scale", "scale": scale}]
        if level or first:
            transformations.append({"type": "translation", "translation": shift})
        datasets.append({"path": str(level), "coordinateTransformations": transformations})
    return {
        "version": "0.4",
        "name": path.name.partition(".")[0],
        "type": "mean of 2 x 2",
        "axes": [
            _axis(letter, (depth if letter == "z" else spacing) is not None)
            for letter in letters.lower()
        ],
        "datasets": datasets,
    }


def _axis(letter: str, has_unit: bool) -> dict[str, str]:
    axis = {"name": letter, "type": {"t": "time", "c": "channel"}.get(letter, "space")}
    if letter in "zyx" and has_unit:
        axis["unit"] = "micrometer"
    return axis


def _names(shape: tuple[int, ...]) -> tuple[str, ...]:
    """Return the names of the samples of a pixel."""
    if shape[3:] == (3,):
        return ("red", "green", "blue")
    return tuple(f"intensity {i}" for i in range(shape[3])) if shape[3:] else ("intensity",)


def omero(names: tuple[str, ...], limits: Limits, *, colour: bool) -> dict[str, Any]:
    """Return the display settings of the channels; colours share a range and are shown together."""
    channels = []
    for index, name in enumerate(names):
        low, high = limits[index if len(limits) > 1 else 0]
        if not low < high:  # constant or empty picture
            low, high = (low, low + 1) if fits_float64(low) else (0.0, 1.0)
        channels.append(
            {
                "label": name,
                "active": colour or index == 0,
                "color": _COLOURS[index] if colour else _WHITE,
                "window": {"start": low, "end": high, "min": low, "max": high},
            }
        )
    return {"channels": channels, "rdefs": {"model": "color" if colour else "greyscale"}}


def read_omezarr_channel(path: PathLike, index: int, *, max_bytes: int | None = None) -> Array:
    """Read a channel (y, x) of an OME-Zarr (c, y, x), at full size."""
    path = Path(path)
    with open_checked(path, _ALTERNATIVE, max_bytes) as root, reading(path):
        level: Any = root.get("0")
        shape = getattr(level, "shape", ())
        if len(shape) != 3:
            raise FormatError(
                f"{path} is not a depth map in OME-Zarr: its array '0' must have shape (c, y, x), "
                f"got {shape}."
            )
        bound = storage(level, path, "its full size", max_bytes)
        bound.require(math.prod(shape[1:]) * level.dtype.itemsize, "a channel")
        return np.asarray(level[index])


def _zarr() -> Any:
    return zarr_package(_ALTERNATIVE)
