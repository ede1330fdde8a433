"""Averages of snapshots: stopping rules, and checkpoints for interrupted runs."""

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
Checkpoint = PathLike | tuple[PathLike, str]  # a file, or a file and a label of its run
Arrays = dict[str, np.ndarray[Any, Any]]


def file_and_label(checkpoint: Checkpoint) -> tuple[PathLike, str]:
    """Return the file of a checkpoint and its label."""
    return checkpoint if isinstance(checkpoint, tuple) else (checkpoint, "")


def verify(path: PathLike) -> None:
    """Raise if a file is not writable, or exists and is not a complete checkpoint."""
    target = check_writable(path)
    if target.exists():
        _read(target)


def _load(path: PathLike, setup: dict[str, str]) -> tuple[dict[str, Any], Arrays] | None:
    """Return a checkpoint of this configuration, or None if the file does not exist."""
    target = check_writable(path)
    if not target.exists():
        return None
    heading, arrays = _read(target)
    for name, current in setup.items():
        stored = heading["setup"].get(name)
        if stored != current:
            raise FormatError(
                f"The checkpoint {target} belongs to another configuration: its {name} is "
                f"{stored}, this run's is {current}. Choose another file, or remove this file to "
                "start again."
            )
    return heading, arrays


def _read(target: Path) -> tuple[dict[str, Any], Arrays]:
    try:  # the archive has a checksum of each member
        with target.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            heading = json.loads(str(file["heading"]))
            arrays = {name: file[name] for name in ("mean", "m2", "convergence")}
            if heading["format"] != FORMAT:
                raise ValueError(heading["format"])
    except Exception as error:  # damaged archives cause errors of many types
        raise FormatError(
            f"{target} is damaged or not a checkpoint; remove it to start again, or choose another "
            "file."
        ) from error
    return heading, arrays


Progress = Callable[[int, int], None]

DEFAULT_SNAPSHOTS = 100  # number without snapshots= and rtol=
MAX_RTOL_SNAPSHOTS = 100_000  # maximum number with rtol= alone
MAX_SNAPSHOTS = 10**9  # several days even for tiny fields
MIN_RTOL_SNAPSHOTS = 16  # minimum before rtol= stops; k snapshots give the error to 1/sqrt(2 k)
SAVE_SECONDS = 5.0  # minimum time between checkpoints


@dataclass(frozen=True)
class Averaging:
    """Settings of an average of snapshots: when it stops, checkpoints and progress."""

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
            and 1 <= number <= MAX_SNAPSHOTS
        ):
            raise ValueError(
                f"snapshots must be an integer from 1 to {MAX_SNAPSHOTS:.0e}, got {number!r}."
            )
        if self.rtol is not None and not (is_finite(self.rtol) and self.rtol > 0):
            raise ValueError(f"rtol must be positive, got {self.rtol!r}.")

    @property
    def limit(self) -> int:
        """Maximum number of snapshots."""
        if self.snapshots is not None:
            return int(self.snapshots)
        return DEFAULT_SNAPSHOTS if self.rtol is None else MAX_RTOL_SNAPSHOTS


def average(
    snapshot: Callable[[int], Field | cla.Array],
    grid: Grid,
    device: Device,
    settings: Averaging,
    setup: dict[str, str],
) -> MeanIntensity:
    """Add snapshots until the average reaches its tolerance or number."""
    window = Window.of(settings.region, grid.shape)
    statistics = Statistics(grid.shape, device)
    curve: list[tuple[int, float]] = []
    path = None
    if settings.checkpoint is not None:
        path, label = file_and_label(settings.checkpoint)
        setup = {"label": label or "empty", **setup, "region": str(window)}
        if (stored := _load(path, setup)) is not None:
            heading, arrays = stored
            statistics.restore(arrays["mean"], arrays["m2"], heading["count"], heading["unit"])
            curve = [(int(k), float(error)) for k, error in arrays["convergence"]]
    saved = time.monotonic()
    while statistics.count < settings.limit and not _reached(
        curve, statistics.count, settings.rtol
    ):
        statistics.add(snapshot(statistics.count))
        if _due(statistics.count):
            curve.append((statistics.count, statistics.relative_error(window)))
            _require_light(curve, settings)
        if settings.progress is not None:
            settings.progress(statistics.count, settings.limit)
        if path is not None and time.monotonic() - saved > SAVE_SECONDS:
            _save(path, statistics, curve, setup)
            saved = time.monotonic()
    if path is not None:
        _save(path, statistics, curve, setup)
    if not _due(statistics.count):
        curve.append((statistics.count, statistics.relative_error(window)))
    if settings.rtol is not None and not curve[-1][1] <= settings.rtol:
        warn_caller(
            f"After {statistics.count} snapshots the standard error is {curve[-1][1]:.3g} of the "
            f"mean, above rtol={settings.rtol:g}; increase snapshots.",
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
    """Return True if the error is computed after this number of snapshots, 8 times per doubling."""
    return count >= 2 and count % (1 << max(0, count.bit_length() - 4)) == 0


def _reached(curve: list[tuple[int, float]], count: int, rtol: float | None) -> bool:
    """Return True if the latest error, after exactly ``count`` snapshots, is small enough."""
    if rtol is None or not curve or count < MIN_RTOL_SNAPSHOTS:
        return False
    return curve[-1][0] == count and curve[-1][1] <= rtol


def _require_light(curve: list[tuple[int, float]], settings: Averaging) -> None:
    """Raise if the region is dark, where a tolerance has no meaning."""
    count, error = curve[-1]
    if settings.rtol is not None and count >= MIN_RTOL_SNAPSHOTS and math.isnan(error):
        where = "image" if settings.region is None else "region"
        raise ValueError(
            f"The {where} is dark after {count} snapshots, so that rtol={settings.rtol:g} cannot "
            "be reached; choose another region, or set snapshots= instead."
        )


def _save(
    path: PathLike, statistics: Statistics, curve: list[tuple[int, float]], setup: dict[str, str]
) -> None:
    """Write a checkpoint atomically."""
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
