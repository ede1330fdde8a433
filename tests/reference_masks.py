"""float64 twins of the light that random phase masks and extended sources give.

Snapshots, estimators of the degree of coherence, and the closed forms they are held against.
Nothing here imports the package under test. Conventions: time factor exp(-i omega t), arrays
[y, x], SI metres, square periodic windows of `size` samples of `pitch`, sample i of an axis at
(i - size//2) pitch, spectra and lags in FFT order, the carrier exp(ikz) dropped.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray
from reference_optics import Complex, Real, axis, transfer_function
from scipy.special import hyp2f1, j1

SIGMA = 1 / (2 * np.sqrt(2 * np.log(2)))  # of a Gaussian of FWHM 1


def random_mask(
    rng: Generator,
    size: int,
    cells: int,
    *,
    pitch: float = 1.0,
    wavelength: float = 1.0,
    kernel: str = "square",
    distance: float = 0.0,
    kind: str = "field",
    jitter: bool = True,
) -> Complex:
    """One snapshot of a random phase mask, shape (size, size), <|u|^2> = 1 over the ensemble.

    cells x cells sources of uniform random phase over the window, the cell p = size pitch/cells;
    each is a square of one cell or a Gaussian of FWHM p in amplitude; then `distance` by the
    angular spectrum with periodic borders. kind="phase" keeps the phase alone. With jitter the
    origin of the lattice is uniform over one cell: over whole and broken samples for the
    Gaussian, rounded to the samples' centres for the square.
    """
    sources = np.exp(1j * rng.uniform(-np.pi, np.pi, (cells, cells)))
    shift = rng.uniform(0, size / cells, 2) if jitter else np.zeros(2)
    place = {"square": square_cells, "gaussian": gaussian_cells}[kernel]
    u = place(sources, size, shift)
    if distance:
        h = transfer_function((size, size), pitch, distance, wavelength)
        u = scipy.fft.ifft2(scipy.fft.fft2(u) * h)
    return np.exp(1j * np.angle(u)) if kind == "phase" else u


def square_cells(sources: Complex, size: int, shift: Real) -> Complex:
    """The sources as squares of one cell side by side, the lattice moved by shift (y, x) samples.

    A sample belongs to the cell that its centre lies in.
    """
    n = len(sources)
    y, x = (np.floor((np.arange(size) + s) * n / size).astype(int) % n for s in shift)
    return sources[y[:, None], x[None, :]]


def gaussian_cells(sources: Complex, size: int, shift: Real) -> Complex:
    """The sources as Gaussians of FWHM one cell, the lattice moved by shift (y, x) samples.

    The spectrum of n x n points on a window is the n x n DFT of their phasors, repeated; times
    the spectrum exp(-2 (pi sg f)^2) of the Gaussian. Scaled to <|u|^2> = 1 over the ensemble.
    """
    n, f = len(sources), scipy.fft.fftfreq(size)
    sg = SIGMA * size / n
    index = np.rint(f * size).astype(int) % n
    line = np.exp(-2 * (np.pi * sg * f) ** 2)
    y, x = (line * np.exp(2j * np.pi * f * s) for s in shift)
    spectrum = scipy.fft.fft2(sources)[np.ix_(index, index)] * y[:, None] * x[None, :]
    return scipy.fft.ifft2(spectrum) * size**2 / (n * np.sum(line**2))


def mask_power(size: int, cells: int, kernel: str = "square", *, sampled: bool = True) -> Real:
    """Power spectrum S(f) of the mask on one axis, FFT order, sum 1; the mask's is S(fy) S(fx).

    |K^|^2: sinc^2(p f), or for a square of a whole number m of samples (sampled=True)
    (sin(pi m f)/(m sin(pi f)))^2, f in cycles a sample; exp(-(2 pi sg f)^2) for the Gaussian.
    """
    f, m = scipy.fft.fftfreq(size), size / cells
    if kernel == "gaussian":
        s = np.exp(-((2 * np.pi * SIGMA * m * f) ** 2))
    elif sampled:
        if size % cells:
            raise ValueError(f"{cells} cells do not divide {size} samples")
        s = (np.sinc(m * f) / np.sinc(f)) ** 2
    else:
        s = np.sinc(m * f) ** 2
    return s / s.sum()


def triangle(dy: ArrayLike, dx: ArrayLike, cell: float) -> Real:
    """Degree of coherence (1-|dy|/p)(1-|dx|/p) of square cells: the autocorrelation of K."""
    y, x = (np.clip(1 - np.abs(np.asarray(d, float)) / cell, 0, None) for d in (dy, dx))
    return y * x


def gaussian(dy: ArrayLike, dx: ArrayLike, cell: float) -> Real:
    """Degree of coherence exp(-(dy^2 + dx^2)/(4 sg^2)) of Gaussian cells of FWHM `cell`."""
    square = np.asarray(dy, float) ** 2 + np.asarray(dx, float) ** 2
    return np.exp(-square / (4 * (SIGMA * cell) ** 2))


def phase_only(mu: ArrayLike) -> NDArray:
    """Degree of coherence left when only the phase of a circular Gaussian field is kept.

    (pi/4) mu 2F1(1/2, 1/2; 2; |mu|^2) (Reed 1962; Goodman, Statistical Optics).
    """
    mu = np.asarray(mu)
    return np.pi / 4 * mu * hyp2f1(0.5, 0.5, 2.0, np.abs(mu) ** 2)


def periodic_degree(snapshots: list[Complex]) -> Complex:
    """mu at every lag (FFT order) from snapshots: their mean periodic autocorrelation over lag 0.

    mu(l) = <u(x + l) conj u(x)>/<|u|^2>, over the window and the snapshots.
    """
    power = np.mean([np.abs(scipy.fft.fft2(u)) ** 2 for u in snapshots], axis=0)
    correlation = scipy.fft.ifft2(power)
    return correlation / correlation[0, 0].real


def window_degree(snapshots: list[Complex]) -> Complex:
    """mu at every lag of a window that does not repeat, shape (2 n - 1, 2 n - 1), FFT order.

    As periodic_degree, each lag averaged over the pairs of samples that the window holds.
    """
    ny, nx = snapshots[0].shape
    shape = (2 * ny - 1, 2 * nx - 1)
    power = np.mean([np.abs(scipy.fft.fft2(u, shape)) ** 2 for u in snapshots], axis=0)
    ly, lx = (np.abs(np.rint(scipy.fft.fftfreq(n) * n)) for n in shape)
    correlation = scipy.fft.ifft2(power) / ((ny - ly)[:, None] * (nx - lx)[None, :])
    return correlation / correlation[0, 0].real


def contrast(intensity: ArrayLike) -> float:
    """Standard deviation over mean."""
    values = np.asarray(intensity)
    return float(values.std() / values.mean())


def extended_snapshot(
    rng: Generator,
    size: int,
    points: int,
    *,
    pitch: float,
    source: float,
    distance: float,
    wavelength: float,
    shape: str = "disc",
) -> Complex:
    """Field of points of random phase spread over a disc or square, as Fresnel delivers it.

    source is the diameter or the side. The curvature exp(i pi r^2/(lam d)) common to all points
    is left out; <|u|^2> = 1 over the ensemble.
    """
    if shape == "disc":
        radius = source / 2 * np.sqrt(rng.uniform(0, 1, points))
        angle = rng.uniform(-np.pi, np.pi, points)
        sy, sx = radius * np.sin(angle), radius * np.cos(angle)
    else:
        sy, sx = rng.uniform(-source / 2, source / 2, (2, points))
    x, turns = axis(size, pitch), 1 / (wavelength * distance)
    own = np.exp(1j * (rng.uniform(-np.pi, np.pi, points) + np.pi * turns * (sy**2 + sx**2)))
    rows, columns = (np.exp(-2j * np.pi * turns * np.outer(x, s)) for s in (sy, sx))
    return np.einsum("yj,xj->yx", rows * own, columns) / np.sqrt(points)


def disc_degree(delta: ArrayLike, source: float, distance: float, wavelength: float) -> Real:
    """2 J1(v)/v, v = pi D Delta/(lam d): van Cittert-Zernike for a disc of diameter D."""
    v = np.pi * source * np.abs(np.asarray(delta, float)) / (wavelength * distance)
    safe = np.where(v == 0, 1.0, v)
    return np.where(v == 0, 1.0, 2 * j1(safe) / safe)


def square_degree(
    dy: ArrayLike, dx: ArrayLike, source: float, distance: float, wavelength: float
) -> Real:
    """sinc(D dy/(lam d)) sinc(D dx/(lam d)): van Cittert-Zernike for a square of side D."""
    scale = source / (wavelength * distance)
    return np.sinc(scale * np.asarray(dy, float)) * np.sinc(scale * np.asarray(dx, float))


def young_fringes(pairs: Complex, phase: ArrayLike) -> Real:
    """Mean fringes of two equal pinholes: <|u1 + u2 exp(i phase)|^2> over pairs, shape (m, 2).

    phase is 2 pi b x/(lam z) at the point x of the screen, for pinholes b apart.
    """
    carrier = np.exp(1j * np.asarray(phase))
    screen = pairs[:, 0, None] + pairs[:, 1, None] * carrier
    return np.mean(np.abs(screen) ** 2, axis=0)


def closed_fringes(mu: complex, phase: ArrayLike) -> Real:
    """2 (1 + Re(mu exp(i phase))), mu = <u2 conj u1> (Born & Wolf, Principles of Optics, 10.3)."""
    return 2 * (1 + np.real(mu * np.exp(1j * np.asarray(phase))))


def visibility(fringes: ArrayLike) -> float:
    """(max - min)/(max + min)."""
    values = np.asarray(fringes)
    return float((values.max() - values.min()) / (values.max() + values.min()))
