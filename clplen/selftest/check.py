"""One check: a device's results beside their float64 twins."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Literal

import numpy as np

from clplen.compute.device import Device
from clplen.errors import ClplenError, KernelBuildError

Pairs = Iterable[tuple[Any, Any]]
Status = Literal["ok", "FAILED", "left out"]

EPS = 2.0**-23  # spacing of float32 at 1


@dataclass(frozen=True)
class Check:
    """Comparison of one family of kernels, or another ability of a device, with NumPy."""

    name: str
    compared: str
    pairs: Callable[[Device], Pairs]  # yields (expected, found), arrays of one shape
    tolerance: float  # largest max|found - expected| / max|expected| of any pair
    files: tuple[str, ...] = ()  # kernels whose results are compared
    absent: Callable[[Device], str] = lambda device: ""  # why a device lacks the ability, else ""


@dataclass(frozen=True)
class CheckResult:
    """Result of one check on one device."""

    name: str
    compared: str
    files: tuple[str, ...]
    error: float  # the largest relative error; NaN where nothing could be compared
    tolerance: float
    status: Status
    reason: str  # why it failed or was left out
    seconds: float

    @property
    def failed(self) -> bool:
        """Whether the device is wrong or could not do it."""
        return self.status == "FAILED"


class WrongResultError(ClplenError):
    """A result that cannot be compared with what is expected."""


def run_check(check: Check, device: Device) -> CheckResult:
    """Run one check; whatever goes wrong becomes its result."""
    start, error, reason = perf_counter(), math.nan, ""
    status: Status = "left out"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # small cases are sampled coarsely on purpose
            reason = check.absent(device)
            if not reason:
                error = largest_error(check.pairs(device))
                status = "ok" if error <= check.tolerance else "FAILED"
    except Exception as problem:  # of any kind: the other checks must run
        status, reason = "FAILED", sentence_of(problem)
    if status == "FAILED" and not reason:
        reason = "wrong values"
    seconds = perf_counter() - start
    return CheckResult(
        check.name, check.compared, check.files, error, check.tolerance, status, reason, seconds
    )


def largest_error(pairs: Pairs) -> float:
    """The largest max|found - expected| / max|expected| of some pairs."""
    worst = -math.inf
    for expected, found in pairs:
        want, got = np.asarray(expected), np.asarray(found)
        if want.shape != got.shape:
            raise WrongResultError(f"a result of shape {got.shape} instead of {want.shape}")
        bad = int(np.count_nonzero(~np.isfinite(got)))
        if bad:
            raise WrongResultError(f"{bad} of {got.size} values are NaN or infinite")
        wide = np.complex128 if np.iscomplexobj(want) else np.float64
        scale = float(np.abs(want).max())
        worst = max(worst, float(np.abs(got.astype(wide) - want).max()) / (scale or 1.0))
    if worst < 0:
        raise WrongResultError("nothing was compared")
    return worst


def sentence_of(error: Exception) -> str:
    """The first line of an error, with its kind where that is not clplen's own.

    With a line of the compiler's where a kernel does not build.
    """
    lines = str(error.args[0] if error.args else error).strip().splitlines()
    first = next((line.strip() for line in lines if line.strip()), "")
    if isinstance(error, KernelBuildError):
        said = [line.strip() for line in error.log.splitlines() if "error:" in line.lower()]
        return " ".join([first, *said[:1]])
    if isinstance(error, ClplenError) and first:
        return first
    return f"{type(error).__name__}: {first}" if first else type(error).__name__
