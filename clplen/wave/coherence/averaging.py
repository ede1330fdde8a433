"""Averages of snapshots: when they stop, and the checkpoints from which they go on."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import is_finite
from clplen.compute.device import Device
from clplen.errors import FormatError, SamplingWarning, warn_caller
from clplen.files import PathLike, check_writable, replacing
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import MeanIntensity, Region, Statistics, Window

FORMAT = "clplen average 2"
Checkpoint = PathLike | tuple[PathLike, str]  # a file, or a file and the label of its run
Arrays = dict[str, np.ndarray[Any, Any]]


def named(checkpoint: Checkpoint) -> tuple[PathLike, str]:
    """Return the file of a checkpoint and its label."""
    return checkpoint if isinstance(checkpoint, tuple) else (checkpoint, "")


def verify(path: PathLike) -> None:
    """Refuse a file that cannot be written, or that exists and is no whole checkpoint."""
    target = check_writable(path)
    if target.exists():
        _read(target)


def _load(path: PathLike, setup: dict[str, str]) -> tuple[dict[str, Any], Arrays] | None:
    """Read a checkpoint of this set-up; None where there is no file."""
    target = check_writable(path)
    if not target.exists():
        return None
    heading, arrays = _read(target)
    for name, now in setup.items():
        then = heading["setup"].get(name)
        if then != now:
            raise FormatError(
                f"The checkpoint {target} is of another set-up: its {name} is {then}, this run's "
                f"is {now}. Name another file, or remove this one to start anew."
            )
    return heading, arrays


def _read(target: Path) -> tuple[dict[str, Any], Arrays]:
    try:  # the archive has a checksum of each member
        with target.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            heading = json.loads(str(file["heading"]))
            arrays = {name: file[name] for name in ("mean", "m2", "convergence")}
            if heading["format"] != FORMAT:
                raise ValueError(heading["format"])
    except Exception as error:  # whatever a broken archive makes its readers raise
        raise FormatError(
            f"The checkpoint {target} is damaged or no checkpoint; remove it to start anew, or "
            "name another file."
        ) from error
    return heading, arrays


Progress = Callable[[int, int], None]

DEFAULT = 100  # snapshots, where neither a number nor a tolerance is given
MOST = 100_000  # where only a tolerance is given
LARGEST = 10**9  # some days even of tiny fields
LEAST = 16  # before a tolerance may stop an average: the error itself is uncertain by 1/sqrt(2 k)
SAVE_SECONDS = 5.0  # between checkpoints


@dataclass(frozen=True)
class Averaging:
    """When an average of snapshots stops, and what it does meanwhile."""

    snapshots: int | None = None
    rtol: float | None = None
    region: Region | None = None
    checkpoint: Checkpoint | None = None
    progress: Progress | None = None

    def __post_init__(self) -> None:
        number = self.snapshots
        if number is not None and not (
            isinstance(number, (int, np.integer))
            and not isinstance(number, bool)
            and 1 <= number <= LARGEST
        ):
            raise ValueError(
                f"snapshots is a whole number from 1 to {LARGEST:.0e}, not {number!r}."
            )
        if self.rtol is not None and not (is_finite(self.rtol) and self.rtol > 0):
            raise ValueError(f"rtol, standard error over mean, is positive, not {self.rtol!r}.")

    @property
    def most(self) -> int:
        """Snapshots after which it stops in any case."""
        if self.snapshots is not None:
            return int(self.snapshots)
        return DEFAULT if self.rtol is None else MOST


def average(
    snapshot: Callable[[int], Field | cla.Array],
    grid: Grid,
    device: Device,
    how: Averaging,
    setup: dict[str, str],
) -> MeanIntensity:
    """Add snapshots until enough are there."""
    window = Window.of(how.region, grid.shape)
    statistics = Statistics(grid.shape, device)
    curve: list[tuple[int, float]] = []
    path = None
    if how.checkpoint is not None:
        path, label = named(how.checkpoint)
        setup = {"label": label or "empty", **setup, "region": str(window)}
        if (stored := _load(path, setup)) is not None:
            heading, arrays = stored
            statistics.restore(arrays["mean"], arrays["m2"], heading["count"], heading["unit"])
            curve = [(int(k), float(error)) for k, error in arrays["convergence"]]
    saved = time.monotonic()
    while statistics.count < how.most and not _reached(curve, statistics.count, how.rtol):
        statistics.add(snapshot(statistics.count))
        if _due(statistics.count):
            curve.append((statistics.count, statistics.relative_error(window)))
            _require_light(curve, how)
        if how.progress is not None:
            how.progress(statistics.count, how.most)
        if path is not None and time.monotonic() - saved > SAVE_SECONDS:
            _keep(path, statistics, curve, setup)
            saved = time.monotonic()
    if path is not None:
        _keep(path, statistics, curve, setup)
    if not _due(statistics.count):
        curve.append((statistics.count, statistics.relative_error(window)))
    if how.rtol is not None and not curve[-1][1] <= how.rtol:
        warn_caller(
            f"After {statistics.count} snapshots the standard error is {curve[-1][1]:.3g} of the "
            f"mean, not {how.rtol:g}: allow more snapshots.",
            SamplingWarning,
        )
    return MeanIntensity(
        statistics.image(),
        statistics.standard_error(),
        statistics.count,
        np.array(curve, np.float64).reshape(-1, 2),
        "monte-carlo",
        grid,
    )


def _due(count: int) -> bool:
    """Whether the error is taken after so many snapshots: of each doubling, eight times."""
    return count >= 2 and count % (1 << max(0, count.bit_length() - 4)) == 0


def _reached(curve: list[tuple[int, float]], count: int, rtol: float | None) -> bool:
    """Whether the last error taken, of exactly so many snapshots, is small enough."""
    if rtol is None or not curve or count < LEAST:
        return False
    return curve[-1][0] == count and curve[-1][1] <= rtol


def _require_light(curve: list[tuple[int, float]], how: Averaging) -> None:
    """Refuse a tolerance of what is dark: it would never be met."""
    count, error = curve[-1]
    if how.rtol is not None and count >= LEAST and math.isnan(error):
        where = "image" if how.region is None else "region"
        raise ValueError(
            f"There is no light in the {where} after {count} snapshots, so that rtol={how.rtol:g} "
            "has no meaning there: choose another region, or snapshots=."
        )


def _keep(
    path: PathLike, statistics: Statistics, curve: list[tuple[int, float]], setup: dict[str, str]
) -> None:
    """Write a checkpoint, whole or not at all."""
    device = statistics.device
    heading = {"format": FORMAT, "count": statistics.count, "unit": statistics.unit, "setup": setup}
    members: dict[str, Any] = {
        "heading": json.dumps(heading),
        "mean": device.download(statistics.mean),
        "m2": device.download(statistics.m2),
        "convergence": np.array(curve, np.float64).reshape(-1, 2),
    }
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **members)
        file.flush()
        os.fsync(file.fileno())
