"""float64 twins of imaging in light of any coherence: pupil, target, Abbe sum, OTF, edges.

Nothing here imports the package under test. Arrays [y, x] on square periodic windows of n samples
of pitch d, spectra in FFT order, frequencies in cycles a sample unless said; the imaging system
is a hard circle |f| <= fc in frequency, magnification 1.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from reference_optics import Real


def three_bar_target(n: int = 256) -> Real:
    """Bright bars on 0: five elements of three horizontal bars over three vertical ones.

    Bars b by 5b samples, b = 8, 5, 3, 2, 1 from left to right, gap b; the horizontal ones start at
    row .10 n, the vertical ones 2b below them, the first element at column .06 n, the next 7b on.
    """
    target, column = np.zeros((n, n)), round(0.06 * n)
    for b in (8, 5, 3, 2, 1):
        top = round(0.10 * n)
        for k in (0, 2 * b, 4 * b):
            target[top + k : top + k + b, column : column + 5 * b] = 1
            target[top + 7 * b : top + 12 * b, column + k : column + k + b] = 1
        column += 7 * b
    return target


def pupil(n: int, cutoff: float) -> Real:
    """1 where fx^2 + fy^2 <= cutoff^2 (cycles a sample), FFT order, shape (n, n)."""
    f = scipy.fft.fftfreq(n)
    return (f[:, None] ** 2 + f[None, :] ** 2 <= cutoff**2 * (1 + 1e-12)).astype(float)


def otf(n: int, cutoff: float) -> Real:
    """Autocorrelation of the sampled pupil over its area, FFT order; cutoff <= 1/4."""
    spread = np.abs(scipy.fft.ifft2(pupil(n, cutoff))) ** 2
    transfer = scipy.fft.fft2(spread).real
    return transfer / transfer[0, 0]


def incoherent_image(intensity: Real, cutoff: float) -> Real:
    """Image of an object that shines by itself: its intensity times the OTF, clear field 1."""
    return scipy.fft.ifft2(scipy.fft.fft2(intensity) * otf(len(intensity), cutoff)).real
