"""Slow, simple float64 twins of the grid and the propagators.

Nothing here imports the package under test. Conventions: time factor exp(-i omega t), arrays
[..., y, x], SI metres, sample i of an axis at (i - n//2) d + origin, spectra in FFT order, the
carrier exp(ikz) dropped.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Pair = float | Sequence[float]


def pair(value: Pair) -> tuple[float, float]:
    """Return (y, x) from one number for both axes or from a pair."""
    y, x = np.broadcast_to(np.asarray(value, dtype=float), 2)
    return float(y), float(x)


def axis(n: int, d: float, origin: float = 0.0) -> Real:
    """Coordinates (i - n//2) d + origin of the n samples of an axis, for even and odd n."""
    return (np.arange(n) - n // 2).astype(np.float64) * d + origin


def radius_squared(shape: Sequence[int], pitch: Pair, origin: Pair = 0.0) -> Real:
    """Squared distance of every sample centre from the axis, shape (ny, nx)."""
    (dy, dx), (oy, ox) = pair(pitch), pair(origin)
    y, x = axis(shape[0], dy, oy), axis(shape[1], dx, ox)
    return y[:, None] ** 2 + x[None, :] ** 2


def transfer_function(
    shape: Sequence[int], pitch: Pair, z: float, wavelength: float, *, band: str | None = None
) -> Complex:
    """Angular spectrum transfer function in FFT order, carrier exp(ikz) dropped.

    With s = lam^2 (fx^2 + fy^2): exp(ikz (sqrt(1-s) - 1)) for s <= 1 and, for s > 1,
    exp(-kz sqrt(s-1)) exp(-ikz) when z >= 0 and 0 when z < 0 (Goodman, Introduction to Fourier
    Optics, eq. 3-74). band="blas" cuts to |f| < 1/(lam sqrt((2 z/W)^2 + 1)) on each axis, W the
    window (Matsushima & Shimobaba 2009, eq. 13); an axis of length 1 has frequency 0 only.
    """
    if band not in (None, "blas"):
        raise ValueError(f"band {band!r} is unknown: None or 'blas'")
    if z == 0:
        return np.ones(tuple(shape), dtype=np.complex128)
    (dy, dx), turns = pair(pitch), z / wavelength
    fy, fx = np.fft.fftfreq(shape[0], dy), np.fft.fftfreq(shape[1], dx)
    s = (wavelength * fy[:, None]) ** 2 + (wavelength * fx[None, :]) ** 2
    waves = s <= 1
    h = np.zeros(s.shape, dtype=np.complex128)
    inside = s[waves]
    h[waves] = np.exp(-2j * np.pi * turns * (inside / (1 + np.sqrt(1 - inside))))
    if z > 0 and not waves.all():
        dropped = np.exp(-2j * np.pi * (turns % 1.0))
        h[~waves] = dropped * np.exp(-2 * np.pi * turns * np.sqrt(s[~waves] - 1))
    if band == "blas":
        h[np.abs(fy) >= blas_limit(shape[0] * dy, z, wavelength), :] = 0
        h[:, np.abs(fx) >= blas_limit(shape[1] * dx, z, wavelength)] = 0
    return h


def blas_limit(window: float, z: float, wavelength: float) -> float:
    """Highest frequency whose transfer function the window samples (Matsushima 2009, eq. 13)."""
    return 1 / (wavelength * np.sqrt((2 * z / window) ** 2 + 1))


def smooth_length(n: int) -> int:
    """Smallest length >= n without prime factors above 7."""
    rest = length = max(int(n), 1)
    while True:
        for p in (2, 3, 5, 7):
            while rest % p == 0:
                rest //= p
        if rest == 1:
            return length
        length += 1
        rest = length


def padded_length(n: int, pad: float) -> int:
    """Length of a padded axis: n for n=1, else round(pad n)."""
    return n if n == 1 else round(pad * n)


def centred_slice(small: int, large: int) -> slice:
    """Where n samples lie in a longer axis when sample n//2 is kept on sample large//2."""
    start = large // 2 - small // 2
    return slice(start, start + small)


def propagate(
    u: Complex,
    pitch: Pair,
    z: float,
    wavelength: float,
    *,
    method: str = "as",
    pad: float = 2,
    workers: int = 1,
) -> Complex:
    """Propagate u (..., ny, nx) by z with the angular spectrum ("as") or band-limited ("blas")."""
    bands = {"as": None, "blas": "blas"}
    if method not in bands:
        raise ValueError(f"method {method!r} is unknown: 'as' or 'blas'")
    if z == 0:
        return np.array(u, dtype=np.complex128)
    ny, nx = u.shape[-2:]
    shape = padded_length(ny, pad), padded_length(nx, pad)
    part = (..., centred_slice(ny, shape[0]), centred_slice(nx, shape[1]))
    window = np.zeros((*u.shape[:-2], *shape), dtype=np.complex128)
    window[part] = u
    spectrum = scipy.fft.fft2(window, overwrite_x=True, workers=workers)
    spectrum *= transfer_function(shape, pitch, z, wavelength, band=bands[method])
    return scipy.fft.ifft2(spectrum, overwrite_x=True, workers=workers)[part]
