"""``clplen microscope traces``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.microscopy import volume_inputs as inputs
from clplen.cli.microscopy.volume_inputs import (
    axes_of,
    check_outputs,
    opened,
    opened_series,
    progressing,
)
from clplen.cli.shared import options
from clplen.cli.shared.console import note

if TYPE_CHECKING:
    from clplen.io import StoredVolumes

_PATH = click.Path(path_type=Path)


@click.command()
@inputs.volumes
@click.option(
    "-o", "--output", required=True, metavar="TRACES.csv", type=_PATH, help="Output table."
)
@click.option(
    "--labels", metavar="LABELS", type=_PATH, help="Label volume from 'clplen microscope regions'."
)
@click.option(
    "--points", metavar="POINTS.csv", type=_PATH,
    help="Table of points; spheres around them are measured instead of labels.",
)  # fmt: skip
@click.option("--radius-um", type=options.FINITE, help="Radius of the spheres, in micrometres.")
@click.option(
    "--window", type=click.IntRange(1), default=300, show_default=True,
    help="Length of the window for F0, in frames.",
)  # fmt: skip
@click.option(
    "--percentile", type=click.FloatRange(0, 100), default=8.0, show_default=True,
    help="Percentile of F in the window that defines F0.",
)  # fmt: skip
@click.option(
    "--ring-um", type=inputs.Numbers("INNER,OUTER", "2,10", (2,), **inputs.MICRONS),
    help="Inner and outer distance of a surrounding ring, in micrometres, whose light is "
    "subtracted.",
)  # fmt: skip
@click.option(
    "--neuropil", type=click.FloatRange(0, 1), default=0.7, show_default=True,
    help="Fraction of the light of the ring that is subtracted.",
)  # fmt: skip
@inputs.voxel
@options.force_output
def traces(
    volumes: tuple[Path, ...],
    output: Path,
    labels: Path | None,
    points: Path | None,
    radius_um: float | None,
    window: int,
    percentile: float,
    ring_um: tuple[float, float] | None,
    neuropil: float,
    voxel_um: tuple[float, float, float] | None,
    force: bool,
) -> None:
    """Measure the brightness of regions over a series: F, F0 and dF/F.

    F0 is a low percentile of F in a window around each frame; dF/F = (F - F0)/F0. VOLUME is a file
    with several times, or a list of files in order of time.

    \b
    Example:
      clplen microscope regions series.ome.tif --time mean -o cells.csv --labels labels.ome.tif
      clplen microscope traces series.ome.tif --labels labels.ome.tif -o traces.csv --window 200
    """
    from clplen import microscopy

    _check(labels, points, radius_um)
    if ring_um is not None and ring_um[0] >= ring_um[1]:
        raise click.UsageError("--ring-um must be INNER,OUTER with INNER below OUTER.")
    series = opened_series(volumes, "traces")
    inside = [path for path in (labels, points) if path is not None]
    check_outputs(series, force, (output, (".csv",)), others=inside)
    axes = axes_of(series, voxel_um) if points or ring_um or voxel_um else None
    numbers = _labels(series, labels, points, radius_um, axes)
    result = microscopy.traces(
        progressing(series),
        numbers,
        window=window,
        percentile=percentile,
        ring=ring_um,
        axes=axes,
        neuropil=neuropil,
    )
    result.to_csv(output)
    valid = np.isfinite(result.dff).all(axis=1)
    if not valid.all():
        note(
            f"F0 is not positive in {np.count_nonzero(~valid)} of {len(result)} regions; their "
            "dF/F is empty: lower --neuropil, or check whether an offset was subtracted twice."
        )
    largest = f"{np.nanmax(result.dff):.3g}" if np.isfinite(result.dff).any() else "unknown"
    click.echo(
        f"{output} holds {len(result)} regions in {result.means.shape[1]} frames; largest dF/F "
        f"{largest}."
    )
    if window > len(series):
        note(f"--window {window} exceeds the series: F0 is taken from all {len(series)} frames.")


def _check(labels: Path | None, points: Path | None, radius_um: float | None) -> None:
    if (labels is None) == (points is None):
        raise click.UsageError("Give --labels LABELS, or --points POINTS.csv with --radius-um.")
    if (points is None) != (radius_um is None):
        raise click.UsageError("--points and --radius-um must be given together.")
    if radius_um is not None and radius_um <= 0:
        raise click.UsageError(f"--radius-um must be positive, got {radius_um:g}.")


def _labels(
    series: StoredVolumes,
    labels: Path | None,
    points: Path | None,
    radius_um: float | None,
    axes: Any,
) -> Any:
    """Return the number of the region of each voxel."""
    from clplen.microscopy import sphere_labels
    from clplen.microscopy.objects.csv_tables import read_positions

    if labels is not None:
        volumes = opened((labels,))
        if volumes.shape[1:] != series.shape[1:]:
            raise click.ClickException(
                f"{labels} must have the shape of the volumes, {series.shape[1:]}, got "
                f"{volumes.shape[1:]}: give labels of this series."
            )
        return volumes[0]
    assert points is not None
    assert radius_um is not None
    positions, unit, _ = read_positions(points)
    if unit != "m":
        raise click.ClickException(f"{points} has positions in voxels: give a table in metres.")
    if not len(positions):
        raise click.ClickException(f"{points} contains no points.")
    numbers = sphere_labels(positions, radius_um / 1e6, axes)
    missing = len(positions) - len(np.unique(numbers[numbers > 0]))
    if missing == len(positions):
        raise click.ClickException(f"No point of {points} lies in the volumes.")
    if missing:
        note(f"{missing} of {len(positions)} points contain no voxel and are left out.")
    return numbers
