"""``clplen microscope views``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np

from clplen.cli.microscopy import volume_inputs as inputs
from clplen.cli.microscopy.volume_inputs import (
    check_outputs,
    opened,
    progressing,
    volume_at,
    voxel_of,
)
from clplen.cli.shared import options

if TYPE_CHECKING:
    from clplen.io import StoredVolumes
    from clplen.microscopy import Tracks

_PATH = click.Path(path_type=Path)
_FIGURES = (".png", ".pdf", ".svg")
_FILMS = (".gif", ".mp4")


@click.command()
@inputs.volumes
@click.option(
    "-o", "--output", required=True, metavar="VIEWS.png|.pdf|.svg|.gif|.mp4", type=_PATH,
    help="Output: a picture, or a GIF or MP4 film of all times.",
)  # fmt: skip
@click.option(
    "--slices", type=inputs.Numbers("Z,Y,X", "10,40,40", (3,), of=" of a voxel", kind=int),
    help="Indices of a voxel; slices through it replace the projections.",
)  # fmt: skip
@click.option(
    "--montage", type=click.Choice(["z", "y", "x"]),
    help="Axis of projection; draw the projections of all times side by side.",
)  # fmt: skip
@inputs.time
@click.option(
    "--tracks", "tracks_file", metavar="TRACKS.csv", type=_PATH,
    help="Table of tracks to draw over the projections.",
)  # fmt: skip
@click.option(
    "--scale", type=click.Choice(["linear", "log", "root"]), default="linear", show_default=True,
    help="Scale of the colours.",
)  # fmt: skip
@click.option(
    "--seconds", type=float, default=0.2, show_default=True,
    help="Duration of each picture of a film, in seconds.",
)  # fmt: skip
@inputs.voxel
@options.force_output
def views(
    volumes: tuple[Path, ...],
    output: Path,
    slices: tuple[int, int, int] | None,
    montage: Literal["z", "y", "x"] | None,
    time: int | str | None,
    tracks_file: Path | None,
    scale: Literal["linear", "log", "root"],
    seconds: float,
    voxel_um: tuple[float, float, float] | None,
    force: bool,
) -> None:
    """Draw three orthogonal views of volumes: maximum projections or slices, with scale bars.

    All views share a length scale, given by the voxel size.

    \b
    Example:
      clplen microscope views beads.ome.tif -o beads.png
      clplen microscope views series.ome.tif -o series.gif --tracks tracks.csv
      clplen microscope views series.ome.tif -o series.png --montage z
    """
    is_film = output.suffix.lower() in _FILMS
    _check(is_film, slices, montage, time, tracks_file)
    series = opened(volumes)
    if slices is not None and any(k >= n for k, n in zip(slices, series.shape[1:], strict=True)):
        raise click.UsageError(
            f"--slices {','.join(map(str, slices))} lies outside the volume of the shape "
            f"(z, y, x) = {series.shape[1:]}; numbers start at 0."
        )
    others = [] if tracks_file is None else [tracks_file]
    check_outputs(series, force, (output, (*_FIGURES, *_FILMS)), others=others)
    arguments: dict[str, Any] = {"voxel": voxel_of(series, voxel_um), "scale": scale}
    if montage is not None:
        _draw_montage(output, series, montage, arguments)
        return
    arguments |= {"at": slices, "tracks": _tracks(tracks_file)}
    arguments["origin"] = 0.0 if series.planes is None else float(series.planes[0])
    if is_film:
        _film(output, series, seconds, arguments)
        return
    from clplen.plot import orthogonal_views, save

    volume = volume_at(series, time)
    frame = (time if isinstance(time, int) else None) if len(series) > 1 else None
    save(orthogonal_views(volume, frame=frame, **arguments), output)
    click.echo(
        f"{output}: {'slices' if slices else 'maximum projections'} of {_size(series, arguments)}."
    )


def _check(
    is_film: bool,
    slices: Any,
    montage: str | None,
    time: int | str | None,
    tracks_file: Path | None,
) -> None:
    if montage is not None and (is_film or slices or time is not None or tracks_file):
        raise click.UsageError(
            "--montage cannot be combined with --slices, --time, --tracks or a film: leave them "
            "out."
        )
    if is_film and time is not None:
        raise click.UsageError("A film shows all times: leave --time out, or write .png.")
    if slices is not None and tracks_file is not None:
        raise click.UsageError("--tracks cannot be combined with --slices.")


def _tracks(path: Path | None) -> Tracks | None:
    from clplen.microscopy import Tracks

    return None if path is None else Tracks.from_csv(path)


def _size(series: StoredVolumes, arguments: dict[str, Any]) -> str:
    um = " x ".join(f"{1e6 * n * side:.4g}" for n, side in
                    zip(series.shape[1:], arguments["voxel"], strict=True))  # fmt: skip
    return f"{um} um (z, y, x)"


def _draw_montage(
    output: Path, series: StoredVolumes, axis: Literal["z", "y", "x"], arguments: dict[str, Any]
) -> None:
    """Draw the projections of all times; hold one volume in memory at a time."""
    from clplen.plot import maximum_projection, save

    along = {"z": 0, "y": 1, "x": 2}[axis]
    flat = [volume.max(axis=along, keepdims=True) for volume in progressing(series)]
    save(maximum_projection(np.stack(flat), axis=axis, max_frames=len(flat), **arguments), output)
    click.echo(f"{output}: {len(flat)} projections along {axis} of {_size(series, arguments)}.")


def _film(output: Path, series: StoredVolumes, seconds: float, arguments: dict[str, Any]) -> None:
    """Write a film of all times with one scale of values."""
    from clplen.io import write_animation
    from clplen.io.formats.video import encoder

    if output.suffix.lower() == ".mp4":
        encoder()
    low, high = np.inf, -np.inf
    for volume in progressing(series):
        valid = volume[np.isfinite(volume)]
        low, high = min(low, valid.min(initial=low)), max(high, valid.max(initial=high))
    lowest = high / 1000 if arguments["scale"] == "log" else min(float(low), 0.0)
    arguments["limits"] = (lowest, float(high) if high > lowest else lowest + 1)
    write_animation(output, _pictures(series, arguments), seconds=seconds)
    click.echo(f"{output}: a film of {len(series)} volumes of {_size(series, arguments)}.")


def _pictures(series: StoredVolumes, arguments: dict[str, Any]) -> Iterator[Any]:
    """Draw each volume as uint8 (y, x, 3)."""
    from clplen.plot import orthogonal_views, rendered

    for time, volume in enumerate(progressing(series)):
        yield rendered(orthogonal_views(volume, frame=time, title=f"frame {time}", **arguments))
