"""Sampled pictures on the host: checked, and read between their samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.checks import host_array
from clplen.errors import ShapeError

Values = np.ndarray[Any, np.dtype[np.float64]]
Pair = tuple[float, float]


def checked(values: Any, what: str, *, least: int = 1) -> Values:
    """A real picture as float64, finite and of at least so many samples a side."""
    if np.iscomplexobj(values):
        raise ValueError(f"{what} is real, an intensity; take abs(amplitude)**2 first.")
    picture = np.array(host_array(values, what), np.float64)
    if picture.ndim != 2 or min(picture.shape) < least:
        raise ShapeError(
            f"{what} has shape (ny, nx) of at least {least} samples a side, not {picture.shape}."
        )
    bad = picture.size - np.count_nonzero(np.isfinite(picture))
    if bad:
        raise ValueError(f"{what} has {bad} samples that are NaN or infinite: replace them first.")
    return picture


def check_axis(axis: int) -> int:
    """0 for y or 1 for x."""
    if axis not in (0, 1):
        raise ValueError(f"axis is 0 for y or 1 for x, not {axis!r}.")
    return int(axis)


def dirichlet(offset: Any, n: int) -> Values:
    """Weight, at so many samples from it, of one of n samples in their Fourier interpolation.

    sin(pi t)/(n sin(pi t/n)) for odd n, sin(pi t)/(n tan(pi t/n)) for even n, where the highest
    frequency is shared between both signs.
    """
    t = np.asarray(offset, np.float64)
    t = t - n * np.round(t / n)
    is_sample = np.abs(t) < 1e-9
    safe = np.where(is_sample, 0.5, t)
    below = np.sin(np.pi * safe / n) if n % 2 else np.tan(np.pi * safe / n)
    return np.where(is_sample, 1.0, np.sin(np.pi * safe) / (n * below))


def between(values: Any, rows: Any, columns: Any) -> Any:
    """A picture at fractional indices, by Fourier interpolation."""
    ny, nx = values.shape
    across = dirichlet(np.subtract.outer(np.asarray(rows, np.float64), np.arange(ny)), ny)
    along = dirichlet(np.subtract.outer(np.asarray(columns, np.float64), np.arange(nx)), nx)
    return across @ values @ along.T


def line_of(values: Any, axis: int, index: float) -> Any:
    """The line of a picture along an axis, at a fractional index of the other one."""
    n = values.shape[1 - axis]
    weight = dirichlet(index - np.arange(n), n)
    return weight @ values if axis == 1 else values @ weight


def finer(line: Any, factor: int) -> Any:
    """A line with ``factor`` samples in the place of one, by Fourier interpolation."""
    from scipy.signal import resample

    n = len(line)
    return resample(line, n * factor)[: (n - 1) * factor + 1]


def first_fall(x: Values, y: Values, level: float) -> float:
    """Where y first falls below a level, between samples by a straight line; NaN if nowhere.

    NaN as well where the first sample lies below it already.
    """
    below = np.flatnonzero(y < level)
    if not below.size or below[0] == 0:
        return float("nan")
    k = int(below[0])
    part = (y[k - 1] - level) / (y[k - 1] - y[k])
    return float(x[k - 1] + part * (x[k] - x[k - 1]))
