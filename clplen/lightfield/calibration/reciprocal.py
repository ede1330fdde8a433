"""Reciprocal base vectors of a repeated pattern: peaks of its Fourier transform, then local phases.

The peaks give them roughly, least squares on local phases of the Fourier orders to a thousandth of
the pitch: a pattern with the reciprocal vectors g_1, g_2 and a lenslet centred at r_0 has in a
window about r_t the Fourier sums

    C_j(t) = sum_r w(r - r_t) I(r) exp(-2 pi i g_j r),      arg C_j = -2 pi g_j r_0

for every t if g_j is right; if it is off by e_j, the phase in cycles runs as e_j r_t. Brightness
that changes from lenslet to lenslet does not move the phase of a sum over points of the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np

Values = np.ndarray[Any, np.dtype[Any]]
Basis = np.ndarray[Any, np.dtype[np.float64]]

PITCHES = (4.2, 72.0)  # px: a little more than the range that is served
_CROP = 2048  # px: the middle of a larger picture tells enough
_RINGS = 4  # bins: spectra fall with frequency, a ring is taken as alike
_CLEAR = 6.0  # times the median of its ring; noise reaches 5
_LEAST = 0.03  # of the strongest peak: below are side lobes
_MOST = 40
_PAIRS = 14  # strongest peaks that may be base vectors
_ENOUGH = 0.95  # of the best share, for a denser lattice
_SHORTER = 1 - 1e-9  # of the square of a length: less is round-off
_NEAR = 1.0  # bins: how far a sum of base vectors may lie from its peak


@dataclass(frozen=True)
class Peaks:
    """Peaks of a spectrum: cycles a pixel (y, x), amplitude, size of a bin."""

    at: Basis
    strength: Values
    bin: Values


def coarse_basis(
    picture: Values, pitches: tuple[float, float] = PITCHES
) -> tuple[Basis | None, float]:
    """The coarsest reciprocal lattice that holds the peaks of a picture."""
    found = spectral_peaks(picture, pitches)
    order = np.argsort(-found.strength)[:_MOST]
    found = Peaks(found.at[order], found.strength[order], found.bin)
    best: list[tuple[float, float, Basis]] = []
    for i, k in combinations(range(min(_PAIRS, len(order))), 2):
        basis = reduced_basis(np.array([found.at[i], found.at[k]]))
        area = abs(np.linalg.det(basis))
        lengths = np.hypot(*basis.T)
        if area > 0.4 * lengths.prod() and lengths.min() > 1 / (2 * pitches[1]):
            basis = _settled(found, basis)
            best.append((_explained(found, basis), area, basis))
    if not best:
        return None, 0.0
    enough = _ENOUGH * max(share for share, _, _ in best)
    basis = max((entry for entry in best if entry[0] >= enough), key=lambda entry: entry[1])[2]
    return basis, _share(found, basis, 1)


def spectral_peaks(picture: Values, pitches: tuple[float, float]) -> Peaks:
    """Maxima of the windowed spectrum that stand out of their ring, in half of the plane."""
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
    clear = spectrum > np.maximum(_CLEAR * ring, _LEAST * (spectrum * band).max())
    y, x = np.nonzero(top & band & half & clear)
    at = np.stack([fy[y], fx[x]], axis=1) + _between(spectrum, y, x) / [ny, nx]
    return Peaks(at, spectrum[y, x], 1 / np.array([ny, nx]))


def central_crop(picture: Values, size: int = _CROP) -> Values:
    """The middle of a picture, at most so many pixels a side."""
    starts = [(n - min(n, size)) // 2 for n in picture.shape]
    return picture[tuple(slice(s, s + size) for s in starts)]


def divide_by_local_mean(picture: Values, width: int) -> Values:
    """A picture over its own mean within about ``width`` pixels, minus one: vignetting removed."""
    from scipy.ndimage import uniform_filter

    size = [min(width, max(3, n // 2)) | 1 for n in picture.shape]
    mean = uniform_filter(uniform_filter(picture, size), size)
    lowest = 0.02 * float(mean.max())
    return np.asarray(picture / np.maximum(mean, max(lowest, 1e-30)) - (mean > lowest))


def reduced_basis(basis: Basis) -> Basis:
    """The shortest two vectors of the lattice of two (Lagrange and Gauss).

    Ends once a step no longer shortens the longer one, be it by round-off (a quotient of a half and
    of -a half in turns); of vectors along one line, or zero or NaN ones, no lattice comes out.
    """
    a, b = basis
    while True:
        if a @ a > b @ b:
            a, b = b, a
        shorter = b - np.rint((a @ b) / max(a @ a, 1e-300)) * a
        if not shorter @ shorter < _SHORTER * (b @ b):
            return np.array([a, b])
        b = shorter


def _on_lattice(found: Peaks, basis: Basis) -> tuple[Values, Values]:
    """Integer multiples of the base vectors nearest to every peak, and which lie near enough."""
    counts = np.rint(found.at @ np.linalg.inv(basis))
    away = (found.at - counts @ basis) / found.bin
    return counts, np.hypot(*away.T) < _NEAR * (1 + 0.1 * np.abs(counts).sum(1))


def _settled(found: Peaks, basis: Basis) -> Basis:
    """The base vectors by least squares on the peaks near them and their multiples."""
    for _ in range(2):
        counts, near = _on_lattice(found, basis)
        weight = (found.strength * near)[:, None]
        if np.linalg.matrix_rank(counts[near]) < 2:
            break
        basis = np.linalg.lstsq(counts * weight, found.at * weight, rcond=None)[0]
    return basis


def _explained(found: Peaks, basis: Basis) -> float:
    """Share of the peaks' energy on the lattice of a basis, chance taken off."""
    share = _share(found, basis, 2)
    chance = float(np.pi * _NEAR**2 * found.bin.prod() / abs(np.linalg.det(basis)))
    return (share - chance) / max(1 - chance, 1e-9) if chance < 1 else 0.0


def _share(found: Peaks, basis: Basis, power: int) -> float:
    """Share of a power of the peaks' strength that lies on the lattice of a basis."""
    weight = found.strength**power
    return float(weight[_on_lattice(found, basis)[1]].sum() / weight.sum())


def _ring_median(spectrum: Values, ring: Values) -> Values:
    """Median of the spectrum over rings of equal radius, at every sample."""
    labels = ring.astype(np.int32).ravel()
    order = np.argsort(labels, kind="stable")
    edges = np.searchsorted(labels[order], np.arange(labels.max() + 2))
    values = spectrum.ravel()[order]
    medians = np.array([np.median(values[a:b]) if b > a else 1.0 for a, b in pairwise(edges)])
    return np.asarray(np.maximum(medians, 1e-30)[labels].reshape(spectrum.shape))


def _between(spectrum: Values, y: Values, x: Values) -> Values:
    """Where a parabola through three logarithms has its top, bins (y, x) from the middle one."""
    ny, nx = spectrum.shape
    log = np.log(np.maximum(spectrum, 1e-30))
    here = log[y, x]
    columns = np.clip(x - 1, 0, nx - 1), np.clip(x + 1, 0, nx - 1)
    sides = (
        (log[(y - 1) % ny, x], log[(y + 1) % ny, x]),
        (log[y, columns[0]], log[y, columns[1]]),
    )
    steps = []
    for low, high in sides:
        bend = np.minimum(low + high - 2 * here, -1e-12)
        steps.append(np.clip((low - high) / (2 * bend), -0.5, 0.5))
    return np.stack(steps, axis=1)


_PERIODS = 6  # of the pattern, that a window holds where the picture is large enough
_TILES = 24  # windows along an axis at most, before they grow
_LIT = 0.15  # of the brightest window: darker ones do not count
_OUTLIER = 0.05  # cycles, where a residual begins to count less
_ROUNDS = 12


@dataclass(frozen=True)
class PhaseFit:
    """Reciprocal vectors (rows, (y, x) in cycles a pixel) with the phases of their lattice.

    ``phase`` in cycles: g_j r_0 = -phase_j. ``places`` (n, 2) are the centres of the windows,
    ``residual`` (n, 2) their deviations in cycles, ``weight`` (n,) the light and contrast in them.
    """

    basis: Basis
    phase: Values
    places: Values
    residual: Values
    weight: Values

    @property
    def cell(self) -> Basis:
        """Direct base vectors (y, x) in pixels, as rows."""
        return np.asarray(np.linalg.inv(self.basis).T)

    @property
    def origin(self) -> Values:
        """(y, x) of a lenslet's centre."""
        return np.asarray(-self.phase @ self.cell)

    @property
    def rms(self) -> float:
        """rms distance of local lattices from this one, in pixels."""
        if not self.weight.sum() > 0:
            return float("inf")
        moved = self.residual @ self.cell
        return float(np.sqrt((self.weight @ (moved**2).sum(1)) / self.weight.sum()))

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
    places = np.stack([a.ravel() for a in grids], axis=1)
    far = np.abs(places / np.maximum(middle, 1)).max(1)
    sums, mean = _sums(np.asarray(picture, np.float32), basis, rows[1], columns[1])
    lit = mean > _LIT * max(float(mean.max()), 1e-30)
    strength = np.abs(sums) * lit
    planes, residuals = np.zeros((2, 3)), np.zeros((len(far), 2))
    for j in range(2):
        planes[j], residuals[:, j] = _plane(
            np.angle(sums[j]) / (2 * np.pi), strength[j], places, far
        )
    refined = basis + planes[:, 1:]
    middle = middle + margin
    phase = planes[:, 0] - refined @ middle
    return PhaseFit(refined, phase, places + middle, residuals, strength.mean(axis=0))


def _windows(n: int, basis: Basis) -> tuple[Values, Values]:
    """Centres of windows along an axis of n pixels, and their weights (count, n)."""
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
    """Fourier sums (2, windows) about the middle, a constant taken out, and means (windows,)."""
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


def _plane(turns: Values, strength: Values, places: Values, far: Values) -> tuple[Values, Values]:
    """A plane (offset, slopes) through phases in cycles, and what they deviate from it.

    Phases are followed outwards, from the nearest nine windows to all, each time as they are
    nearest to the plane through those before; large deviations count less (Cauchy's weight).
    """
    size = max(float(np.abs(places).max()), 1.0)
    model = np.concatenate([np.ones((len(places), 1)), places / size], axis=1)
    near = far <= np.sort(far)[min(8, far.size - 1)]
    plane = np.zeros(3)
    plane[0] = np.angle((strength * np.exp(2j * np.pi * turns))[near].sum()) / (2 * np.pi)
    reach = np.linspace(max(0.35, far[near].max()), 1, _ROUNDS // 2)
    for limit in np.append(reach, np.ones(_ROUNDS // 2)):
        left = turns - model @ plane
        left -= np.rint(left)
        weight = strength * (far <= limit) / (1 + (left / _OUTLIER) ** 2)
        normal = (model * weight[:, None]).T @ model
        plane += np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ (model.T @ (weight * left))
    left = turns - model @ plane
    return plane / [1, size, size], left - np.rint(left)
