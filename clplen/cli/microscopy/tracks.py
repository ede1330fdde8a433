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
    help="Of the smoothed volume; default Otsu's, but at least --snr times the noise.",
)  # fmt: skip
split = click.option(
    "--split", type=click.FloatRange(0, 1), default=0.9, show_default=True,
    help="Regions that touch are two if the saddle between them is below this share of the lower.",
)  # fmt: skip
least = click.option(
    "--least", "min_voxels", type=click.IntRange(1), default=8, show_default=True,
    help="Voxels of a region.",
)  # fmt: skip


@click.command()
@inputs.volumes
@click.option("-o", "--output", required=True, metavar="POINTS.csv", type=_PATH)
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
    """Find points such as beads in a volume: a table of their places, heights and widths.

    VOLUME is OME-TIFF, OME-Zarr, TIFF or .npy. Places are in metres, z as the file has it, y and x
    from the middle of the first voxel, finer than voxels.

    \b
    Example:
      clplen microscope points beads.ome.tif -o beads.csv
    """
    from clplen.microscopy import find_points

    series = opened(volumes)
    check_outputs(series, force, (output, _CSV))
    axes = axes_of(series, voxel_um)
    volume = volume_at(series, time)
    found = find_points(volume, axes=axes, size=size, snr=snr, distance=distance)
    if not len(found):
        raise click.ClickException(_none("point", series, snr))
    found.to_csv(output)
    z, y, x = np.nanmedian(found.widths, axis=0) * 1e6
    click.echo(
        f"{output} holds {len(found)} points; widths at half height, median: {z:.3g} um along z, "
        f"{y:.3g} and {x:.3g} um along y and x."
    )


@click.command()
@inputs.volumes
@click.option("-o", "--output", required=True, metavar="REGIONS.csv", type=_PATH)
@click.option(
    "--labels", metavar="LABELS.ome.tif", type=_PATH,
    help="Write which region a voxel belongs to, too, for 'clplen microscope traces'.",
)  # fmt: skip
@inputs.time
@inputs.size
@inputs.snr
@threshold
@split
@least
@inputs.voxel
@options.force_output
def regions(
    volumes: tuple[Path, ...],
    output: Path,
    labels: Path | None,
    time: int | str | None,
    voxel_um: Micrometres,
    force: bool,
    **how: Any,
) -> None:
    """Find bright regions such as cells in a volume: places, volumes and brightness, and labels.

    \b
    Example:
      clplen microscope regions cells.ome.tif --time mean -o cells.csv --labels labels.ome.tif
    """
    from clplen.io import write_volume
    from clplen.microscopy import find_regions

    series = opened(volumes)
    check_outputs(series, force, (output, _CSV), (labels, (".tif", ".tiff", ".zarr")))
    axes = axes_of(series, voxel_um)
    found = find_regions(volume_at(series, time), axes=axes, **how)
    if not len(found):
        raise click.ClickException(_none("region", series, how["snr"]))
    if labels is not None:
        step = (float(axes[1][1] - axes[1][0]), float(axes[2][1] - axes[2][0]))
        about = {"regions": len(found), "threshold": found.threshold}
        write_volume(labels, found.labels, planes=axes[0], voxel=step, description=about)
    found.to_csv(output)
    click.echo(
        f"{output} holds {len(found)} regions above {found.threshold:.4g}, "
        f"{found.volumes.min() * 1e18:.3g} to {found.volumes.max() * 1e18:.3g} um^3 large."
    )


@click.command()
@inputs.volumes
@click.option("-o", "--output", required=True, metavar="TRACKS.csv", type=_PATH)
@click.option(
    "--step-um", required=True,
    type=inputs.Numbers("LENGTH|Z,Y,X", "3 or 6,3,3", (1, 3), above=0, **inputs.MICRONS),
    help="Largest step from frame to frame: one length, or half axes of an ellipsoid.",
)  # fmt: skip
@click.option(
    "--gaps", type=click.IntRange(0), default=0, show_default=True,
    help="Frames that a track may miss.",
)  # fmt: skip
@click.option(
    "--motion", type=click.Choice(["random", "straight"]), default="random", show_default=True,
    help="Expect a point where it was, or where its last steps lead.",
)  # fmt: skip
@click.option(
    "--shortest", type=click.IntRange(1), default=1, show_default=True,
    help="Points that a track has at least.",
)  # fmt: skip
@click.option("--regions", "is_region", is_flag=True, help="Track regions instead of points.")
@click.option(
    "--napari", metavar="TRACKS.npy", type=_PATH,
    help="Write the array of napari's layer Tracks, too: track, frame, z, y, x in micrometres.",
)  # fmt: skip
@inputs.size
@inputs.snr
@inputs.distance
@threshold
@split
@least
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
    **how: Any,
) -> None:
    """Find points or regions in each volume of a series, and link them to tracks.

    VOLUME is one file with times, or several, one after the other; one volume is in memory at a
    time.

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
    found = _found(series, axes, is_region, how)
    step = step_um if len(step_um) > 1 else step_um[0]
    tracks = track_points(
        found, step=step, gaps=gaps, motion=motion, shortest=shortest, unit="m"
    )
    if not len(tracks):
        kind = "region" if is_region else "point"
        raise click.ClickException(
            _none(kind, series, how["snr"]) if shortest == 1 else
            f"No track has {shortest} {kind}s: lower --shortest, or raise --step-um or --gaps."
        )  # fmt: skip
    tracks.to_csv(output)
    if napari is not None:
        write_npy(napari, tracks.napari())
    lengths = np.bincount(tracks.ids)
    click.echo(
        f"{output} holds {len(tracks)} tracks of {lengths.sum()} "
        f"{'regions' if is_region else 'points'} in {len(series)} frames, "
        f"{np.median(lengths):g} long in the median."
    )
    if np.mean(lengths == 1) > 0.5:
        note("more than half of the tracks have one frame only: is --step-um too short?")


def _found(series: StoredVolumes, axes: Any, is_region: bool, how: dict[str, Any]) -> Iterator[Any]:
    """The points or regions of each volume."""
    from clplen.microscopy import find_points, find_regions

    names = ("threshold", "split", "min_voxels") if is_region else ("distance",)
    words = {name: how[name] for name in ("size", "snr", *names)}
    find = find_regions if is_region else find_points
    for time, volume in enumerate(progressing(series)):
        try:
            yield find(volume, axes=axes, **words)
        except ValueError as error:
            raise click.ClickException(f"Volume {time}: {error}") from error


def _none(kind: str, series: StoredVolumes, snr: float) -> str:
    return (
        f"{series.files[0].path} holds no {kind} above {snr:g} times the noise: lower --snr, or "
        "give the --size of one."
    )
