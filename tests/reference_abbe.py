"""float64 twins of imaging in light of any coherence: pupil, target, Abbe sum, OTF, edges.

Nothing here imports the package under test. Arrays [y, x] on square periodic windows of n samples
of pitch d, spectra in FFT order, frequencies in cycles a sample unless said; the imaging system
is a hard circle |f| <= fc in frequency, magnification 1.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike
from reference_optics import Complex, Real
from scipy.integrate import quad
from scipy.special import sici


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


def coherent_image(field: Complex, cutoff: float) -> Real:
    """Intensity of the field behind the pupil: |IFFT{P FFT u}|^2, periodic."""
    return np.abs(scipy.fft.ifft2(scipy.fft.fft2(field) * pupil(len(field), cutoff))) ** 2


def otf(n: int, cutoff: float) -> Real:
    """Autocorrelation of the sampled pupil over its area, FFT order; cutoff <= 1/4."""
    spread = np.abs(scipy.fft.ifft2(pupil(n, cutoff))) ** 2
    transfer = scipy.fft.fft2(spread).real
    return transfer / transfer[0, 0]


def closed_otf(f: ArrayLike, cutoff: float, shape: str = "circle") -> Real:
    """(2/pi)(acos s - s sqrt(1 - s^2)), s = f/(2 fc), for the circle; 1 - s for the slit.

    Goodman, Introduction to Fourier Optics, eqs. 6-31 and 6-33.
    """
    s = np.clip(np.abs(np.asarray(f, float)) / (2 * cutoff), 0, 1)
    if shape == "slit":
        return 1 - s
    return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))


def incoherent_image(intensity: Real, cutoff: float) -> Real:
    """Image of an object that shines by itself: its intensity times the OTF, clear field 1."""
    return scipy.fft.ifft2(scipy.fft.fft2(intensity) * otf(len(intensity), cutoff)).real


def abbe_image(target: Real, power: Real, cutoff: float) -> Real:
    """Exact mean image of a real target in light of power spectrum power x power.

    I = sum_f S(f) |IFFT{O(f' - f) P(f')}|^2 (Abbe; Born & Wolf, Principles of Optics, 10.6) over
    every frequency f of the grid, S(f) = power[fy] power[fx], power even, of sum 1, in FFT order; a
    real target and an even pupil give f and -f the same image, so half of the plane is summed.
    Only the band of the pupil, then of the intensity, is transformed. Not normalised: a clear
    field gives clear_transmission.
    """
    n = len(target)
    band = int(np.floor(cutoff * n * (1 + 1e-12)))
    small = scipy.fft.next_fast_len(4 * band + 2)
    if small > n:
        raise ValueError(f"the intensity band of cutoff {cutoff} needs {small} samples of {n}")
    k = np.arange(-band, band + 1)
    inside = pupil(n, cutoff)[np.ix_(k, k)]
    spectrum = scipy.fft.fft2(target) / n**2
    total = np.zeros((small, small))
    for fy in range(n // 2 + 1):
        twin = 1 if fy == 0 or 2 * fy == n else 2
        rows = spectrum[(k - fy) % n]
        shifted = (k[None, :] - np.arange(n)[:, None]) % n
        u = np.zeros((n, small, small), dtype=complex)
        u[:, k[:, None], k[None, :]] = rows[:, shifted].transpose(1, 0, 2) * inside
        images = np.abs(scipy.fft.ifft2(u)) ** 2 * small**4
        total += twin * power[fy] * np.einsum("f,fyx->yx", power, images)
    return enlarge(total, n)


def enlarge(image: Real, n: int) -> Real:
    """A band-limited periodic image on n x n samples, by zeros about its spectrum."""
    small = len(image)
    k = np.rint(scipy.fft.fftfreq(small) * small).astype(int)
    spectrum = np.zeros((n, n), dtype=complex)
    spectrum[np.ix_(k, k)] = scipy.fft.fft2(image)
    return scipy.fft.ifft2(spectrum).real * (n / small) ** 2


def correlation_image(target: Real, degree: Real, cutoff: float) -> Real:
    """The image of abbe_image from the degree of coherence, another route, shape (n, n) lags.

    I = sum_l mu(l) {h(x) conj h(x - l)} * {o(x) o(x + l)} over the lags l where mu is not 0,
    h the point image (Hopkins 1953, eq. 4). Cheap where the coherence is short.
    """
    n = len(target)
    h = scipy.fft.ifft2(pupil(n, cutoff))
    total = np.zeros((n, n), dtype=complex)
    for ly, lx in np.argwhere(np.abs(degree) > 1e-12):
        kernel = h * np.roll(h, (ly, lx), (0, 1)).conj()
        pairs = target * np.roll(target, (-ly, -lx), (0, 1))
        total += degree[ly, lx] * scipy.fft.fft2(kernel) * scipy.fft.fft2(pairs)
    return scipy.fft.ifft2(total).real


def clear_transmission(power: Real, cutoff: float) -> float:
    """Part of the light of power spectrum power x power that passes the pupil."""
    return float(power @ pupil(len(power), cutoff) @ power)


def coherent_edge(x: ArrayLike, cutoff: float) -> Real:
    """Intensity (1/2 + Si(2 pi fc x)/pi)^2 of an edge at x = 0 in coherent light.

    Goodman, Introduction to Fourier Optics, 6.5.2; slit and circular pupil alike.
    """
    return (0.5 + sici(2 * np.pi * cutoff * np.asarray(x, float))[0] / np.pi) ** 2


def incoherent_edge(x: ArrayLike, cutoff: float, shape: str = "circle") -> Real:
    """1/2 + (1/pi) int_0^(2fc) OTF(f) sin(2 pi f x)/f df: the edge in incoherent light."""

    def integral(at: float) -> float:
        def integrand(f: float) -> float:
            return float(closed_otf(f, cutoff, shape)) * 2 * at * np.sinc(2 * f * at)

        return quad(integrand, 0, 2 * cutoff, limit=200)[0]

    return 0.5 + np.vectorize(integral, otypes=[float])(x)


def half_plane(n: int) -> Real:
    """1 for x > 0 of a periodic window, the two samples on an edge 1/2, x = 0 at sample n//2."""
    if n % 2:
        raise ValueError(f"an edge and its partner need an even number of samples, not {n}")
    edge = np.zeros(n)
    edge[n // 2 + 1 :] = 1
    edge[[0, n // 2]] = 0.5
    return edge


def filtered_edge(n: int, cutoff: float) -> tuple[Real, Real]:
    """Coherent and incoherent image of half_plane through the sampled circular pupil, 1-D."""
    f = scipy.fft.fftfreq(n)
    spectrum = scipy.fft.fft(half_plane(n))
    coherent = np.abs(scipy.fft.ifft(spectrum * (np.abs(f) <= cutoff * (1 + 1e-12)))) ** 2
    return coherent, scipy.fft.ifft(spectrum * otf(n, cutoff)[0]).real


def partial_edge(iota: float, n: int = 512, samples: int = 16) -> tuple[Real, float]:
    """Edge in the light of square cells and a circular pupil: image over its clear field, and T.

    `samples` samples to 1/fc, x = 0 at n//2. The source is 2-D, sinc^2(p fx) sinc^2(p fy) on the
    grid's frequencies, p = .61/(iota fc), each axis of sum 1. The edge varies in x alone, so the
    source row fy sees a slit of half width sqrt(fc^2 - fy^2).
    """
    fc, f, k = 1 / samples, scipy.fft.fftfreq(n), np.rint(scipy.fft.fftfreq(n) * n).astype(int)
    power = np.sinc(0.61 / (iota * fc) * f) ** 2
    power /= power.sum()
    spectrum = scipy.fft.fft(half_plane(n))
    shifted = spectrum[(k[None, :] - k[:, None]) % n]
    image, passed = np.zeros(n), 0.0
    for fy, weight in zip(f, power, strict=True):
        if fy < 0 or fy > fc:
            continue
        slit = f**2 + fy**2 <= fc**2 * (1 + 1e-12)
        weight = weight * (1 if fy == 0 else 2)
        image += weight * (power @ np.abs(scipy.fft.ifft(shifted * slit)) ** 2)
        passed += weight * power[slit].sum()
    return image / passed, float(passed)
