"""Comparison of a device's results with their float64 references."""

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
    """Comparison of one family of kernels, or of another capability of a device, with NumPy."""

    name: str
    compared: str
    pairs: Callable[[Device], Pairs]  # yields (expected, computed), of equal shapes
    tolerance: float  # limit of max|computed - expected| / max|expected| of any pair
    files: tuple[str, ...] = ()  # kernels whose results are compared
    absent: Callable[[Device], str] = lambda device: ""  # reason to skip, or ""


@dataclass(frozen=True)
class CheckResult:
    """Result of one check on one device."""

    name: str
    compared: str
    files: tuple[str, ...]
    error: float  # largest relative error; NaN where nothing was compared
    tolerance: float
    status: Status
    reason: str  # reason of a failure or a skip
    seconds: float

    @property
    def failed(self) -> bool:
        """Flag of wrong results or of an error."""
        return self.status == "FAILED"


class WrongResultError(ClplenError):
    """Result that cannot be compared with its reference."""


def run_check(check: Check, device: Device) -> CheckResult:
    """Run one check; any exception becomes its result."""
    start, error, reason = perf_counter(), math.nan, ""
    status: Status = "left out"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # small cases are sampled coarsely on purpose
            reason = check.absent(device)
            if not reason:
                error = largest_error(check.pairs(device))
                status = "ok" if error <= check.tolerance else "FAILED"
    except Exception as problem:  # any kind: the other checks must run
        status, reason = "FAILED", sentence_of(problem)
    if status == "FAILED" and not reason:
        reason = "wrong values"
    seconds = perf_counter() - start
    return CheckResult(
        check.name, check.compared, check.files, error, check.tolerance, status, reason, seconds
    )


def largest_error(pairs: Pairs) -> float:
    """Return the largest max|computed - expected| / max|expected| of some pairs."""
    worst = -math.inf
    for expected, computed in pairs:
        reference, values = np.asarray(expected), np.asarray(computed)
        if reference.shape != values.shape:
            raise WrongResultError(f"a result of shape {values.shape} instead of {reference.shape}")
        bad = int(np.count_nonzero(~np.isfinite(values)))
        if bad:
            raise WrongResultError(f"{bad} of {values.size} values are NaN or infinite")
        wide = np.complex128 if np.iscomplexobj(reference) else np.float64
        scale = float(np.abs(reference).max())
        worst = max(worst, float(np.abs(values.astype(wide) - reference).max()) / (scale or 1.0))
    if worst < 0:
        raise WrongResultError("nothing was compared")
    return worst


def sentence_of(error: Exception) -> str:
    """Return the first line of an error, prefixed by its type unless it is clplen's own.

    A kernel that does not build adds the first error line of the compiler.
    """
    lines = str(error.args[0] if error.args else error).strip().splitlines()
    first = next((line.strip() for line in lines if line.strip()), "")
    if isinstance(error, KernelBuildError):
        details = [line.strip() for line in error.log.splitlines() if "error:" in line.lower()]
        return " ".join([first, *details[:1]])
    if isinstance(error, ClplenError) and first:
        return first
    return f"{type(error).__name__}: {first}" if first else type(error).__name__
