"""Averages of snapshots: when they stop, and the checkpoints from which they go on."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import is_finite
from clplen.compute.device import Device
from clplen.errors import FormatError, SamplingWarning, warn_caller
from clplen.files import PathLike, check_writable, replacing
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import MeanIntensity, Region, Statistics, Window

FORMAT = "clplen average 1"
SetUp = Mapping[str, str]
SHOWN = 160  # characters of a long text in a message


@dataclass(frozen=True, eq=False)
class State:
    """How far an average has come.

    Attributes
    ----------
    mean, m2 : numpy.ndarray
        As in `Statistics`.
    count : int
    unit : float
    convergence : numpy.ndarray
        float64, shape (n, 2): snapshots, standard error over mean.
    """

    mean: np.ndarray[Any, Any]
    m2: np.ndarray[Any, Any]
    count: int
    unit: float
    convergence: np.ndarray[Any, Any]


def fingerprint(value: Any) -> str:
    """What decides a result, as text that is the same in every process.

    Of arrays a digest, of data classes and other objects their fields, of a function its module and
    name, its defaults and what it encloses.
    """
    if isinstance(value, bool | np.bool_ | str | bytes | None):
        return repr(value)
    if isinstance(value, int | float | complex | np.number):
        return repr(value.item() if isinstance(value, np.number) else value)
    if isinstance(value, np.ndarray | cla.Array):
        values = np.ascontiguousarray(value.get() if isinstance(value, cla.Array) else value)
        digest = hashlib.sha256(values.tobytes()).hexdigest()[:16]
        return f"array({values.shape}, {values.dtype}, {digest})"
    if isinstance(value, list | tuple):
        return f"({', '.join(fingerprint(one) for one in value)})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {fingerprint(one)}' for key, one in value.items())}}}"
    if isinstance(value, partial | MethodType | FunctionType):
        return _of_function(value)
    if isinstance(value, Device):
        return f"{value.name}, {value.driver}, {value.precision}"
    named = [pair for pair in getattr(value, "__dict__", {}).items() if pair[0][0] != "_"]
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        named = [(name, getattr(value, name, None)) for name in names]
    parts = [f"{name}={fingerprint(one)}" for name, one in named]
    name = value.__qualname__ if isinstance(value, type) else type(value).__qualname__
    return f"{name}({', '.join(parts)})"


def _of_function(value: partial[Any] | MethodType | FunctionType) -> str:
    if isinstance(value, partial):
        return f"{fingerprint(value.func)}({fingerprint((value.args, value.keywords))})"
    if isinstance(value, MethodType):
        return f"{fingerprint(value.__self__)}.{value.__name__}"
    cells = [cell.cell_contents for cell in value.__closure__ or ()]
    inside = fingerprint((value.__defaults__, value.__kwdefaults__, cells))
    code = hashlib.sha256(value.__code__.co_code + repr(_constants(value)).encode())
    return f"{value.__module__}.{value.__qualname__}({code.hexdigest()[:8]}, {inside})"


def _constants(function: FunctionType) -> list[Any]:
    """Plain constants of a function's code: numbers and words, not code objects."""
    plain = (bool, int, float, complex, str, bytes, type(None))
    return [one for one in function.__code__.co_consts if isinstance(one, plain)]


def save(path: PathLike, state: State, setup: SetUp) -> None:
    """Write a checkpoint, whole or not at all."""
    heading = {"format": FORMAT, "count": state.count, "unit": state.unit, "setup": dict(setup)}
    text = json.dumps(heading)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            heading=np.array(text),
            mean=state.mean,
            m2=state.m2,
            convergence=state.convergence,
            digest=np.array(_digest(text, state)),
        )
        file.flush()
        os.fsync(file.fileno())


def load(path: PathLike, setup: SetUp) -> State | None:
    """Read a checkpoint of this set-up; None where there is no file."""
    target = check_writable(path)
    if not target.exists():
        return None
    state, stored = _read(target)
    for name in dict.fromkeys([*setup, *stored]):
        then, now = stored.get(name, "nothing"), setup.get(name, "nothing")
        if then != now:
            raise FormatError(
                f"The checkpoint {target} is of another set-up: its {name} is "
                f"{_around(then, now)}, this run's is {_around(now, then)}. Name another file, or "
                "remove this one to start anew."
            )
    return state


def verify(path: PathLike) -> None:
    """Refuse a file that cannot be written or is there and is no whole checkpoint."""
    target = check_writable(path)
    if target.exists():
        _read(target)


def _around(text: str, other: str) -> str:
    """A text, or what is next to its first difference from another."""
    if len(text) <= SHOWN:
        return text
    pairs = zip(text, other, strict=False)
    first = next((i for i, (a, b) in enumerate(pairs) if a != b), min(len(text), len(other)))
    start = max(0, first - SHOWN // 2)
    return f"... {text[start : start + SHOWN]} ..."


def _read(target: Path) -> tuple[State, dict[str, str]]:
    try:
        with target.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            text = str(file["heading"])
            heading = json.loads(text)
            state = State(
                file["mean"],
                file["m2"],
                int(heading["count"]),
                float(heading["unit"]),
                file["convergence"],
            )
            intact = str(file["digest"]) == _digest(text, state)
            known, stored = heading["format"] == FORMAT, dict(heading["setup"])
    except Exception as error:  # whatever a broken archive makes its readers say
        raise FormatError(f"{_damaged(target)}.") from error
    if not (intact and known):
        raise FormatError(_damaged(target) + ": its contents and their digest disagree")
    return state, stored


def _damaged(target: Path) -> str:
    return (
        f"The checkpoint {target} is damaged or no checkpoint; remove it to start anew, or name "
        "another file"
    )


def _digest(text: str, state: State) -> str:
    sha = hashlib.sha256(text.encode())
    for values in (state.mean, state.m2, state.convergence):
        sha.update(f"{values.shape}{values.dtype.str}".encode())
        sha.update(np.ascontiguousarray(values).tobytes())
    return sha.hexdigest()


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
    checkpoint: PathLike | None = None
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
    setup: SetUp,
) -> MeanIntensity:
    """Add snapshots until enough are there."""
    window = Window.of(how.region, grid.shape)
    setup = {**setup, "region": str(window)}
    statistics = Statistics(grid.shape, device)
    curve: list[tuple[int, float]] = []
    if how.checkpoint is not None and (state := load(how.checkpoint, setup)) is not None:
        statistics.restore(state.mean, state.m2, state.count, state.unit)
        curve = [(int(k), float(error)) for k, error in state.convergence]
    saved = time.monotonic()
    while statistics.count < how.most and not _reached(curve, statistics.count, how.rtol):
        statistics.add(snapshot(statistics.count))
        if _due(statistics.count):
            curve.append((statistics.count, statistics.relative_error(window)))
            _require_light(curve, how)
        if how.progress is not None:
            how.progress(statistics.count, how.most)
        if how.checkpoint is not None and time.monotonic() - saved > SAVE_SECONDS:
            _keep(how.checkpoint, statistics, curve, setup)
            saved = time.monotonic()
    if how.checkpoint is not None:
        _keep(how.checkpoint, statistics, curve, setup)
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
    path: PathLike, statistics: Statistics, curve: list[tuple[int, float]], setup: SetUp
) -> None:
    device = statistics.device
    mean, m2 = device.download(statistics.mean), device.download(statistics.m2)
    points = np.array(curve, np.float64).reshape(-1, 2)
    save(path, State(mean, m2, statistics.count, statistics.unit, points), setup)
