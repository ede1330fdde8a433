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
@options.output("FOLDER", "A new folder.")
@click.option(
    "--format",
    "kind",
    required=True,
    type=click.Choice(["nerf", "colmap"]),
    help="transforms.json of instant-ngp and nerfstudio, or COLMAP's text files.",
)
@options.file("--disparity", "depth_file", help="Map of 'clplen depth', written as points.")
@camera_lengths
@click.option(
    "--focal-px",
    type=click.FloatRange(0, min_open=True),
    help="Focal length in pixels, where no lengths are given; default: the width of a view.",
)
@click.option(
    "--infinity",
    metavar="D",
    type=options.FINITE,
    help="Disparity at infinity, where no lengths are given, at most 0; default: 0.",
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
    """Write the views with their camera poses, for NeRF, Gaussian splatting and COLMAP.

    In metres where lengths are given or the light field knows its camera; else a step from view to
    view is 1.

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
        raise click.UsageError("--focal-px and --infinity are for views without lengths.")
    lf = read(source, selector, layout)
    cameras, unit = _cameras(lf, metric, focal_px, infinity)
    words: dict[str, Any] = {"keep": lf.weights > 0}
    placed = ""
    if depth_file is not None:
        disparity = read_map(depth_file, lf)
        points = cameras.points(disparity).reshape(-1, 3)
        count = int(np.isfinite(points).all(1).sum())
        if not count:
            raise click.UsageError(
                f"No pixel of {depth_file} lies before the cameras: its disparities are at most "
                f"{disparity.max():.4g}; give --infinity below them, or --focus-m."
            )
        if count < len(points):
            behind = len(points) - count
            note(f"{behind:,} pixels lie at infinity or beyond it, and are left out of the points.")
        words |= {"points": points, "colours": colours_of(lf)}
        placed = f", {count:,} points"
    write = write_nerf if kind == "nerf" else write_colmap
    write(output, _pictures(lf, Tone(limits, curve), layout), cameras, **words)
    click.echo(
        f"{output}: {int(np.count_nonzero(lf.weights))} views with their poses{placed}; {unit}."
    )


def _check_free(output: Path) -> None:
    """Refuse a folder that holds something, before anything is read."""
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        raise click.UsageError(f"{output} is there already and not empty: name a new folder.")
    if not output.absolute().parent.is_dir():
        raise click.UsageError(
            f"{output} cannot be written: there is no folder {output.parent}; make it, or choose "
            "another."
        )


def _cameras(
    lf: LightField, metric: dict[str, Any] | None, focal_px: float | None, infinity: float | None
) -> tuple[ViewCameras, str]:
    """The cameras of the views, and the unit of their lengths."""
    from clplen.lightfield.model.view_cameras import view_cameras
    from clplen.lightfield.raw.raw_image import is_telecentric

    own = focal_px is not None or infinity is not None
    known = lf.camera is not None and lf.spacing is not None and not is_telecentric(lf)
    if metric or (known and not own):
        return view_cameras(lf, **(metric or {})), "lengths are in metres"
    if infinity is not None and infinity > 0:
        raise click.UsageError(
            f"--infinity is at most 0, not {infinity:g}: views in which even infinity lies before "
            "the plane they look at are shifted first (clplen.lightfield.shift_views)."
        )
    focal = float(lf.shape[3]) if focal_px is None else focal_px
    far = 0.0 if infinity is None else infinity
    focus = focal / -far if far else None
    found = view_cameras(
        lf, baseline=1.0, focal_length=focal, pixel_pitch=1.0, focus_distance=focus
    )
    return found, (
        f"a step from view to view is 1, the focal length {focal:g} px"
        f"{' (the width of a view)' if focal_px is None else ''}, and disparity {far:g} lies at "
        "infinity"
    )


def _pictures(lf: LightField, tone: Tone, layout: dict[str, Any]) -> Values:
    """All views as uint8."""
    from clplen.io.formats.animation import toned, white_level

    samples = drawable(lf.to_numpy())
    srgb = bool(layout["srgb"])
    if samples.dtype == np.uint8 and not (tone.limits or tone.curve or srgb):
        return samples
    black, white = tone.limits or (0.0, white_level(samples, lf.dtype, srgb=srgb))
    curve = tone.curve or ("srgb" if srgb else "linear")
    made = np.empty(samples.shape, np.uint8)
    for v, u in np.ndindex(*samples.shape[:2]):
        made[v, u] = toned(samples[v, u], black, white, curve)
    return made
