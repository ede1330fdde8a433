"""Reciprocal vectors of a repeated pattern: Fourier peaks first, then local phases.

The peaks give rough vectors; least squares on local phases of the Fourier orders give them to a
thousandth of the pitch. A pattern with the reciprocal vectors g_1, g_2 and a lenslet centred at
r_0 has, in a window about r_t, the Fourier sums

    C_j(t) = sum_r w(r - r_t) I(r) exp(-2 pi i g_j r),      arg C_j = -2 pi g_j r_0

for every t if g_j is exact. If g_j is off by e_j, the phase changes by e_j r_t cycles. Brightness
that varies between lenslets does not shift the phase of a sum over points of the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np

Values = np.ndarray[Any, np.dtype[Any]]
Basis = np.ndarray[Any, np.dtype[np.float64]]

PITCHES = (4.2, 72.0)  # px: slightly wider than the supported range
_MAX_SIDE = 2048  # px: largest part of a picture in use
_RINGS = 4  # bins: width of a ring of frequencies
_MIN_RING_RATIO = 6.0  # times the median of its ring: minimum of a peak; noise reaches 5
_MIN_PEAK = 0.03  # of the strongest peak: minimum, above side lobes
_MAX_PEAKS = 40  # number of peaks in use
_PAIRS = 14  # number of peaks that are tried as base vectors
_MIN_SHARE = 0.95  # of the best share: minimum for a denser lattice
_SHORTER = 1 - 1e-9  # on squared lengths: excludes round-off
_MAX_DISTANCE = 1.0  # bins: maximum distance of a peak from a sum of base vectors


@dataclass(frozen=True)
class Peaks:
    """Peaks of a spectrum: frequencies (y, x) in cycles a pixel, amplitude, bin size."""

    at: Basis
    strength: Values
    bin: Values


def coarse_basis(
    picture: Values, pitches: tuple[float, float] = PITCHES
) -> tuple[Basis | None, float]:
    """Return the coarsest reciprocal lattice through the peaks of a picture, and its share."""
    peaks = spectral_peaks(picture, pitches)
    order = np.argsort(-peaks.strength)[:_MAX_PEAKS]
    peaks = Peaks(peaks.at[order], peaks.strength[order], peaks.bin)
    best: list[tuple[float, float, Basis]] = []
    for i, k in combinations(range(min(_PAIRS, len(order))), 2):
        basis = reduced_basis(np.array([peaks.at[i], peaks.at[k]]))
        area = abs(np.linalg.det(basis))
        lengths = np.hypot(*basis.T)
        if area > 0.4 * lengths.prod() and lengths.min() > 1 / (2 * pitches[1]):
            basis = _settled(peaks, basis)
            best.append((_explained(peaks, basis), area, basis))
    if not best:
        return None, 0.0
    min_share = _MIN_SHARE * max(share for share, _, _ in best)
    basis = max((entry for entry in best if entry[0] >= min_share), key=lambda entry: entry[1])[2]
    return basis, _share(peaks, basis, 1)


def spectral_peaks(picture: Values, pitches: tuple[float, float]) -> Peaks:
    """Return the maxima of the windowed spectrum above their ring, in half of the plane."""
    from scipy import fft, ndimage

    flat = divide_by_local_mean(central_crop(picture), int(2 * pitches[1]))
    ny, nx = flat.shape
    window = np.hanning(ny + 2)[1:-1, None] * np.hanning(nx + 2)[None, 1:-1]
    spectrum = np.abs(fft.rfft2((flat * window).astype(np.float32)))
    fy, fx = fft.fftfreq(ny), fft.rfftfreq(nx)
    radius = np.hypot(fy[:, None], fx[None, :])
    ring = _ring_median(spectrum, radius * min(ny, nx) / _RINGS)
    top = ndimage.maximum_filter(spectrum, 5, mode=("wrap", "nearest")) == spectrum
    band = (radius > 0.5 / pitches[1]) & (radius < min(0.49, 1.25 / pitches[0]))
    half = (fx[None, :] > 0) | (fy[:, None] > 0)
    clear = spectrum > np.maximum(_MIN_RING_RATIO * ring, _MIN_PEAK * (spectrum * band).max())
    y, x = np.nonzero(top & band & half & clear)
    at = np.stack([fy[y], fx[x]], axis=1) + _between(spectrum, y, x) / [ny, nx]
    return Peaks(at, spectrum[y, x], 1 / np.array([ny, nx]))


def central_crop(picture: Values, size: int = _MAX_SIDE) -> Values:
    """Return the middle of a picture, at most ``size`` pixels a side."""
    starts = [(n - min(n, size)) // 2 for n in picture.shape]
    return picture[tuple(slice(s, s + size) for s in starts)]


def divide_by_local_mean(picture: Values, width: int) -> Values:
    """Remove vignetting: divide by the mean within about ``width`` pixels, subtract one."""
    from scipy.ndimage import uniform_filter

    size = [min(width, max(3, n // 2)) | 1 for n in picture.shape]
    mean = uniform_filter(uniform_filter(picture, size), size)
    lowest = 0.02 * float(mean.max())
    return np.asarray(picture / np.maximum(mean, max(lowest, 1e-30)) - (mean > lowest))


def reduced_basis(basis: Basis) -> Basis:
    """Return the shortest two vectors of a lattice (Lagrange and Gauss).

    Iteration ends when a step no longer shortens the longer vector, also by round-off. Parallel,
    zero or NaN vectors give no valid lattice.
    """
    a, b = basis
    while True:
        if a @ a > b @ b:
            a, b = b, a
        shorter = b - np.rint((a @ b) / max(a @ a, 1e-300)) * a
        if not shorter @ shorter < _SHORTER * (b @ b):
            return np.array([a, b])
        b = shorter


def _on_lattice(peaks: Peaks, basis: Basis) -> tuple[Values, Values]:
    """Return each peak's nearest integer multiples of the basis, and a mask of close ones."""
    counts = np.rint(peaks.at @ np.linalg.inv(basis))
    distances = (peaks.at - counts @ basis) / peaks.bin
    return counts, np.hypot(*distances.T) < _MAX_DISTANCE * (1 + 0.1 * np.abs(counts).sum(1))


def _settled(peaks: Peaks, basis: Basis) -> Basis:
    """Refine base vectors by least squares on the peaks near their multiples."""
    for _ in range(2):
        counts, near = _on_lattice(peaks, basis)
        weight = (peaks.strength * near)[:, None]
        if np.linalg.matrix_rank(counts[near]) < 2:
            break
        basis = np.linalg.lstsq(counts * weight, peaks.at * weight, rcond=None)[0]
    return basis


def _explained(peaks: Peaks, basis: Basis) -> float:
    """Return the share of the peaks' energy on a lattice, corrected for chance."""
    share = _share(peaks, basis, 2)
    chance = float(np.pi * _MAX_DISTANCE**2 * peaks.bin.prod() / abs(np.linalg.det(basis)))
    return (share - chance) / max(1 - chance, 1e-9) if chance < 1 else 0.0


def _share(peaks: Peaks, basis: Basis, power: int) -> float:
    """Return the share of a power of the peaks' strength on a lattice."""
    weight = peaks.strength**power
    return float(weight[_on_lattice(peaks, basis)[1]].sum() / weight.sum())


def _ring_median(spectrum: Values, ring: Values) -> Values:
    """Return at every sample the median of the spectrum over its ring of equal radius."""
    labels = ring.astype(np.int32).ravel()
    order = np.argsort(labels, kind="stable")
    edges = np.searchsorted(labels[order], np.arange(labels.max() + 2))
    values = spectrum.ravel()[order]
    medians = np.array([np.median(values[a:b]) if b > a else 1.0 for a, b in pairwise(edges)])
    return np.asarray(np.maximum(medians, 1e-30)[labels].reshape(spectrum.shape))


def _between(spectrum: Values, y: Values, x: Values) -> Values:
    """Return the sub-bin position (y, x) of maxima, by a parabola through logarithms."""
    ny, nx = spectrum.shape
    log = np.log(np.maximum(spectrum, 1e-30))
    peak = log[y, x]
    columns = np.clip(x - 1, 0, nx - 1), np.clip(x + 1, 0, nx - 1)
    sides = (
        (log[(y - 1) % ny, x], log[(y + 1) % ny, x]),
        (log[y, columns[0]], log[y, columns[1]]),
    )
    steps = []
    for low, high in sides:
        curvature = np.minimum(low + high - 2 * peak, -1e-12)
        steps.append(np.clip((low - high) / (2 * curvature), -0.5, 0.5))
    return np.stack(steps, axis=1)


_PERIODS = 6  # of the pattern: size of a window in a large picture
_TILES = 24  # maximum number of windows along an axis, before they grow
_MIN_BRIGHTNESS = 0.15  # of the brightest window: minimum for a valid one
_OUTLIER = 0.05  # cycles: residual at which the weight is one half
_ROUNDS = 12  # iterations of the reweighted fit


@dataclass(frozen=True)
class PhaseFit:
    """Reciprocal vectors (rows, (y, x) in cycles a pixel) with the phases of their lattice.

    ``phase`` in cycles: g_j r_0 = -phase_j. ``positions`` (n, 2) are the centres of the windows,
    ``residual`` (n, 2) their deviations in cycles, ``weight`` (n,) their brightness and contrast.
    """

    basis: Basis
    phase: Values
    positions: Values
    residual: Values
    weight: Values

    @property
    def cell(self) -> Basis:
        """Direct base vectors (y, x) in pixels, as rows."""
        return np.asarray(np.linalg.inv(self.basis).T)

    @property
    def origin(self) -> Values:
        """Centre (y, x) of a lenslet in pixels."""
        return np.asarray(-self.phase @ self.cell)

    @property
    def rms(self) -> float:
        """Root mean square distance of local lattices from this one, in pixels."""
        if not self.weight.sum() > 0:
            return float("inf")
        displacements = self.residual @ self.cell
        return float(np.sqrt((self.weight @ (displacements**2).sum(1)) / self.weight.sum()))

    @property
    def agreeing(self) -> float:
        """Share of the lit windows' weight within a twelfth of a period."""
        near = (np.abs(self.residual) < 1 / 12).all(1)
        return float(self.weight[near].sum() / max(self.weight.sum(), 1e-30))


def fit_lattice(picture: Values, basis: Basis, *, margin: int = 0) -> PhaseFit:
    """Fit an affine lattice, from the middle of a picture outwards."""
    ny, nx = picture.shape
    picture = picture[margin : ny - margin, margin : nx - margin]
    rows, columns = (_windows(n, basis) for n in picture.shape)
    middle = (np.array(picture.shape) - 1) / 2
    grids = np.meshgrid(rows[0] - middle[0], columns[0] - middle[1], indexing="ij")
    positions = np.stack([a.ravel() for a in grids], axis=1)
    distance = np.abs(positions / np.maximum(middle, 1)).max(1)
    sums, mean = _sums(np.asarray(picture, np.float32), basis, rows[1], columns[1])
    lit = mean > _MIN_BRIGHTNESS * max(float(mean.max()), 1e-30)
    strength = np.abs(sums) * lit
    planes, residuals = np.zeros((2, 3)), np.zeros((len(distance), 2))
    for j in range(2):
        planes[j], residuals[:, j] = _plane(
            np.angle(sums[j]) / (2 * np.pi), strength[j], positions, distance
        )
    refined = basis + planes[:, 1:]
    middle = middle + margin
    phase = planes[:, 0] - refined @ middle
    return PhaseFit(refined, phase, positions + middle, residuals, strength.mean(axis=0))


def _windows(n: int, basis: Basis) -> tuple[Values, Values]:
    """Return the centres of windows along an axis of n pixels, and their weights (count, n)."""
    period = 1 / np.hypot(*basis.T).min()
    width = int(np.ceil(max(min(_PERIODS * period, 0.6 * n), 2 * n / _TILES)))
    count = max(1, round(2 * (n - width) / width) + 1)
    starts = np.rint(np.linspace(0, n - width, count)).astype(int)
    shape = np.sin(np.pi * (np.arange(width) + 0.5) / width) ** 4
    weights = np.zeros((count, n))
    for weight, start in zip(weights, starts, strict=True):
        weight[start : start + width] = shape / shape.sum()
    return starts + (width - 1) / 2, weights


def _sums(picture: Values, basis: Basis, down: Values, across: Values) -> tuple[Values, Values]:
    """Return Fourier sums (2, windows) without the constant, and means (windows,)."""
    mean = down @ (picture @ across.T.astype(np.float32))
    sums = []
    for g in basis:
        ramps = [
            np.exp(-2j * np.pi * f * (np.arange(n) - (n - 1) / 2))
            for f, n in zip(g, picture.shape, strict=True)
        ]
        left, right = down * ramps[0], (across * ramps[1]).T
        inner = picture @ right.real.astype(np.float32) + 1j * (
            picture @ right.imag.astype(np.float32)
        )
        sums.append((left @ inner - mean * np.outer(left.sum(1), right.sum(0))).ravel())
    return np.array(sums), mean.ravel()


def _plane(
    turns: Values, strength: Values, positions: Values, far: Values
) -> tuple[Values, Values]:
    """Fit a plane (offset, slopes) to phases in cycles; return it with the residuals.

    Phases are unwrapped outwards from the nearest nine windows, with Cauchy weights.
    """
    size = max(float(np.abs(positions).max()), 1.0)
    model = np.concatenate([np.ones((len(positions), 1)), positions / size], axis=1)
    near = far <= np.sort(far)[min(8, far.size - 1)]
    plane = np.zeros(3)
    plane[0] = np.angle((strength * np.exp(2j * np.pi * turns))[near].sum()) / (2 * np.pi)
    reach = np.linspace(max(0.35, far[near].max()), 1, _ROUNDS // 2)
    for limit in np.append(reach, np.ones(_ROUNDS // 2)):
        residuals = turns - model @ plane
        residuals -= np.rint(residuals)
        weight = strength * (far <= limit) / (1 + (residuals / _OUTLIER) ** 2)
        normal = (model * weight[:, None]).T @ model
        plane += np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ (
            model.T @ (weight * residuals)
        )
    residuals = turns - model @ plane
    return plane / [1, size, size], residuals - np.rint(residuals)
