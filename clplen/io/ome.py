"""OME-TIFF: linear float32 pictures with their axes, pixel sizes in micrometres and a description.

OME data model 2016-06 (Goldberg et al., Genome Biology 6, R47, 2005); the description is JSON.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from clplen.files import PathLike, replacing
from clplen.lightfield.raw import Spacing

Array = np.ndarray[Any, Any]

SUFFIXES = (".tif", ".tiff")
_BIG = (1 << 32) - (1 << 25)  # bytes from which on BigTIFF is written; the rest is for the heads


def write_ome(
    path: PathLike,
    planes: Iterable[Array],
    *,
    shape: tuple[int, ...],
    axes: str,
    description: dict[str, Any],
    spacing: Spacing | None,
    channels: tuple[str, ...] = (),
) -> None:
    """Write pictures as one series of OME-TIFF, float32; BigTIFF from 4 GB on.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff``.
    planes : iterable of numpy.ndarray
        float32, (y, x) or (y, x, 3), one after the other.
    shape : tuple of int
        Of all of them together.
    axes : str
        A letter a dimension: Z planes, C channels, S samples of a colour.
    description : dict
        What the values are; written as JSON.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres.
    channels : tuple of str, optional
        Names of the channels.

    Raises
    ------
    ValueError
        If the suffix is another one.
    OSError
        If the file cannot be written.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise ValueError(f"OME-TIFF is written as .tif, not as {Path(path).name}.")
    metadata: dict[str, Any] = {"axes": axes, "Description": json.dumps(description)}
    if spacing is not None:
        for axis, step in zip("YX", spacing[2:], strict=True):
            metadata |= {f"PhysicalSize{axis}": abs(step) * 1e6, f"PhysicalSize{axis}Unit": "µm"}
    if channels:
        metadata["Channel"] = {"Name": list(channels)}
    colour = axes.endswith("S")
    big = 4 * int(np.prod(shape, dtype=np.int64)) > _BIG
    with (
        replacing(path) as temporary,
        tifffile.TiffWriter(temporary, ome=True, bigtiff=big) as writer,
    ):
        writer.write(
            iter(planes),
            shape=shape,
            dtype=np.float32,
            photometric="rgb" if colour else "minisblack",
            planarconfig="contig" if colour else None,
            metadata=metadata,
        )


def write_image(
    path: PathLike, image: Any, *, spacing: Spacing | None = None, description: str = ""
) -> None:
    """Write one linear picture, such as all-in-focus, as OME-TIFF with the size of its pixels.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff``.
    image : Image or numpy.ndarray
        Shape (y, x) or (y, x, 3); stored as float32.
    spacing : tuple of float, optional
        That of the light field, signed (dv, du, dy, dx) in metres.
    description : str, optional
        What the values are.

    Raises
    ------
    ValueError
        If the suffix or the shape is another one.
    OSError
        If the file cannot be written.
    """
    values = np.asarray(image.to_numpy() if hasattr(image, "to_numpy") else image, np.float32)
    if values.ndim not in (2, 3) or values.shape[2:] not in ((), (3,)):
        raise ValueError(f"A picture has shape (y, x) or (y, x, 3), not {values.shape}.")
    write_ome(
        path,
        [values],
        shape=values.shape,
        axes="YXS" if values.ndim == 3 else "YX",
        description={"values": description} if description else {},
        spacing=spacing,
    )
