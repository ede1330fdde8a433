"""Focal stacks and depth maps as files that other programs read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from clplen.files import PathLike
from clplen.io.ome import SUFFIXES, write_ome
from clplen.io.pfm import write_pfm
from clplen.io.picture import write_picture
from clplen.lightfield.raw import Spacing

if TYPE_CHECKING:
    from clplen.lightfield.depth import DepthMap
    from clplen.lightfield.refocus import FocalStack

_DISPARITY = "pixels per view step, nearer is larger"
_ALPHA = "F/F', F main lens to microlens array, F' main lens to the plane"
_CHANNELS = {
    "disparity": _DISPARITY,
    "confidence": "0 to 1",
    "alpha": _ALPHA,
    "z": "metres from the focused plane, farther is positive",
}


def write_stack(path: PathLike, stack: FocalStack, *, progress: bool = False) -> None:
    """Write a focal stack as one TIFF series of linear float32 planes.

    ``tifffile.imread`` gives it back as (n, y, x) or (n, y, x, 3), a single plane as (y, x[, 3]).
    The OME axes are ZYX or ZYXS; the image's OME description is JSON with the ``disparities`` and
    ``alphas`` of the planes (null where unknown) and, with a camera, their ``dz_m``. From 4 GB on
    it is a BigTIFF.

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
    if Path(path).suffix.lower() not in SUFFIXES:
        raise ValueError(f"A focal stack is written as .tif, not as {Path(path).name}.")
    shape = tuple(int(n) for n in stack.data.shape)
    planes = (stack.device.download(stack.data[i]) for i in range(shape[0]))
    bar = tqdm(planes, total=shape[0], desc="writing", unit="plane", disable=not progress)
    write_ome(
        path,
        bar,
        shape=shape,
        axes="ZYXS" if len(shape) == 4 else "ZYX",
        description=_description(stack),
        spacing=stack.spacing,
    )


def _description(stack: FocalStack) -> dict[str, Any]:
    """What is said about the planes."""
    description = {
        "disparities": _numbers(stack.disparities),
        "alphas": _numbers(stack.alphas),
        "disparity": _DISPARITY,
        "alpha": _ALPHA,
    }
    if stack.camera is not None:
        description["dz_m"] = _numbers([stack.camera.dz(alpha) for alpha in stack.alphas])
    return description


def _numbers(values: Any) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def write_depth(path: PathLike, depth: DepthMap, *, spacing: Spacing | None = None) -> None:
    """Write the disparity of a depth map, in pixels per view step, nearer larger.

    Parameters
    ----------
    path : path-like
        ``.pfm``, or ``.tif`` for one float32 page; ``.ome.tif`` for OME-TIFF with the channels
        disparity, confidence and, where known, alpha and z (metres).
    depth : DepthMap
    spacing : tuple of float, optional
        That of the light field, signed (dv, du, dy, dx) in metres; kept by OME-TIFF.

    Raises
    ------
    ValueError
        If the suffix is another one.
    OSError
        If the file cannot be written.
    """
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    if suffixes[-1:] == [".pfm"]:
        write_pfm(path, depth.disparity)
    elif suffixes[-2:] in ([".ome", suffix] for suffix in SUFFIXES):
        _write_channels(path, depth, spacing)
    elif suffixes[-1:] in ([suffix] for suffix in SUFFIXES):
        values = depth.disparity.astype(np.float32, copy=False)
        write_picture(path, values, description=f"disparity, {_DISPARITY}")
    else:
        raise ValueError(f"Disparities are written as .pfm or .tif, not as {Path(path).name}.")


def _write_channels(path: PathLike, depth: DepthMap, spacing: Spacing | None) -> None:
    maps = {name: np.asarray(getattr(depth, name), np.float32) for name in _CHANNELS}
    known = {
        name: values
        for name, values in maps.items()
        if name in ("disparity", "confidence") or not np.isnan(values).all()
    }
    write_ome(
        path,
        known.values(),
        shape=(len(known), *depth.disparity.shape),
        axes="CYX",
        description={name: _CHANNELS[name] for name in known},
        spacing=spacing,
        channels=tuple(known),
    )
