"""Distances in metres on the command line: lengths of the camera, maps, points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.setting_options import setting_options, take_settings
from clplen.settings.declaration import settings_of
from clplen.settings.light_fields import ViewLengths

if TYPE_CHECKING:
    from clplen.lightfield.depth.depth_maps import DepthMap
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.stored_light_field import StoredLightField


Values = np.ndarray[Any, Any]

_NEEDED = ("baseline", "focal_length", "pixel_pitch")
_FROM_FOCUS = "metres: x right, y down from the axis, z from the plane in focus, farther positive"
camera_lengths = setting_options(ViewLengths)
_MAPS = (
    options.file(
        "--metric",
        help="Map of distances in metres, as .pfm, .tif or .npy. Without lengths the camera of the "
        "light field is used, and distances count from the plane in focus.",
    ),
    options.file(
        "--ply",
        help="Coloured point cloud in metres; in pixels and disparity if the camera is unknown.",
        metavar="FILE.ply|FILE.glb",
    ),
)


@dataclass(frozen=True)
class Lengths:
    """Camera for metric distances and the output files.

    ``camera`` holds the lengths in metres for `metric_depth` and `points_of`; None if unknown.
    """

    camera: dict[str, Any] | None
    metric: Path | None
    ply: Path | None


class MetricText(NamedTuple):
    """Text about the range of distances and about each file written."""

    distances: str
    files: tuple[str, ...]


def lengths(command: Any) -> Any:
    """Add the options for metric distances to a command."""
    for option in reversed((camera_lengths, *_MAPS)):
        command = option(command)
    return command


def lengths_of(arguments: dict[str, Any]) -> Lengths | None:
    """Remove the options for metric distances from ``arguments``; None if none is set.

    ``intrinsics`` stay in ``arguments``; their lengths are used, too.
    """
    metric, ply = arguments.pop("metric"), arguments.pop("ply")
    camera = lengths_of_camera(arguments)
    if metric is None and ply is None and camera is None:
        return None
    return Lengths(camera, metric, ply)


def lengths_of_camera(arguments: dict[str, Any]) -> dict[str, Any] | None:
    """Remove lengths in metres from ``arguments``, set by options or by ``intrinsics``."""
    lengths = take_settings(ViewLengths, arguments).lengths
    settings = settings_of(ViewLengths)
    flags = {setting.name: f"--{setting.key.replace('_', '-')}" for setting in settings}
    intrinsics = arguments.get("intrinsics")
    if lengths and intrinsics is not None:
        raise click.UsageError(
            f"{flags[next(iter(lengths))]} cannot be combined with --intrinsics, which sets all "
            "lengths: leave one of them out."
        )
    missing = [flags[name] for name in _NEEDED if name not in lengths]
    if lengths and missing:
        raise click.UsageError(
            "Distances in metres need --baseline-mm, --focal-length-mm and --pixel-um together; "
            f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing."
        )
    if intrinsics is not None:
        return lengths_of_intrinsics(intrinsics)
    return lengths or None


def lengths_of_intrinsics(path: Path) -> dict[str, Any]:
    """Return the lengths in a file of intrinsics."""
    from clplen.io import read_intrinsics

    return read_intrinsics(path).lengths


def check_camera(lf: LightField | StoredLightField, lengths: Lengths) -> None:
    """Raise an error if --metric is set but neither camera nor lengths are known."""
    if lengths.metric is not None and lengths.camera is None and not _knows_camera(lf):
        raise click.UsageError(
            "--metric needs lengths, because this light field stores no camera: give "
            "--baseline-mm, --focal-length-mm and --pixel-um, or --intrinsics."
        )


def _knows_camera(lf: LightField | StoredLightField) -> bool:
    return lf.camera is not None and lf.spacing is not None


def write(lf: LightField | StoredLightField, depth: DepthMap, lengths: Lengths) -> MetricText:
    """Write the requested distances and points, and return text about them."""
    from clplen.io import points_of
    from clplen.io.formats.glb import write_points
    from clplen.lightfield.depth.depth_maps import metric_depth

    suffix, unit = "", "in metres"
    z: Values | None = None
    if lengths.camera is not None:
        z = metric_depth(depth.disparity, **lengths.camera)
        points, comment = points_of(depth.disparity, **lengths.camera)
    elif _knows_camera(lf):
        z, suffix = depth.z, " from the plane in focus, farther positive"
        points, comment = _points_of_camera(lf, depth.z)
    else:
        unit = "in pixels, with the disparity as z, because camera and lengths are unknown"
        points, comment = points_of(depth.disparity)
    files = []
    if lengths.metric is not None and z is not None:
        write_map(lengths.metric, z.astype(np.float32))
        files.append(f", {lengths.metric} the distances in metres{suffix}")
    if lengths.ply is not None:
        write_points(lengths.ply, points, colours_of(lf), comment=comment)
        files.append(f", {lengths.ply} the points {unit}")
    return MetricText("" if z is None else distances(z, suffix), tuple(files))


def distances(z: Values, suffix: str) -> str:
    """Return the range of distances in metres as a sentence."""
    valid = np.isfinite(z)
    if not valid.any():
        remedy = "search larger disparities" if suffix else "check the lengths and --focus-m"
        return f"No pixel lies at a finite distance: {remedy}."
    low, middle, high = np.percentile(z[valid], [5, 50, 95])
    return (
        f"Distances{suffix}: median {middle:.4g} m, 90 % of them from {low:.4g} to {high:.4g} m; "
        f"{100 * valid.mean():.0f} % of the pixels lie at a finite distance."
    )


def _points_of_camera(lf: LightField | StoredLightField, z: Values) -> tuple[Values, str]:
    """Return the points (x, y, z) in front of the camera, and a comment for the file."""
    # By the lens law 1/f = 1/a + 1/F the plane in focus lies at a = F/(F/f - 1) from the lens; F/f
    # is alpha at infinity. The magnification at z is F/(a + z), constant if telecentric.
    from clplen.lightfield.raw.raw_image import is_telecentric

    if lf.camera is None or lf.spacing is None:
        raise ValueError("This light field stores no camera.")
    y, x = np.indices(z.shape, dtype=np.float64)
    if is_telecentric(lf):
        scale = np.where(np.isfinite(z), 1 / getattr(lf.camera, "magnification", 1.0), np.nan)
    else:
        F = lf.camera.image_distance
        rest = float(lf.camera.alpha(np.inf)) - 1
        scale = np.where(np.isfinite(z), (np.inf if rest <= 0 else F / rest) + z, np.nan) / F
    down, across = ((n - 1) / 2 for n in z.shape)
    dy, dx = np.abs(lf.spacing[2:])
    points = np.stack([(x - across) * dx * scale, (y - down) * dy * scale, z], -1)
    return points.reshape(-1, 3), _FROM_FOCUS


def write_map(path: Path, values: Values) -> None:
    """Write a float map (y, x) as PFM, TIFF or NumPy, by its suffix."""
    from clplen.io import write_pfm, write_picture
    from clplen.io.formats.npy import write_npy

    if path.suffix.lower() == ".npy":
        write_npy(path, values)
    elif path.suffix.lower() == ".pfm":
        write_pfm(path, values)
    else:
        write_picture(path, values)


def colours_of(lf: LightField | StoredLightField) -> Values:
    """Return the centre view as uint8 colours, shape (n, 3); scale floats to their maximum."""
    from clplen.lightfield.model.stored_light_field import StoredLightField

    V, U = lf.shape[:2]
    if isinstance(lf, StoredLightField):  # reads the central views only
        v, u = (slice((n - 1) // 2, n // 2 + 1) for n in (V, U))
        middle = (v, u, slice(0, lf.shape[2]), slice(0, lf.shape[3]))
        share = lf.weights[v, u] if lf.weights[v, u].any() else np.ones_like(lf.weights[v, u])
        picture = np.tensordot(share / share.sum(), lf.read(middle), 2).astype(np.float64)
    else:
        picture = lf.view((V - 1) / 2, (U - 1) / 2).to_numpy().astype(np.float64)
    top = np.iinfo(lf.dtype).max if lf.dtype.kind == "u" else max(float(picture.max()), 1e-30)
    grey = picture.reshape(*picture.shape[:2], -1)
    three = grey if grey.shape[2] == 3 else np.repeat(grey[..., :1], 3, axis=2)
    return np.asarray(np.rint(255 * np.clip(three / top, 0, 1)), np.uint8).reshape(-1, 3)
