"""OME-Zarr: linear float32 pictures in chunks, with smaller ones to look at and their description.

OME-NGFF 0.4 (Moore et al., Nature Methods 18, 1496, 2021; https://ngff.openmicroscopy.org/0.4) in
Zarr format 2, by the package zarr. Chunks are not compressed.
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
from clplen.io.store.zarr_files import FORMAT_2, opened_store, storage, zarr_package
from clplen.lightfield.raw.raw_image import Spacing
from clplen.outputs import MARK

_INSTEAD = "write .tif"
_CHUNK = 512  # pixels along y and x, at most
_SMALLEST = 256  # pixels along the longer side of the last level, at most
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
    """Write pictures as one OME-Zarr image, float32, with its pyramid.

    The axes become those of OME-NGFF: a colour stack (n, y, x, 3) is stored (c, z, y, x). Level 0
    has the samples as they are; pixels of every further one are means of 2 x 2 (at an odd edge of
    what is there), until the longer side has at most 256. Besides a block no more than one plane
    of it and a few chunks are held.
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
    """Refuse what is there, unless it is nothing or an OME-Zarr that may go."""
    number = _number(target)
    if number is None:
        return
    found, is_empty = _size_of(target), target.is_dir() and not list(target.glob("*"))
    if _number(target) != number:  # another writer has just exchanged it
        _require_replaceable(target, size, replace)
    elif found is None and not is_empty:
        raise FileExistsError(f"{target} is there already and no OME-Zarr: choose another name.")
    elif found not in (None, size) and not replace:
        raise FileExistsError(
            f"{target} is there already with shape {found}, not {size}: "
            + worded(python="replace it (replace=True)", command="remove it", file="remove it")
            + ", or choose another name."
        )


def _number(target: Path) -> int | None:
    """What tells one folder of a name from the next one; None if there is none."""
    try:
        return target.stat().st_ino
    except FileNotFoundError:
        return None


def _size_of(target: Path) -> tuple[int, ...] | None:
    """The shape of an OME-Zarr at full size, None if it is none."""
    try:
        with opened_store(target, _INSTEAD) as group:
            attributes = dict(group.attrs)
            (first, *_) = attributes.get("ome", attributes)["multiscales"]
            return tuple(int(n) for n in group[first["datasets"][0]["path"]].shape)
    except Exception:  # the package raises all kinds on what is none
        return None


def level_sizes(shape: tuple[int, ...], axes: str) -> list[tuple[int, ...]]:
    """Shapes of the levels, in the order of the stored axes."""
    planes, ny, nx, *colours = shape
    leading = (*colours, planes) if axes[0] in "ZC" else tuple(colours)
    sizes = [(*leading, ny, nx)]
    while max(ny, nx) > _SMALLEST:
        ny, nx = -(-ny // 2), -(-nx // 2)
        sizes.append((*leading, ny, nx))
    return sizes


def chunk_sides(size: tuple[int, ...]) -> tuple[int, int]:
    """Return rows and columns of a chunk: equal ones, not full ones and a rest."""
    rows, columns = (-(-n // -(-n // _CHUNK)) for n in size[-2:])
    return rows, columns


def create_level(
    folder: Path, name: str, size: tuple[int, ...], chunks: tuple[int, ...]
) -> Any:
    """Create an array of float32 without compression."""
    return _zarr().create(
        size,
        chunks=chunks,
        dtype="<f4",
        store=_zarr().storage.LocalStore(folder),  # a name may look like an address
        path=name,
        compressor=None,
        fill_value=0,
        dimension_separator="/",
        **FORMAT_2,
    )


def _fill(
    folder: Path, chunks: tuple[int, ...], blocks: Iterable[Block], axes: str, channels: int
) -> Limits:
    """Write the blocks picture by picture; the range of each channel (of all the colours)."""
    limits = [(math.inf, -math.inf)] * max(channels, 1)
    for planes, rows, columns, values in blocks:
        for plane, picture in zip(range(planes.start, planes.stop), values, strict=True):
            place = (plane,) if axes[0] in "ZC" else ()
            channel = plane if channels else 0
            limits[channel] = _wider(limits[channel], picture)
            for leading, samples in _pictures(place, picture):
                inside = folder.joinpath(*map(str, leading))
                _put(inside, chunks[-2:], rows.start, columns.start, samples)
    return limits


def _put(folder: Path, sides: tuple[int, ...], top: int, left: int, picture: Array) -> None:
    """Write a picture into the chunks of a plane that it meets.

    A chunk without compression is a file of its samples row by row: so bands of rows that are
    lower than a chunk take their places in it, where the package would read and write it whole
    each time.
    """
    height, width = sides
    ny, nx = picture.shape
    for i in range(top // height, -(-(top + ny) // height)):
        (folder / str(i)).mkdir(parents=True, exist_ok=True)
        for k in range(left // width, -(-(left + nx) // width)):
            y, x = max(top, i * height), max(left, k * width)  # where this chunk's part begins
            part = picture[y - top : (i + 1) * height - top, x - left : (k + 1) * width - left]
            name = folder / str(i) / str(k)
            with name.open("r+b" if name.exists() else "w+b") as file:
                file.truncate(4 * height * width)
                start = 4 * ((y - i * height) * width + x - k * width)
                write_rows(file, part.astype("<f4", copy=False), start=start, step=4 * width)


def _pictures(place: tuple[int, ...], picture: Array) -> Iterator[tuple[tuple[int, ...], Array]]:
    """The colours of a picture apart, with their places in front of the rows."""
    if picture.ndim == 2:
        yield place, picture
    else:
        for colour in range(picture.shape[2]):
            yield (colour, *place), picture[..., colour]


def _wider(limits: tuple[float, float], picture: Array) -> tuple[float, float]:
    """A range that also holds the finite values of a picture."""
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
            here = (*leading, rows, columns)
            above = (*leading, *(slice(2 * part.start, 2 * part.stop) for part in (rows, columns)))
            coarser[here] = means(np.asarray(finer[above]))


def _tiles(shape: tuple[int, ...], sides: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    for top in range(0, shape[0], sides[0]):
        for left in range(0, shape[1], sides[1]):
            yield (
                slice(top, min(top + sides[0], shape[0])),
                slice(left, min(left + sides[1], shape[1])),
            )


def means(values: Array) -> Array:
    """Means of 2 x 2 pixels; at an odd edge of the two, or the one, that are there."""
    ny, nx = values.shape
    even = np.pad(values, ((0, ny % 2), (0, nx % 2)), mode="edge")
    with np.errstate(invalid="ignore"):  # of unknown and infinitely far pixels
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
    """Axes, and where the pixels of each level lie: those of level k are 2^k as large."""
    letters = ("C" if axes.endswith("S") else "") + axes.removesuffix("S")
    pixel = (1.0, 1.0) if spacing is None else tuple(abs(step) * 1e6 for step in spacing[2:])
    apart = 1.0 if depth is None else abs(depth) * 1e6
    leading = [apart if letter == "Z" else 1.0 for letter in letters[:-2]]
    before = [first * 1e6 if letter == "Z" else 0.0 for letter in letters[:-2]]
    datasets = []
    for level, _ in enumerate(sizes):
        scale = leading + [2**level * step for step in pixel]
        shift = before + [(2**level - 1) / 2 * step for step in pixel]
        moves: list[dict[str, Any]] = [{"type": "scale", "scale": scale}]
        if level or first:
            moves.append({"type": "translation", "translation": shift})
        datasets.append({"path": str(level), "coordinateTransformations": moves})
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
    """What the samples of a pixel are called."""
    if shape[3:] == (3,):
        return ("red", "green", "blue")
    return tuple(f"intensity {i}" for i in range(shape[3])) if shape[3:] else ("intensity",)


def omero(names: tuple[str, ...], limits: Limits, *, colour: bool) -> dict[str, Any]:
    """How viewers show the channels at first: colours together in one range, others one by one."""
    channels = []
    for index, name in enumerate(names):
        low, high = limits[index if len(limits) > 1 else 0]
        if not low < high:  # one value throughout, or none
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
    """One channel (y, x) of an OME-Zarr (c, y, x), at full size."""
    path = Path(path)
    with opened_store(path, _INSTEAD, max_bytes) as root, reading(path):
        level: Any = root.get("0")
        shape = getattr(level, "shape", ())
        if len(shape) != 3:
            raise FormatError(
                f"{path} is no depth map in OME-Zarr: its array '0' has shape {shape}, not "
                "(c, y, x)."
            )
        bound = storage(level, path, "its full size", max_bytes)
        bound.require(math.prod(shape[1:]) * level.dtype.itemsize, "a channel")
        return np.asarray(level[index])


def _zarr() -> Any:
    return zarr_package(_INSTEAD)
