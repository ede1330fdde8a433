"""How results are compared with a reference, and how far they may differ.

Every comparison first refuses NaN and infinity, another shape and another kind of number, so that
no broken result passes as close.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


def fft_tolerance(n: int | Sequence[int], dtype: DTypeLike, *, bluestein: bool = False) -> float:
    """Largest error of an FFT divided by the largest value of the result.

    The rounding error of an FFT grows with log N (Gentleman & Sande 1966; rms, Schatzman 1996).
    The constants are those of pyvkfft's accuracy tests (Favre-Nicolin, pyvkfft/accuracy.py):
    2e-6 + 5e-7 log10 N in single and 5e-15 + 5e-16 log10 N in double precision. The sum is the
    bound used there on max|error|/max|reference| for random data, for all sizes and devices it
    covers: 17 + 4 log10 N and 23 + 2.3 log10 N units of round-off (eps = 1.2e-7 and 2.2e-16).

    Parameters
    ----------
    n : int or sequence of int
        Length of the transform, or the lengths of its axes; N is their product.
    dtype : dtype-like
        float32, complex64, float64 or complex128.
    bluestein : bool
        True where the length is done by a convolution (Bluestein): three transforms in place of
        one double the error. Lengths with a prime factor above 13 are always taken so.

    Returns
    -------
    float
        The tolerance.
    """
    lengths = [n] if isinstance(n, int) else list(n)
    if any(m < 1 for m in lengths):
        raise ValueError(f"lengths {lengths} must be at least 1")
    base = {"f": (2e-6, 5e-7), "d": (5e-15, 5e-16)}
    first, slope = base[np.dtype(dtype).char.lower()]
    tolerance = first + slope * math.log10(math.prod(lengths))
    hard = bluestein or any(largest_prime_factor(m) > 13 for m in lengths)
    return 2 * tolerance if hard else tolerance


def largest_prime_factor(n: int) -> int:
    """Largest prime factor of n >= 1 (1 for 1)."""
    largest, p = 1, 2
    while p * p <= n:
        while n % p == 0:
            largest, n = p, n // p
        p += 1
    return max(largest, n)


def comparable(reference: ArrayLike, got: ArrayLike) -> tuple[NDArray, NDArray]:
    """Both arrays in double precision, after the checks that every comparison makes."""
    f, g = np.asarray(reference), np.asarray(got)
    if f.shape != g.shape:
        raise AssertionError(f"shape {g.shape} is not that of the reference, {f.shape}")
    if f.dtype.kind != g.dtype.kind or f.dtype.kind not in "fc":
        raise AssertionError(f"dtype {g.dtype} does not compare with reference {f.dtype}")
    for name, a in (("reference", f), ("result", g)):
        bad = np.count_nonzero(~np.isfinite(a))
        if bad:
            raise AssertionError(f"the {name} holds {bad} values that are not finite")
    wide = np.complex128 if f.dtype.kind == "c" else np.float64
    f, g = f.astype(wide), g.astype(wide)
    if not np.any(f):
        raise AssertionError("the reference is empty or zero throughout: nothing to compare with")
    return f, g


def relative_max(reference: ArrayLike, got: ArrayLike) -> float:
    """max|got - reference| / max|reference|."""
    f, g = comparable(reference, got)
    return float(np.max(np.abs(g - f)) / np.max(np.abs(f)))


def err_db(reference: ArrayLike, got: ArrayLike) -> float:
    """-20 log10(||got - reference|| / ||reference||), nothing fitted; inf when they are equal."""
    f, g = comparable(reference, got)
    return decibel(np.sum(np.abs(f) ** 2), np.sum(np.abs(g - f) ** 2))


def snr_db(reference: ArrayLike, got: ArrayLike) -> float:
    """10 log10(sum|f|^2 / sum|f - a g|^2) with the best a = <g,f>/<g,g>.

    Blind to one complex constant (Matsushima & Shimobaba 2009).
    """
    f, g = comparable(reference, got)
    power = np.vdot(g, g).real
    a = np.vdot(g, f) / power if power else 0.0
    return decibel(np.sum(np.abs(f) ** 2), np.sum(np.abs(f - a * g) ** 2))


def decibel(signal: float, noise: float) -> float:
    """10 log10(signal/noise), inf without noise."""
    return math.inf if noise == 0 else 10 * math.log10(signal / noise)
