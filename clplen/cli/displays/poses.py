"""``clplen poses``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.console import note, read
from clplen.cli.shared.metric import camera_lengths, colours_of, lengths_of_camera
from clplen.cli.shared.pictures import Tone, drawable, read_map, tone

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.view_cameras import ViewCameras

Values = np.ndarray[Any, Any]


@click.command(cls=options.Command)
@options.source
@options.output("FOLDER", "Output folder, new or empty.")
@click.option(
    "--format",
    "kind",
    required=True,
    type=click.Choice(["nerf", "colmap"]),
    help="Output format: transforms.json for instant-ngp and nerfstudio (nerf), or text files for "
    "COLMAP (colmap).",
)
@options.file(
    "--disparity", "depth_file", help="Disparity map from 'clplen depth'; adds a point cloud."
)
@camera_lengths
@click.option(
    "--focal-px",
    type=click.FloatRange(0, min_open=True),
    help="Focal length in pixels, if no lengths are given. Default: the width of a view.",
)
@click.option(
    "--infinity",
    metavar="D",
    type=options.FINITE,
    help="Disparity at infinity, at most 0, if no lengths are given. Default: 0.",
)
@tone
@options.layout
@options.device
def poses(
    source: Path,
    output: Path,
    kind: str,
    depth_file: Path | None,
    focal_px: float | None,
    infinity: float | None,
    limits: Any,
    curve: Any,
    selector: str | None,
    **layout: Any,
) -> None:
    """Write views with poses for NeRF, splatting or COLMAP.

    Positions are in metres if lengths are given or the light field stores its camera. Otherwise
    the unit is the distance of neighbouring views.

    \b
    Example:
      clplen poses flower.h5 -o for_nerf --format nerf --infinity -1.2
      clplen poses flower.h5 -o for_splats --format colmap --infinity -1.2 --disparity depth.pfm
      clplen poses scene -o metric --format colmap --baseline-mm 5 --focal-length-mm 35 --pixel-um 9
    """
    from clplen.io import write_colmap, write_nerf

    _check_free(output)
    metric = lengths_of_camera(layout)
    if metric and (focal_px is not None or infinity is not None):
        raise click.UsageError(
            "--focal-px and --infinity cannot be combined with lengths: leave them out."
        )
    lf = read(source, selector, layout)
    cameras, unit = _cameras(lf, metric, focal_px, infinity)
    arguments: dict[str, Any] = {"keep": lf.weights > 0}
    cloud = ""
    if depth_file is not None:
        disparity = read_map(depth_file, lf)
        points = cameras.points(disparity).reshape(-1, 3)
        count = int(np.isfinite(points).all(1).sum())
        if not count:
            raise click.UsageError(
                f"No pixel of {depth_file} lies in front of the cameras: its disparities are at "
                f"most {disparity.max():.4g}; give a lower --infinity, or --focus-m."
            )
        if count < len(points):
            behind = len(points) - count
            note(f"{behind:,} pixels at or beyond infinity are left out of the points.")
        arguments |= {"points": points, "colours": colours_of(lf)}
        cloud = f", {count:,} points"
    write = write_nerf if kind == "nerf" else write_colmap
    write(output, _pictures(lf, Tone(limits, curve), layout), cameras, **arguments)
    click.echo(
        f"{output}: {int(np.count_nonzero(lf.weights))} views with their poses{cloud}; {unit}."
    )


def _check_free(output: Path) -> None:
    """Raise an error if the output folder is not empty or cannot be created."""
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        raise click.UsageError(f"{output} exists and is not empty: choose a new folder.")
    if not output.absolute().parent.is_dir():
        raise click.UsageError(
            f"{output} cannot be created, because {output.parent} does not exist: create it, or "
            "choose another folder."
        )


def _cameras(
    lf: LightField, metric: dict[str, Any] | None, focal_px: float | None, infinity: float | None
) -> tuple[ViewCameras, str]:
    """Return the cameras of the views and a sentence about the unit."""
    from clplen.lightfield.model.view_cameras import view_cameras
    from clplen.lightfield.raw.raw_image import is_telecentric

    is_relative = focal_px is not None or infinity is not None
    has_camera = lf.camera is not None and lf.spacing is not None and not is_telecentric(lf)
    if metric or (has_camera and not is_relative):
        return view_cameras(lf, **(metric or {})), "lengths are in metres"
    if infinity is not None and infinity > 0:
        raise click.UsageError(
            f"--infinity must be at most 0, got {infinity:g}: shift the views first with "
            "clplen.lightfield.shift_views."
        )
    focal = float(lf.shape[3]) if focal_px is None else focal_px
    far = 0.0 if infinity is None else infinity
    focus = focal / -far if far else None
    cameras = view_cameras(
        lf, baseline=1.0, focal_length=focal, pixel_pitch=1.0, focus_distance=focus
    )
    return cameras, (
        f"the unit is the distance of neighbouring views, the focal length {focal:g} px"
        f"{' (the width of a view)' if focal_px is None else ''}, and disparity {far:g} lies at "
        "infinity"
    )


def _pictures(lf: LightField, tone: Tone, layout: dict[str, Any]) -> Values:
    """Return all views as uint8."""
    from clplen.io.formats.animation import toned, white_level

    samples = drawable(lf.to_numpy())
    srgb = bool(layout["srgb"])
    if samples.dtype == np.uint8 and not (tone.limits or tone.curve or srgb):
        return samples
    black, white = tone.limits or (0.0, white_level(samples, lf.dtype, srgb=srgb))
    curve = tone.curve or ("srgb" if srgb else "linear")
    pictures = np.empty(samples.shape, np.uint8)
    for v, u in np.ndindex(*samples.shape[:2]):
        pictures[v, u] = toned(samples[v, u], black, white, curve)
    return pictures
