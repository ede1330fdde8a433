"""Light fields as plain arrays: NumPy (.npy), and MATLAB of versions 5 to 7.2 (7.3 is HDF5)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import BinaryIO

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError, argument
from clplen.io.formats.mat import Variable, read_variable, variables
from clplen.io.formats.picture import linear
from clplen.io.formats.untrusted import DEFLATE, Bound, reading, require_room
from clplen.io.lightfields.array_sources import (
    OpenSource,
    Source,
    resolve_axes,
    select_array,
)
from clplen.io.lightfields.container_lightfields import LF, has_weights
from clplen.io.lightfields.layout import Array, Layout
from clplen.lightfield.streaming.tile_reading import RawSamples

_COPIES = 3  # copies of the samples in memory while SciPy reads a MATLAB file
_FLOATS = np.dtype(np.float32)
_ENCODED = (np.dtype(np.uint8), np.dtype(np.uint16))


@contextmanager
def open_npy(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open an array of 4 or 5 dimensions without unpickling."""
    with path.open("rb") as file:
        yield OpenSource(_npy_source(file, path, layout), device, layout)


def _npy_source(file: BinaryIO, path: Path, layout: Layout) -> Source:
    with reading(path):  # mapped to read its shape
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    if layout.srgb and values.dtype.kind != "f" and values.dtype not in _ENCODED:
        raise FormatError(
            f"{path} must hold uint8, uint16 or floats from 0 to 1 for {argument('srgb')}, got "
            f"{values.dtype}."
        )
    axes, axes_text = resolve_axes(path, "its array", values.shape, order=layout.order)
    shape = values.shape
    if values.flags.f_contiguous and not values.flags.c_contiguous:
        shape, axes = shape[::-1], axes[::-1]
    samples = RawSamples(file.fileno(), int(values.offset), shape, values.dtype)
    return Source(
        path,
        "its array",
        shape,
        _FLOATS if layout.srgb else values.dtype,
        axes,
        axes_text,
        lambda block: linear(samples.read(block)) if layout.srgb else samples.read(block),
        Bound(
            path, values.nbytes, _FLOATS.itemsize / values.dtype.itemsize if layout.srgb else 1.0
        ),
    )


@contextmanager
def open_matlab(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open a light field of LFToolbox, or any array of 4 or 5 dimensions.

    The variable is that of ``dataset=``, else ``LF``, else the only variable of 4 or 5 dimensions.
    LFToolbox's MATLAB size (t, s, v, u, c), with row t and column s of the view, corresponds to (v,
    u, y, x, c). 2 or 4 channels of ``LF`` are 1 or 3 and a weight. The weight of a view is its mean
    divided by the range of an integer dtype, and 0 for a black view.
    """
    with path.open("rb") as file:
        with reading(path):
            by_name = {item.name: item for item in variables(file, path)}
            listing = {name: (item.shape, item.dtype) for name, item in by_name.items()}
            variable = by_name[select_array(path, "variable", layout.dataset, (LF,), listing)]
            source = _variable_source(variable, file, path, layout)
        yield OpenSource(source, device, layout, read_at_once=True)


def _variable_source(variable: Variable, file: BinaryIO, path: Path, layout: Layout) -> Source:
    what = f"the variable {variable.name!r}"
    axes, axes_text = resolve_axes(path, what, variable.shape, order=layout.order)
    assert variable.dtype is not None
    assert variable.packed is not None
    nbytes = _COPIES * math.prod(variable.shape) * variable.packed.itemsize

    @cache
    def samples() -> Array:
        if layout.max_bytes is None:
            require_room(nbytes, path=path, what=what, max_bytes=None)
        return read_variable(file, variable).T  # in file order

    return Source(
        path,
        what,
        variable.shape[::-1],
        variable.dtype,
        axes[::-1],
        axes_text,
        lambda block: samples()[block],
        Bound(path, variable.length, DEFLATE if variable.compressed else 1.0).wider(
            variable.dtype.itemsize / variable.packed.itemsize
        ),
        weighted=has_weights(variable.name, axes, variable.shape),
    )
