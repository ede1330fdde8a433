"""OME-TIFF: linear float32 pictures with their axes, pixel sizes in micrometres and a description.

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

CHANNELS = "channels"  # key of a description: an axis of that length, which TIFF leaves out
BIG = (1 << 32) - (1 << 25)  # bytes from which on BigTIFF is written; the rest is for the heads


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
    """Write pictures as one series of OME-TIFF, float32; BigTIFF from 4 GB on.

    The file is laid out first, without compression, and each block then goes to its place, so that
    no more than one plane of one block is held besides the block.
    """
    stored = shape if axes[0] in "ZC" else shape[1:]
    if shape[3:] == (1,):  # TIFF knows no axis of one sample: the description keeps it
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
    """Return what tifffile writes into OME: sizes (dy, dx) and z, given in metres, in um."""
    metadata: dict[str, Any] = {"axes": axes, "Description": json.dumps(description)}
    steps = {"Z": depth} if pixel is None else {"Y": pixel[0], "X": pixel[1], "Z": depth}
    for axis, step in steps.items():
        if step is not None:
            metadata |= {f"PhysicalSize{axis}": abs(step) * 1e6, f"PhysicalSize{axis}Unit": "µm"}
    if positions:
        places = [round(z * 1e6, 9) for z in positions]
        metadata["Plane"] = {"PositionZ": places, "PositionZUnit": ["µm"] * len(places)}
    return metadata


def read_ome_page(path: PathLike, index: int, *, max_bytes: int | None = None) -> Array:
    """One picture of an OME-TIFF, as stored."""
    path = Path(path)
    try:
        (page,) = next(read_tiff_stacks(path, [[index]], max_bytes=max_bytes))
        return page
    except FormatError:
        raise
    except Exception as error:  # tifffile raises all kinds on damaged files
        raise FormatError(f"{path} cannot be read ({str(error)[:200]}).") from error
