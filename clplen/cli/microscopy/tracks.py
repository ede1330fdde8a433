"""``clplen microscope points``, ``regions`` and ``track``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np

from clplen.cli.microscopy import volume_inputs as inputs
from clplen.cli.microscopy.volume_inputs import (
    axes_of,
    check_outputs,
    opened,
    opened_series,
    progressing,
    volume_at,
)
from clplen.cli.shared import options
from clplen.cli.shared.console import note

if TYPE_CHECKING:
    from clplen.io import StoredVolumes

_PATH = click.Path(path_type=Path)
_CSV = (".csv",)
Micrometres = tuple[float, float, float] | None

threshold = click.option(
    "--threshold", type=options.FINITE,
    help="Minimum value of a region in the smoothed volume. Default: Otsu's threshold, at least "
    "--snr times the noise.",
)  # fmt: skip
split = click.option(
    "--split", type=click.FloatRange(0, 1), default=0.9, show_default=True,
    help="Split touching regions if the saddle is below this fraction of the lower maximum.",
)  # fmt: skip
min_voxels = click.option(
    "--least", "min_voxels", type=click.IntRange(1), default=8, show_default=True,
    help="Minimum number of voxels of a region.",
)  # fmt: skip


@click.command()
@inputs.volumes
@click.option(
    "-o", "--output", required=True, metavar="POINTS.csv", type=_PATH, help="Output table."
)
@inputs.time
@inputs.size
@inputs.snr
@inputs.distance
@inputs.voxel
@options.force_output
def points(
    volumes: tuple[Path, ...],
    output: Path,
    time: int | str | None,
    size: tuple[float, float],
    snr: float,
    distance: tuple[float, float],
    voxel_um: Micrometres,
    force: bool,
) -> None:
    """Detect points such as beads in a volume; write their positions, heights and widths.

    VOLUME is OME-TIFF, OME-Zarr, TIFF or .npy. Positions are in metres with sub-voxel accuracy: z
    as in the file, y and x from the centre of the first voxel.

    \b
    Example:
      clplen microscope points beads.ome.tif -o beads.csv
    """
    from clplen.microscopy import find_points

    series = opened(volumes)
    check_outputs(series, force, (output, _CSV))
    axes = axes_of(series, voxel_um)
    volume = volume_at(series, time)
    detections = find_points(volume, axes=axes, size=size, snr=snr, distance=distance)
    if not len(detections):
        raise click.ClickException(_none("point", series, snr))
    detections.to_csv(output)
    z, y, x = np.nanmedian(detections.widths, axis=0) * 1e6
    click.echo(
        f"{output} holds {len(detections)} points; median full width at half maximum: {z:.3g} um "
        f"along z, {y:.3g} um along y, {x:.3g} um along x."
    )


@click.command()
@inputs.volumes
@click.option(
    "-o", "--output", required=True, metavar="REGIONS.csv", type=_PATH, help="Output table."
)
@click.option(
    "--labels", metavar="LABELS.ome.tif", type=_PATH,
    help="Output volume with the region number of each voxel, for 'clplen microscope traces'.",
)  # fmt: skip
@inputs.time
@inputs.size
@inputs.snr
@threshold
@split
@min_voxels
@inputs.voxel
@options.force_output
def regions(
    volumes: tuple[Path, ...],
    output: Path,
    labels: Path | None,
    time: int | str | None,
    voxel_um: Micrometres,
    force: bool,
    **settings: Any,
) -> None:
    """Segment bright regions such as cells; write their positions, volumes and brightness.

    \b
    Example:
      clplen microscope regions cells.ome.tif --time mean -o cells.csv --labels labels.ome.tif
    """
    from clplen.io import write_volume
    from clplen.microscopy import find_regions

    series = opened(volumes)
    check_outputs(series, force, (output, _CSV), (labels, (".tif", ".tiff", ".zarr")))
    axes = axes_of(series, voxel_um)
    segmentation = find_regions(volume_at(series, time), axes=axes, **settings)
    if not len(segmentation):
        raise click.ClickException(_none("region", series, settings["snr"]))
    if labels is not None:
        step = (float(axes[1][1] - axes[1][0]), float(axes[2][1] - axes[2][0]))
        about = {"regions": len(segmentation), "threshold": segmentation.threshold}
        write_volume(labels, segmentation.labels, planes=axes[0], voxel=step, description=about)
    segmentation.to_csv(output)
    click.echo(
        f"{output} holds {len(segmentation)} regions above {segmentation.threshold:.4g}, "
        f"with volumes of {segmentation.volumes.min() * 1e18:.3g} to "
        f"{segmentation.volumes.max() * 1e18:.3g} um^3."
    )


@click.command()
@inputs.volumes
@click.option(
    "-o", "--output", required=True, metavar="TRACKS.csv", type=_PATH, help="Output table."
)
@click.option(
    "--step-um", required=True,
    type=inputs.Numbers("LENGTH|Z,Y,X", "3 or 6,3,3", (1, 3), above=0, **inputs.MICRONS),
    help="Maximum step from frame to frame, in micrometres: a radius, or the half axes of an "
    "ellipsoid.",
)  # fmt: skip
@click.option(
    "--gaps", type=click.IntRange(0), default=0, show_default=True,
    help="Maximum number of consecutive frames without a detection in a track.",
)  # fmt: skip
@click.option(
    "--motion", type=click.Choice(["random", "straight"]), default="random", show_default=True,
    help="Motion model: expect a point at its last position (random), or along its last steps "
    "(straight).",
)  # fmt: skip
@click.option(
    "--shortest", type=click.IntRange(1), default=1, show_default=True,
    help="Minimum number of points of a track.",
)  # fmt: skip
@click.option("--regions", "is_region", is_flag=True, help="Track regions instead of points.")
@click.option(
    "--napari", metavar="TRACKS.npy", type=_PATH,
    help="Output array for napari's Tracks layer: track, frame, z, y, x in micrometres.",
)  # fmt: skip
@inputs.size
@inputs.snr
@inputs.distance
@threshold
@split
@min_voxels
@inputs.voxel
@options.force_output
def track(
    volumes: tuple[Path, ...],
    output: Path,
    step_um: tuple[float, ...],
    gaps: int,
    motion: Literal["random", "straight"],
    shortest: int,
    is_region: bool,
    napari: Path | None,
    voxel_um: Micrometres,
    force: bool,
    **settings: Any,
) -> None:
    """Detect points or regions in each volume of a series, and link them to tracks.

    VOLUME is a file with several times, or a list of files in order of time. Only one volume is in
    memory at a time.

    \b
    Example:
      clplen microscope track series.ome.tif -o tracks.csv --step-um 3 --gaps 2
      clplen microscope track t*.ome.tif -o tracks.csv --step-um 6,3,3 --napari tracks.npy
    """
    from clplen.io import write_npy
    from clplen.microscopy import track_points

    series = opened_series(volumes, "tracks")
    check_outputs(series, force, (output, _CSV), (napari, (".npy",)))
    axes = axes_of(series, voxel_um)
    detections = _detections(series, axes, is_region, settings)
    step = step_um if len(step_um) > 1 else step_um[0]
    tracks = track_points(
        detections, step=step, gaps=gaps, motion=motion, shortest=shortest, unit="m"
    )
    if not len(tracks):
        kind = "region" if is_region else "point"
        raise click.ClickException(
            _none(kind, series, settings["snr"]) if shortest == 1 else
            f"No track has {shortest} {kind}s: lower --shortest, or increase --step-um or --gaps."
        )  # fmt: skip
    tracks.to_csv(output)
    if napari is not None:
        write_npy(napari, tracks.napari())
    lengths = np.bincount(tracks.ids)
    click.echo(
        f"{output} holds {len(tracks)} tracks with {lengths.sum()} "
        f"{'regions' if is_region else 'points'} in all, over {len(series)} frames; "
        f"median length {np.median(lengths):g} frames."
    )
    if np.mean(lengths == 1) > 0.5:
        note("more than half of the tracks have a single frame: increase --step-um.")


def _detections(
    series: StoredVolumes, axes: Any, is_region: bool, settings: dict[str, Any]
) -> Iterator[Any]:
    """Detect the points or regions of each volume."""
    from clplen.microscopy import find_points, find_regions

    names = ("threshold", "split", "min_voxels") if is_region else ("distance",)
    arguments = {name: settings[name] for name in ("size", "snr", *names)}
    find = find_regions if is_region else find_points
    for time, volume in enumerate(progressing(series)):
        try:
            yield find(volume, axes=axes, **arguments)
        except ValueError as error:
            raise click.ClickException(f"Volume {time}: {error}") from error


def _none(kind: str, series: StoredVolumes, snr: float) -> str:
    return (
        f"{series.files[0].path} has no {kind} above {snr:g} times the noise: lower --snr, or set "
        f"--size to the size of a {kind}."
    )
