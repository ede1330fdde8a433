"""Volumes and series as inputs of commands: options, coordinates of voxels, choice of a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.shared.console import check_output, check_suffix, note, progress_bar

if TYPE_CHECKING:
    from clplen.io import StoredVolumes

Values = np.ndarray[Any, Any]
_PATH = click.Path(path_type=Path)


class Numbers(click.ParamType):
    """Comma-separated numbers; micrometres are converted to metres."""

    def __init__(
        self, name: str, example: str, count: tuple[int, ...], *, of: str = "", kind: type = float,
        above: float = -1e-300, is_um: bool = False,
    ) -> None:  # fmt: skip
        self.name, self.example, self.count, self.above = name, example, count, above
        self.of, self.kind, self.is_um = of, kind, is_um

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if isinstance(value, tuple):
            return value
        try:
            numbers = [self.kind(part) for part in str(value).split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in self.count or not all(self.above < n < np.inf for n in numbers):
            self.fail(
                f"{value!r} is not {self.name}{self.of}: give for example {self.example}.",
                param,
                ctx,
            )
        return tuple(n / 1e6 for n in numbers) if self.is_um else tuple(numbers)


MICRONS: dict[str, Any] = {"of": " in micrometres", "is_um": True}


class Time(click.ParamType):
    """Number of a volume from 0, "mean" or "max"."""

    name = "N|mean|max"

    def convert(self, value: Any, param: Any, ctx: Any) -> int | str:
        if value in ("mean", "max") or isinstance(value, int):
            return value
        if not str(value).isdecimal():
            self.fail(f"{value!r} is not a time: give {self.name}, the first is 0.", param, ctx)
        return int(value)


PAIR = Numbers("PLANES,VOXELS", "1,1.5", (2,))
volumes = click.argument("volumes", metavar="VOLUME...", nargs=-1, required=True, type=_PATH)
voxel = click.option(
    "--voxel-um",
    type=Numbers("Z,Y,X", "2,0.5,0.5", (3,), above=0, **MICRONS),
    help="Size of a voxel, in micrometres. Default: the size in the file.",
)
time = click.option(
    "--time",
    type=Time(),
    help="Volume of a series: its number from 0, or the mean or max over time. Default: 0.",
)
size = click.option(
    "--size", type=PAIR, default=(1.0, 1.0), show_default="1,1",
    help="Standard deviation of the smoothing, in planes and voxels; best the full width at half "
    "maximum of a point over 2.35.",
)  # fmt: skip
snr = click.option(
    "--snr", type=float, default=6.0, show_default=True,
    help="Minimum height of a detection, as a multiple of the noise.",
)  # fmt: skip
distance = click.option(
    "--distance", type=PAIR, default=(2.0, 3.0), show_default="2,3",
    help="Minimum distance between detected points, in planes and voxels.",
)  # fmt: skip


def opened(paths: tuple[Path, ...]) -> StoredVolumes:
    """Open the volumes of files without reading them."""
    from clplen.io import open_volumes

    return open_volumes(paths)


def opened_series(paths: tuple[Path, ...], what: str) -> StoredVolumes:
    """Open volumes of several times without reading them."""
    series = opened(paths)
    if len(series) < 2:
        raise click.UsageError(
            f"{paths[0]} holds one volume, but {what} need several times: give a series or more "
            "files."
        )
    return series


def check_outputs(
    series: StoredVolumes, force: bool, *outputs: tuple[Path | None, tuple[str, ...]],
    others: Iterable[Path] = (),
) -> None:  # fmt: skip
    """Reject outputs with a wrong suffix, inputs, and files of other programs."""
    read = [*(file.path for file in series.files), *others]
    for path, suffixes in outputs:
        if path is not None:
            check_suffix(path, suffixes)
            check_output(path, force, read)


def axes_of(series: StoredVolumes, voxel_um: tuple[float, float, float] | None) -> Any:
    """Return the coordinates of planes, rows and columns in metres."""
    _, *shape = series.shape
    if voxel_um is not None:
        z, y, x = (step * np.arange(n) for step, n in zip(voxel_um, shape, strict=True))
        return z if series.planes is None else z + series.planes[0], y, x
    if series.axes is None:
        what = "distance of its planes" if series.planes is None else "size of its voxels"
        raise click.UsageError(
            f"{series.files[0].path} does not store the {what}: give --voxel-um Z,Y,X."
        )
    return series.axes


def voxel_of(series: StoredVolumes, voxel_um: tuple[float, float, float] | None) -> Any:
    """Return (dz, dy, dx) in metres, with the mean distance of planes."""
    if series.shape[1] == 1 and voxel_um is None and series.voxel is not None:
        return (series.voxel[0], *series.voxel)  # the thickness of a single plane is unknown
    steps = [np.abs(np.diff(axis)) for axis in axes_of(series, voxel_um)]
    sides = tuple(float(step.mean()) if step.size else 1e-6 for step in steps)
    if steps[0].size and np.ptp(steps[0]) > 1e-3 * sides[0]:
        note("planes are not equidistant: they are drawn at their mean distance.")
    return sides


def volume_at(series: StoredVolumes, time: int | str | None) -> Values:
    """Return a volume of a series, or the mean or maximum of each voxel over time."""
    count = len(series)
    if isinstance(time, int) or time is None:
        number = time or 0
        if number >= count:
            raise click.UsageError(
                f"--time must be below {count}, the number of times, got {number}."
            )
        if time is None and count > 1:
            note(f"volume 0 of {count} is used: choose another with --time N, mean or max.")
        return series[number]
    total: Values | None = None
    for volume in progressing(series):
        values = volume.astype(np.float64)
        if total is None:
            total = values
        elif time == "mean":
            total += values
        else:
            np.maximum(total, values, out=total)
    assert total is not None
    return total / count if time == "mean" else total


def progressing(series: StoredVolumes) -> Iterator[Values]:
    """Yield the volumes in order, with a progress bar."""
    with progress_bar(len(series), "volume") as bar:
        for volume in series:
            yield volume
            bar.update()
