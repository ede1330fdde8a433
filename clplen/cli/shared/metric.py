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
        help="Distances in metres, as .pfm, .tif or .npy; from the plane in focus where the light "
        "field knows its camera and no lengths are given.",
    ),
    options.file(
        "--ply",
        help="Points with their colours, in metres; pixels and disparity if nothing tells metres.",
        metavar="FILE.ply|FILE.glb",
    ),
)


@dataclass(frozen=True)
class Lengths:
    """What distances are computed from, and where they go.

    ``camera`` holds lengths in metres, as `metric_depth` and `points_of` take them; None where they
    are not given.
    """

    camera: dict[str, Any] | None
    metric: Path | None
    ply: Path | None


class Said(NamedTuple):
    """What to say of metres: of the distances, and of each file."""

    distances: str
    files: tuple[str, ...]


def lengths(command: Any) -> Any:
    """Decorate a command with the options of metres."""
    for option in reversed((camera_lengths, *_MAPS)):
        command = option(command)
    return command


def lengths_of(words: dict[str, Any]) -> Lengths | None:
    """Take the options of metres out of ``words``; None if none is given.

    ``intrinsics``, which stay there, tell lengths too.
    """
    metric, ply = words.pop("metric"), words.pop("ply")
    camera = lengths_of_camera(words)
    if metric is None and ply is None and camera is None:
        return None
    return Lengths(camera, metric, ply)


def lengths_of_camera(words: dict[str, Any]) -> dict[str, Any] | None:
    """Take lengths in metres out of ``words``, from options or from ``intrinsics``."""
    given = take_settings(ViewLengths, words).lengths
    flags = {one.name: f"--{one.key.replace('_', '-')}" for one in settings_of(ViewLengths)}
    intrinsics = words.get("intrinsics")
    if given and intrinsics is not None:
        raise click.UsageError(
            f"{flags[next(iter(given))]} is not needed with --intrinsics, which tell all lengths: "
            "leave it out."
        )
    missing = [flags[name] for name in _NEEDED if name not in given]
    if given and missing:
        raise click.UsageError(
            "Distances in metres need --baseline-mm, --focal-length-mm and --pixel-um together; "
            f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing."
        )
    if intrinsics is not None:
        return lengths_of_intrinsics(intrinsics)
    return given or None


def lengths_of_intrinsics(path: Path) -> dict[str, Any]:
    """Lengths of light fields that are rectified by a file of intrinsics."""
    from clplen.io import read_intrinsics

    return read_intrinsics(path).lengths


def check_camera(lf: LightField | StoredLightField, lengths: Lengths) -> None:
    """Refuse a map in metres of a light field that knows no camera, without lengths."""
    if lengths.metric is not None and lengths.camera is None and not _knows_camera(lf):
        raise click.UsageError(
            "--metric needs lengths, as this light field knows no camera: give --baseline-mm, "
            "--focal-length-mm and --pixel-um, or --intrinsics."
        )


def _knows_camera(lf: LightField | StoredLightField) -> bool:
    return lf.camera is not None and lf.spacing is not None


def write(lf: LightField | StoredLightField, found: DepthMap, lengths: Lengths) -> Said:
    """Write distances and points where they are asked for; what to say of them."""
    from clplen.io import points_of
    from clplen.io.formats.glb import write_points
    from clplen.lightfield.depth.depth_maps import metric_depth

    where, unit = "", "in metres"
    z: Values | None = None
    if lengths.camera is not None:
        z = metric_depth(found.disparity, **lengths.camera)
        points, words = points_of(found.disparity, **lengths.camera)
    elif _knows_camera(lf):
        z, where = found.z, " from the plane in focus, farther positive"
        points, words = _points_of_camera(lf, found.z)
    else:
        unit = "in pixels, with the disparity as z, for want of a camera or lengths"
        points, words = points_of(found.disparity)
    files = []
    if lengths.metric is not None and z is not None:
        write_map(lengths.metric, z.astype(np.float32))
        files.append(f", {lengths.metric} the distances in metres{where}")
    if lengths.ply is not None:
        write_points(lengths.ply, points, colours_of(lf), comment=words)
        files.append(f", {lengths.ply} the points {unit}")
    return Said("" if z is None else distances(z, where), tuple(files))


def distances(z: Values, where: str) -> str:
    """The range of distances in metres, in a sentence."""
    known = np.isfinite(z)
    if not known.any():
        ask = "look among larger disparities" if where else "check the lengths and --focus-m"
        return f"No pixel lies at a finite distance: {ask}."
    low, middle, high = np.percentile(z[known], [5, 50, 95])
    return (
        f"Distances{where}: median {middle:.4g} m, 90 % of them from {low:.4g} to {high:.4g} m; "
        f"{100 * known.mean():.0f} % of the pixels lie at a finite distance."
    )


def _points_of_camera(lf: LightField | StoredLightField, z: Values) -> tuple[Values, str]:
    """Points (x, y, z) as the camera of a light field images them, and what they are.

    By the lens law 1/f = 1/a + 1/F the plane in focus lies at a = F/(F/f - 1) from the lens, where
    F/f is alpha of what is infinitely far; a picture is F/(a + z) of the object's size. That of a
    telecentric camera has the same size everywhere.
    """
    from clplen.lightfield.raw.raw_image import is_telecentric

    if lf.camera is None or lf.spacing is None:
        raise ValueError("This light field knows no camera.")
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
    """A float map (y, x) as PFM, TIFF or NumPy, by its suffix."""
    from clplen.io import write_pfm, write_picture
    from clplen.io.formats.npy import write_npy

    if path.suffix.lower() == ".npy":
        write_npy(path, values)
    elif path.suffix.lower() == ".pfm":
        write_pfm(path, values)
    else:
        write_picture(path, values)


def colours_of(lf: LightField | StoredLightField) -> Values:
    """The centre view as uint8 colours, shape (n, 3); floats by their largest value."""
    from clplen.lightfield.model.stored_light_field import StoredLightField

    V, U = lf.shape[:2]
    if isinstance(lf, StoredLightField):  # the same, of the views around the middle
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
