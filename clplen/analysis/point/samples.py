"""Validation and interpolation of sampled pictures on the host."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.checks import host_array
from clplen.errors import ShapeError

Values = np.ndarray[Any, np.dtype[np.float64]]
Pair = tuple[float, float]


def checked(values: Any, label: str, *, min_samples: int = 1) -> Values:
    """Convert a real picture to float64; raise for NaN or too few samples a side."""
    if np.iscomplexobj(values):
        raise ValueError(f"{label} must be a real intensity; take abs(amplitude)**2 first.")
    picture = np.array(host_array(values, label), np.float64)
    if picture.ndim != 2 or min(picture.shape) < min_samples:
        raise ShapeError(
            f"{label} must have shape (ny, nx) of at least {min_samples} samples a side, got "
            f"{picture.shape}."
        )
    bad = picture.size - np.count_nonzero(np.isfinite(picture))
    if bad:
        raise ValueError(f"{label} has {bad} samples that are NaN or infinite: replace them first.")
    return picture


def check_axis(axis: int) -> int:
    """Return the axis as int; raise ValueError unless it is 0 (y) or 1 (x)."""
    if axis not in (0, 1):
        raise ValueError(f"axis must be 0 (y) or 1 (x), got {axis!r}.")
    return int(axis)


def dirichlet(offset: Any, n: int) -> Values:
    """Compute the weight of one of n samples at an offset, in their Fourier interpolation.

    sin(pi t)/(n sin(pi t/n)) for odd n, sin(pi t)/(n tan(pi t/n)) for even n, with the highest
    frequency split between both signs.
    """
    t = np.asarray(offset, np.float64)
    t = t - n * np.round(t / n)
    is_sample = np.abs(t) < 1e-9
    safe = np.where(is_sample, 0.5, t)
    denominator = np.sin(np.pi * safe / n) if n % 2 else np.tan(np.pi * safe / n)
    return np.where(is_sample, 1.0, np.sin(np.pi * safe) / (n * denominator))


def interpolated_picture(values: Any, rows: Any, columns: Any) -> Any:
    """Interpolate a picture at fractional indices in Fourier space."""
    ny, nx = values.shape
    across = dirichlet(np.subtract.outer(np.asarray(rows, np.float64), np.arange(ny)), ny)
    along = dirichlet(np.subtract.outer(np.asarray(columns, np.float64), np.arange(nx)), nx)
    return across @ values @ along.T


def line_of(values: Any, axis: int, index: float) -> Any:
    """Return the line of a picture along an axis, at a fractional index of the other axis."""
    n = values.shape[1 - axis]
    weight = dirichlet(index - np.arange(n), n)
    return weight @ values if axis == 1 else values @ weight


def interpolated_line(line: Any, factor: int) -> Any:
    """Interpolate a line by a factor in Fourier space."""
    from scipy.signal import resample

    n = len(line)
    return resample(line, n * factor)[: (n - 1) * factor + 1]


def first_fall(x: Values, y: Values, level: float) -> float:
    """Return x where y first falls below a level, interpolated linearly.

    NaN if y never falls below it, or starts below it.
    """
    below = np.flatnonzero(y < level)
    if not below.size or below[0] == 0:
        return float("nan")
    k = int(below[0])
    fraction = (y[k - 1] - level) / (y[k - 1] - y[k])
    return float(x[k - 1] + fraction * (x[k] - x[k - 1]))
