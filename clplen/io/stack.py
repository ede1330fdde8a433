"""Focal stacks and depth maps as files that other programs read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tifffile
from tqdm import tqdm

from clplen.files import PathLike, replacing
from clplen.io.pfm import write_pfm
from clplen.io.picture import write_picture

if TYPE_CHECKING:
    from clplen.lightfield.depth import DepthMap
    from clplen.lightfield.refocus import FocalStack


def write_stack(path: PathLike, stack: FocalStack, *, progress: bool = False) -> None:
    """Write a focal stack as one TIFF series of linear float32 planes.

    ``tifffile.imread`` gives it back as (n, y, x) or (n, y, x, 3), a single plane as (y, x[, 3]).
    The OME axes are ZYX or ZYXS; the image's OME description is JSON with the ``disparities`` and
    ``alphas`` of the planes (null where unknown) and, with a camera, their ``dz_m``.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff``.
    stack : FocalStack
    progress : bool
        Whether to show a bar on standard error.

    Raises
    ------
    ValueError
        If the suffix is another one.
    OSError
        If the file cannot be written.
    """
    if Path(path).suffix.lower() not in (".tif", ".tiff"):
        raise ValueError(f"A focal stack is written as .tif, not as {Path(path).name}.")
    shape = tuple(int(n) for n in stack.data.shape)
    colour = len(shape) == 4
    planes = (stack.device.download(stack.data[i]) for i in range(shape[0]))
    bar = tqdm(planes, total=shape[0], desc="writing", unit="plane", disable=not progress)
    with replacing(path) as temporary, tifffile.TiffWriter(temporary, ome=True) as writer:
        writer.write(
            iter(bar),
            shape=shape,
            dtype=np.float32,
            photometric="rgb" if colour else "minisblack",
            planarconfig="contig" if colour else None,
            metadata={"axes": "ZYXS" if colour else "ZYX", **_metadata(stack)},
        )


def _metadata(stack: FocalStack) -> dict[str, Any]:
    """What OME says about the planes and their pixels."""
    description = {
        "disparities": _numbers(stack.disparities),
        "alphas": _numbers(stack.alphas),
        "disparity": "pixels per view step, nearer is larger",
        "alpha": "F/F', F main lens to microlens array, F' main lens to the plane",
    }
    if stack.camera is not None:
        description["dz_m"] = _numbers([stack.camera.dz(alpha) for alpha in stack.alphas])
    found: dict[str, Any] = {"Description": json.dumps(description)}
    if stack.spacing is not None:
        for axis, step in zip("YX", stack.spacing[2:], strict=True):
            found |= {f"PhysicalSize{axis}": abs(step) * 1e6, f"PhysicalSize{axis}Unit": "µm"}
    return found


def _numbers(values: Any) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def write_depth(path: PathLike, depth: DepthMap) -> None:
    """Write the disparity of a depth map, in pixels per view step, nearer larger.

    Parameters
    ----------
    path : path-like
        ``.pfm``, or ``.tif`` for one float32 page.
    depth : DepthMap

    Raises
    ------
    ValueError
        If the suffix is another one.
    OSError
        If the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".pfm":
        write_pfm(path, depth.disparity)
    elif suffix in (".tif", ".tiff"):
        text = "disparity, pixels per view step, nearer is larger"
        write_picture(path, depth.disparity.astype(np.float32, copy=False), description=text)
    else:
        raise ValueError(f"Disparities are written as .pfm or .tif, not as {Path(path).name}.")
