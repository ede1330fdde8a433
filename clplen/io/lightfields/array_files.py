"""Light fields as NumPy arrays on disk (.npy)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats.pixels import linear
from clplen.io.lightfields.array_sources import (
    Found,
    Source,
    axes_known,
    light_field,
    reading,
    stored_light_field,
)
from clplen.io.lightfields.layout import Layout
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.scratch import RawSamples
from clplen.lightfield.stored import StoredLightField

_FLOATS = np.dtype(np.float32)
_ENCODED = (np.dtype(np.uint8), np.dtype(np.uint16))


def read(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read an array of 4 or 5 dimensions; it is never unpickled.

    Parameters
    ----------
    path : path-like
    device : Device
    layout : Layout
        ``order`` names its axes; without it they are v, u, y, x and perhaps c.
    progress : bool
        Whether to show a bar on standard error.

    Returns
    -------
    LightField, str
        The light field, and what was taken for what, in one sentence.

    Raises
    ------
    FormatError
        If the file is truncated or damaged, holds something else than real numbers in 4 or 5
        dimensions, or its values make no light field.
    """
    with open(path, "rb") as file:
        found = _found(file, Path(path), layout)
        return light_field(found, device=device, layout=layout, progress=progress)


@contextmanager
def open_parts(
    path: PathLike, *, device: Device, layout: Layout
) -> Iterator[tuple[StoredLightField, str]]:
    """What `read` reads, part by part while the file is open.

    Parameters
    ----------
    path : path-like
    device : Device
        Not used.
    layout : Layout

    Yields
    ------
    StoredLightField, str

    Raises
    ------
    FormatError
        As `read`; what is NaN, when it is read.
    """
    with open(path, "rb") as file:
        yield stored_light_field(_found(file, Path(path), layout), layout)


def _found(file: BinaryIO, path: Path, layout: Layout) -> Found:
    with reading(path):  # mapped only for its shape
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    if layout.srgb and values.dtype.kind != "f" and values.dtype not in _ENCODED:
        raise FormatError(
            f"{path} holds {values.dtype}; srgb= takes uint8, uint16 and floats from 0 to 1."
        )
    axes, known = axes_known(path, "its array", values.shape, order=layout.order)
    shape = values.shape
    if values.flags.f_contiguous and not values.flags.c_contiguous:
        shape, axes = shape[::-1], axes[::-1]
    samples = RawSamples(file.fileno(), int(values.offset), shape, values.dtype)
    source = Source(
        path,
        "its array",
        shape,
        _FLOATS if layout.srgb else values.dtype,
        axes,
        known,
        lambda block: linear(samples.read(block)) if layout.srgb else samples.read(block),
        stored=values.nbytes,
        ratio=_FLOATS.itemsize / values.dtype.itemsize if layout.srgb else 1.0,
    )
    return Found(source)
