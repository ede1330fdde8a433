"""A lattice to a thousandth of its pitch: least squares on local phases of its Fourier orders.

A pattern of period given by the reciprocal vectors g_1, g_2, with a lenslet centred at r_0, has in
a window about r_t the Fourier sums

    C_j(t) = sum_r w(r - r_t) I(r) exp(-2 pi i g_j r),      arg C_j = -2 pi g_j r_0

for every t if g_j is right; if it is off by e_j, the phase in cycles runs as e_j r_t. Brightness
that changes from lenslet to lenslet does not move the phase of a sum over points of the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clplen.lightfield.arrays.reciprocal import Basis, Values

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


def refine(picture: Values, basis: Basis, *, margin: int = 0) -> PhaseFit:
    """PhaseFit an affine lattice, from the middle of a picture outwards.

    Parameters
    ----------
    picture : numpy.ndarray
        Shape (ny, nx), linear in the light.
    basis : numpy.ndarray
        Two reciprocal vectors as rows, near enough to be followed over a few windows.
    margin : int
        Pixels along the picture's border that are left out.

    Returns
    -------
    PhaseFit
    """
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
