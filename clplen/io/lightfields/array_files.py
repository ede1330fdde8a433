"""Light fields as bare arrays: NumPy (.npy), and MATLAB of versions 5 to 7.2 (7.3 is HDF5)."""

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
    axes_known,
    chosen,
)
from clplen.io.lightfields.container_lightfields import LF, has_weights
from clplen.io.lightfields.layout import Array, Layout
from clplen.lightfield.streaming.tile_reading import RawSamples

_COPIES = 3  # of the samples of a MATLAB file that are held while SciPy reads them
_FLOATS = np.dtype(np.float32)
_ENCODED = (np.dtype(np.uint8), np.dtype(np.uint16))


@contextmanager
def open_npy(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open an array of 4 or 5 dimensions; it is never unpickled."""
    with path.open("rb") as file:
        yield OpenSource(_npy_source(file, path, layout), device, layout)


def _npy_source(file: BinaryIO, path: Path, layout: Layout) -> Source:
    with reading(path):  # mapped only for its shape
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    if layout.srgb and values.dtype.kind != "f" and values.dtype not in _ENCODED:
        raise FormatError(
            f"{path} holds {values.dtype}; {argument('srgb')} takes uint8, uint16 and floats "
            "from 0 to 1."
        )
    axes, known = axes_known(path, "its array", values.shape, order=layout.order)
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
        known,
        lambda block: linear(samples.read(block)) if layout.srgb else samples.read(block),
        Bound(
            path, values.nbytes, _FLOATS.itemsize / values.dtype.itemsize if layout.srgb else 1.0
        ),
    )


@contextmanager
def open_matlab(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open a light field of LFToolbox, or any array of 4 or 5 dimensions.

    Taken is the variable that ``dataset=`` names, else ``LF``, else the only one of 4 or 5
    dimensions. LFToolbox's MATLAB size (t, s, v, u, c), t and s being row and column of the view,
    is our (v, u, y, x, c). 2 or 4 channels of ``LF`` are 1 or 3 and a weight: the weight of a view
    is its mean over the view, of the whole range of its type (of 1 if it is real), and 0 for a view
    that is dark throughout.
    """
    with path.open("rb") as file:
        with reading(path):
            found = {item.name: item for item in variables(file, path)}
            held = {name: (item.shape, item.dtype) for name, item in found.items()}
            variable = found[chosen(path, "variable", layout.dataset, (LF,), held)]
            source = _variable_source(variable, file, path, layout)
        yield OpenSource(source, device, layout, whole=True)


def _variable_source(variable: Variable, file: BinaryIO, path: Path, layout: Layout) -> Source:
    what = f"the variable {variable.name!r}"
    axes, known = axes_known(path, what, variable.shape, order=layout.order)
    assert variable.dtype is not None
    assert variable.packed is not None
    nbytes = _COPIES * math.prod(variable.shape) * variable.packed.itemsize

    @cache
    def samples() -> Array:
        if layout.max_bytes is None:
            require_room(nbytes, path=path, what=what, max_bytes=None)
        return read_variable(file, variable).T  # as they lie in the file

    return Source(
        path,
        what,
        variable.shape[::-1],
        variable.dtype,
        axes[::-1],
        known,
        lambda block: samples()[block],
        Bound(path, variable.length, DEFLATE if variable.compressed else 1.0).wider(
            variable.dtype.itemsize / variable.packed.itemsize
        ),
        weighted=has_weights(variable.name, axes, variable.shape),
    )
