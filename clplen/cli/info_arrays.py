"""What ``clplen info`` tells of disparity maps and of volumes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from clplen.cli.info import Rows

import numpy as np

_MAPS = (".pfm", ".npy", ".tif", ".tiff")
_VOLUMES = (".tif", ".tiff", ".zarr")


def map_in(source: Path) -> np.ndarray[Any, Any] | None:
    """The values of a disparity map; None if it is something else."""
    from clplen.errors import FormatError
    from clplen.io import read_disparity

    if source.suffix.lower() not in _MAPS:
        return None
    try:
        return read_disparity(source)
    except FormatError:
        if source.suffix.lower() == ".pfm":
            raise
        return None


def of_map(source: Path, values: np.ndarray[Any, Any]) -> tuple[Rows, dict[str, Any]]:
    """Of a disparity map."""
    known = values[np.isfinite(values)]
    low, median, high = (
        (float(known.min()), float(np.median(known)), float(known.max()))
        if known.size
        else (math.nan,) * 3
    )
    unknown = values.size - known.size
    rows = [
        ("File", f"{source}, a disparity map"),
        ("Size", f"{values.shape[0]} x {values.shape[1]} pixels (y, x)"),
        ("Range", f"{low:.6g} to {high:.6g}, median {median:.6g}"),
        ("Not known", f"{unknown} of {values.size} pixels (NaN or infinite)"),
    ]
    data = {"shape": values.shape, "low": low, "median": median, "high": high}
    return rows, {"file": source, "kind": "a disparity map", **data, "unknown": unknown}


def volume_in(source: Path) -> tuple[np.ndarray[Any, Any], dict[str, Any]] | None:
    """A volume and its description; None if it is something else."""
    from clplen.io.volume import is_volume, read_volume

    if source.suffix.lower() not in _VOLUMES or not is_volume(source):
        return None
    return read_volume(source)


def of_volume(
    source: Path, values: np.ndarray[Any, Any], about: dict[str, Any]
) -> tuple[Rows, dict[str, Any]]:
    """Of a volume of a light-field microscope."""
    planes, kind = about["planes_um"], "a volume of a light-field microscope"
    steps = {round(step, 6) for step in np.diff(planes)}
    total, high = values.sum(dtype=np.float64), float(values.max())
    rows = [
        ("File", f"{source}, {kind}"),
        ("Size", f"{' x '.join(map(str, values.shape))} voxels (z, y, x)"),
        ("Planes", f"z from {planes[0]:g} to {planes[-1]:g} um"
         + (f" every {steps.pop():g} um" if len(steps) == 1 else "")),
        ("Light", f"{total:.6g} in all, up to {high:.6g} in a voxel"),
    ]  # fmt: skip
    if "voxel_um" in about:
        rows.insert(3, ("Voxels", "{:g} x {:g} um (y, x)".format(*about["voxel_um"])))
    if about.get("residuals"):
        rows.append(
            ("Residual", f"{about['residuals'][-1]:.3g} after {len(about['residuals'])} iterations")
        )
    near = about.get("degenerate_um")
    if near:
        ends = f"z from {min(near):g} to {max(near):g} um"
        rows.append(("Degenerate", f"{ends}: nothing finer than a lenslet is resolved"))
    if "place" in about:
        y, x = about["place"]["first"]
        rows.append(("Place", f"voxel (0, 0) lies at (y, x) = ({y:g}, {x:g}) px of the raw frame"))
    rows += [("Also", text) for text in about.get("remarks", [])]
    data = {"file": source, "kind": kind, "shape": values.shape, "light": total, "high": high}
    return rows, data | about
