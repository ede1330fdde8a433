"""Light fields as NumPy arrays on disk (.npy)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.layout import Layout, linear
from clplen.io.loading import Source, axes_known, light_field, reading
from clplen.lightfield.lightfield import LightField

_FLOATS = np.dtype(np.float32)
_ENCODED = (np.dtype(np.uint8), np.dtype(np.uint16))


def read(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read an array of 4 or 5 dimensions; it is mapped, and never unpickled.

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
    path = Path(path)
    with reading(path):
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    if layout.srgb and values.dtype.kind != "f" and values.dtype not in _ENCODED:
        raise FormatError(
            f"{path} holds {values.dtype}; srgb= takes uint8, uint16 and floats from 0 to 1."
        )
    axes, known = axes_known(path, "its array", values.shape, order=layout.order)
    if values.flags.f_contiguous and not values.flags.c_contiguous:
        values, axes = values.T, axes[::-1]
    source = Source(
        path,
        "its array",
        values.shape,
        _FLOATS if layout.srgb else values.dtype,
        axes,
        known,
        lambda block: linear(values[block]) if layout.srgb else values[block],
        stored=values.nbytes,
        ratio=_FLOATS.itemsize / values.dtype.itemsize if layout.srgb else 1.0,
    )
    return light_field(source, device=device, layout=layout, progress=progress)
