"""OME-TIFF of linear float32 pictures with axes, pixel sizes in micrometres and a description.

OME data model 2016-06 (Goldberg et al., Genome Biology 6, R47, 2005); the description is JSON.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from clplen.errors import FormatError
from clplen.files import PathLike, check_space, replacing
from clplen.io.formats.tiff import read_tiff_stacks
from clplen.io.store.picture_blocks import Array, Block, checked_blocks, write_rows
from clplen.lightfield.raw.raw_image import Spacing
from clplen.outputs import MARK

CHANNELS = "channels"  # description key: length of an axis that TIFF leaves out
BIG = (1 << 32) - (1 << 25)  # bytes above which BigTIFF is written; leaves 32 MiB for headers


def write_ome(
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
) -> None:
    """Write float32 pictures as a series of OME-TIFF; use BigTIFF above 4 GB.

    The uncompressed file is laid out first, then each block is written at its offset. Memory use is
    one block and one of its planes.
    """
    stored = shape if axes[0] in "ZC" else shape[1:]
    if shape[3:] == (1,):  # TIFF has no axis of length 1: the description records it
        stored, axes = stored[:-1], axes.removesuffix("S")
        description = {**description, CHANNELS: 1}
    pixel = None if spacing is None else (abs(spacing[2]), abs(spacing[3]))
    metadata = ome_metadata(axes, description, pixel, depth, positions)
    if channels:
        metadata["Channel"] = {"Name": list(channels)}
    nbytes = 4 * math.prod(shape)
    check_space(path, nbytes)
    with replacing(path, durable) as temporary:
        with tifffile.TiffWriter(temporary, ome=True, bigtiff=nbytes > BIG) as writer:
            start, _ = writer.write(
                shape=stored,
                dtype=np.float32,
                photometric="rgb" if shape[3:] == (3,) else "minisblack",
                planarconfig="contig" if math.prod(shape[3:]) > 1 else None,
                metadata=metadata,
                software=MARK,
                returnoffset=True,
            )
        with temporary.open("r+b") as file, closing(checked_blocks(blocks, shape)) as parts:
            sample = 4 * math.prod(shape[3:])
            for planes, rows, columns, values in parts:
                for plane, picture in zip(range(planes.start, planes.stop), values, strict=True):
                    before = (plane * shape[1] + rows.start) * shape[2] + columns.start
                    write_rows(file, picture, start=start + sample * before, step=sample * shape[2])


def ome_metadata(
    axes: str,
    description: dict[str, Any],
    pixel: tuple[float, float] | None,
    depth: float | None,
    positions: Sequence[float],
) -> dict[str, Any]:
    """Return the OME metadata for tifffile; convert sizes (dy, dx) and z from metres to um."""
    metadata: dict[str, Any] = {"axes": axes, "Description": json.dumps(description)}
    steps = {"Z": depth} if pixel is None else {"Y": pixel[0], "X": pixel[1], "Z": depth}
    for axis, step in steps.items():
        if step is not None:
            metadata |= {f"PhysicalSize{axis}": abs(step) * 1e6, f"PhysicalSize{axis}Unit": "µm"}
    if positions:
        heights = [round(z * 1e6, 9) for z in positions]
        metadata["Plane"] = {"PositionZ": heights, "PositionZUnit": ["µm"] * len(heights)}
    return metadata


def read_ome_page(path: PathLike, index: int, *, max_bytes: int | None = None) -> Array:
    """Read a picture of an OME-TIFF."""
    path = Path(path)
    try:
        (page,) = next(read_tiff_stacks(path, [[index]], max_bytes=max_bytes))
        return page
    except FormatError:
        raise
    except Exception as error:  # tifffile raises any exception on damaged files
        raise FormatError(f"Cannot read {path} ({str(error)[:200]}).") from error
