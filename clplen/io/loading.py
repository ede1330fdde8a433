"""Arrays in files, block by block into the memory of a device."""

from __future__ import annotations

import itertools
import math
import struct
import tokenize
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl.array as cla
from tqdm import tqdm

from clplen.compute.device import Device
from clplen.errors import FormatError, ShapeError
from clplen.io.bounds import require_bytes
from clplen.io.layout import Array, Layout, View, axes_of, in_order
from clplen.io.positions import positions_of
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.samples import C_TYPE, lit_views

Selection = tuple[slice, ...]

_BLOCK = 4 << 20  # bytes read at a time: they stay in the cache while axes are exchanged
UNREADABLE = (  # what libraries raise on files that are damaged or something else
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    SyntaxError,
    struct.error,
    tokenize.TokenError,
    zlib.error,
)


@dataclass(frozen=True)
class Source:
    """A light field in a file, before it is read.

    Attributes
    ----------
    path : pathlib.Path
    what : str
        As the subject of a sentence: "the dataset 'LF'".
    shape : tuple of int
    dtype : numpy.dtype
        Of what ``read`` gives.
    axes : str
        A letter of "vuyxc" for each dimension.
    known : str
        The axes and how they are known, for the sentence on what was taken.
    read : callable
        A slice for each dimension -> the samples there.
    stored : int
        Bytes that the file has for it.
    ratio : float
        Largest ratio of its compression; 1 for none.
    chunks : tuple of int or None
        Best read as a whole.
    weighted : bool
        Whether the last channel is a weight.
    """

    path: Path
    what: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    axes: str
    known: str
    read: Callable[[Selection], Array]
    stored: int
    ratio: float = 1.0
    chunks: tuple[int, ...] | None = None
    weighted: bool = False

    @property
    def views(self) -> View:
        """(V, U) in the file."""
        return self.shape[self.axes.index("v")], self.shape[self.axes.index("u")]

    @property
    def colours(self) -> tuple[int, ...]:
        """(c,), or () for grey; without the weight."""
        if "c" not in self.axes:
            return ()
        count = self.shape[self.axes.index("c")] - self.weighted
        return () if self.weighted and count == 1 else (count,)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Make a FormatError, naming the file, of what a library says of one that it cannot read."""
    try:
        yield
    except UNREADABLE as error:
        reason = (str(error).splitlines() or [""])[0].strip(" .'\"") or type(error).__name__
        raise FormatError(
            f"{path} is truncated or damaged ({reason[:200]}): copy or write it again."
        ) from error


def axes_known(
    path: Path, what: str, shape: tuple[int, ...], *, order: str | None, own: str | None = None
) -> tuple[str, str]:
    """The axes of an array, and how they are known.

    Parameters
    ----------
    path : pathlib.Path
    what : str
        The array, as the subject of a sentence.
    shape : tuple of int
    order : str or None
        What the user says.
    own : str, optional
        What the file says.

    Returns
    -------
    str, str
        A letter a dimension, and "axes v:u:y:x (guessed)", "(as given)" or "(as the file says)".

    Raises
    ------
    FormatError
        If there are not 4 or 5 dimensions, or the axes are others.
    """
    if len(shape) not in (4, 5):
        raise FormatError(
            f"{path}: {what} has shape {shape}; a light field has 4 or 5 dimensions, v, u, y, x "
            "and perhaps c."
        )
    default = "vuyxc"[: len(shape)]
    try:
        axes = axes_of(order or own or default, len(shape))
    except FormatError as error:
        raise FormatError(f"{path}: {what} has shape {shape}. {error}") from error
    how = "as given" if order else "as the file says" if own else "guessed"
    return axes, f"axes {':'.join(axes)} ({how})"


def light_field(
    source: Source,
    *,
    device: Device,
    layout: Layout,
    progress: bool,
    known: dict[str, Any] | None = None,
) -> tuple[LightField, str]:
    """Read the samples of a source and make them a light field.

    Parameters
    ----------
    source : Source
    device : Device
    layout : Layout
    progress : bool
        Whether to show a bar on standard error.
    known : dict, optional
        What else `LightField.from_array` takes; weights and positions for the views of the file.

    Returns
    -------
    LightField, str
        The light field, and what was taken for what, in one sentence.

    Raises
    ------
    FormatError
        If the file cannot hold what it declares, is damaged, or holds values that make no light
        field.
    """
    words = dict(known or {})
    for name in ("weights", "positions"):
        if words.get(name) is not None:
            words[name] = _fitting(np.asarray(words[name]), name, source, layout)
    places = positions_of(layout, source.views)
    if places is not None:
        words["positions"] = places
    data = samples(source, device=device, layout=layout, progress=progress)
    if source.weighted:
        lit = lit_views(data, device)
        words["weights"] = layout.oriented(_mean_weights(source)) * (lit if lit.any() else 1)
    try:
        lf = LightField.from_array(data, device=device, **words)
    except (TypeError, ValueError, ShapeError) as error:
        raise FormatError(f"{source.path}: {error}") from error
    return lf, _sentence(source, lf, layout)


def _fitting(values: Array, name: str, source: Source, layout: Layout) -> Array:
    if values.shape[:2] != source.views:
        raise FormatError(
            f"{source.path}: the {name} have shape {values.shape}, the views {source.views}."
        )
    return layout.oriented(values)


def samples(source: Source, *, device: Device, layout: Layout, progress: bool) -> cla.Array:
    """The samples of a source on a device, without a second copy of all on the host.

    Parameters
    ----------
    source : Source
    device : Device
    layout : Layout
    progress : bool

    Returns
    -------
    pyopencl.array.Array
        (v, u, y, x[, c]); uint8, uint16 and float32 as stored, other types as float32.

    Raises
    ------
    FormatError
    """
    require_samples(source, layout)
    dtype = _kept(source.dtype)
    inside = tuple(source.shape[source.axes.index(letter)] for letter in "yx")
    shape = (*layout.shape(source.views), *inside, *source.colours)
    array = device.empty(shape, dtype)
    whole = math.prod(shape) * source.dtype.itemsize
    bar = tqdm(total=whole, desc="reading", unit="B", unit_scale=True, disable=not progress)
    with device.on_host(array) as host, bar:
        target = _as_stored(layout.stored(host), source)
        for block in blocks(target.shape, source.chunks, source.dtype.itemsize):
            with reading(source.path), np.errstate(all="ignore"):
                values = source.read(block)
                target[block] = values
            bar.update(values.nbytes)
    return array


def require_samples(source: Source, layout: Layout) -> None:
    """Refuse samples that are no real numbers, none at all, or more than the file can hold.

    Raises
    ------
    FormatError
    """
    if source.dtype.kind not in "buif":
        raise FormatError(
            f"{source.path}: {source.what} holds {source.dtype}, no real numbers: convert it."
        )
    if 0 in source.shape:
        raise FormatError(f"{source.path}: {source.what} of shape {source.shape} is empty.")
    wider = max(_kept(source.dtype).itemsize / source.dtype.itemsize, 1)
    require_bytes(
        int(math.prod(source.shape) * source.dtype.itemsize * wider),
        path=source.path,
        what=source.what,
        stored=source.stored,
        ratio=source.ratio * wider,
        max_bytes=layout.max_bytes,
    )


def _kept(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The type on the device."""
    native = dtype.newbyteorder("=")
    return native if native in C_TYPE else np.dtype(np.float32)


def _as_stored(views: Array, source: Source) -> Array:
    """The final array, its (v, u) being the file's, with the axes of the file."""
    if "c" in source.axes and not source.colours:
        views = views[..., None]
    return views.transpose(["vuyxc".index(letter) for letter in source.axes])


def blocks(
    shape: tuple[int, ...], chunks: tuple[int, ...] | None, itemsize: int
) -> Iterator[Selection]:
    """Cut an array into blocks of whole chunks, as near to `_BLOCK` bytes as they get.

    Parameters
    ----------
    shape : tuple of int
    chunks : tuple of int or None
        None where the order in the file is that of the axes.
    itemsize : int
        Bytes of a sample.

    Yields
    ------
    tuple of slice
        In the order of the axes, the last one fastest.
    """
    step = [min(a, n) for a, n in zip(chunks or (1,) * len(shape), shape, strict=True)]
    for axis in reversed(range(len(shape))):
        more = max(_BLOCK // (math.prod(step) * itemsize), 1)
        step[axis] = min(step[axis] * more, shape[axis])
    starts = (range(0, n, s) for n, s in zip(shape, step, strict=True))
    for start in itertools.product(*starts):
        ends = (min(a + s, n) for a, s, n in zip(start, step, shape, strict=True))
        yield tuple(slice(a, b) for a, b in zip(start, ends, strict=True))


def _mean_weights(source: Source) -> Array:
    """Mean of the last channel over each view of the file, of its type's range if integer."""
    axis = source.axes.index("c")
    last = source.shape[axis] - 1
    shape = (*source.shape[:axis], 1, *source.shape[axis + 1 :])
    total = np.zeros(source.views, np.float64)
    for block in blocks(shape, source.chunks, source.dtype.itemsize):
        chosen = (*block[:axis], slice(last, last + 1), *block[axis + 1 :])
        with reading(source.path), np.errstate(all="ignore"):
            values = in_order(source.read(chosen), source.axes)
            v, u = (block[source.axes.index(letter)] for letter in "vu")
            total[v, u] += values.sum(axis=(2, 3, 4), dtype=np.float64)
    full = np.iinfo(source.dtype).max if source.dtype.kind in "ui" else 1
    return np.asarray(total * total.size / math.prod(shape) / full)


def _sentence(source: Source, lf: LightField, layout: Layout) -> str:
    size = " x ".join(str(n) for n in lf.shape[2:])
    stored = "" if lf.dtype == source.dtype.newbyteorder("=") else f" (stored as {source.dtype})"
    parts = [
        f"{lf.shape[0]} x {lf.shape[1]} views (V x U) of {size} {lf.dtype}{stored} "
        f"from {source.path}",
        f"{source.what} with {source.known}",
        *layout.said(),
    ]
    if source.weighted:
        parts.append("its last channel taken for weights, their mean for each view")
    return ", ".join(parts)
