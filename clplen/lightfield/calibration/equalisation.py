"""Equalisation of lenslets of unequal brightness, and the share of fall-off within them.

Filters, lamps and relays darken pixels of the sensor, so that each lenslet gets brighter on one
side; an objective that vignettes darkens each lenslet evenly. The lenslets' means do not separate
the two, but dividing by a slope that is absent moves all centres outwards.

Equal lenslets have the profile f(r), r from the centre. If too much of the fall exp(g r) was
divided out, by the share 1 - s, and the centres are off by d, linear in the position, the picture
is

    f(r) - (1 - s) (g r) f(r) - d grad f(r)

to first order. Least squares gives s and the six numbers of d: d acts at the rims of lenslets, s
everywhere. For a Gaussian profile grad f is proportional to r f, and s is indeterminate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clplen.lightfield.calibration.reciprocal import Basis, Values, reduced_basis

_BLOCK = 256  # rows at a time
_CORE = 0.35  # of a period: the area within which brightness is measured, free of other lenslets
# Of the median number of pixels: minimum for a lenslet that counts as complete
_MIN_COMPLETE_SHARE = 0.6
_STEP = 0.03  # residual in the logarithm at which the weight is one half
_ROUNDS = 12  # iterations of the reweighted fit
_MAX_FACTOR = 4.0  # largest factor of a lenslet's brightness
_MIN_BORDER_STEP = 0.02  # of the brightness: difference above which border pixels are supersampled
# Positions within a pixel (y, x), each in another row and column.
_SUBPIXELS = ((-0.375, -0.125), (-0.125, 0.375), (0.125, -0.375), (0.375, 0.125))


@dataclass(frozen=True)
class LensletIndex:
    """Numbering of lenslets row by row, from the lattice position ``low``."""

    cell: Basis
    origin: Values
    low: Values
    shape: tuple[int, ...]

    def centres(self, label: Values) -> Values:
        """Return the centres (..., 2), (y, x), of lenslets by their numbers."""
        i, k = np.divmod(label, self.shape[1])
        positions = np.stack([i, k], axis=-1) + self.low
        return np.asarray(self.origin + positions @ self.cell)

    def nearest(self, y: Values, x: Values) -> tuple[Values, Values]:
        """Return the nearest lenslet of (y, x), int32, and a mask of pixels far from its border."""
        inverse = np.linalg.inv(self.cell)
        y, x = y - self.origin[0], x - self.origin[1]
        a = (y * inverse[0, 0] + x * inverse[1, 0]).astype(np.float32)
        b = (y * inverse[0, 1] + x * inverse[1, 1]).astype(np.float32)
        i, k = np.rint(a), np.rint(b)
        first, second = self.cell
        if abs(first @ second) > 0.25 * (first @ first):  # hexagonal: three axes that add to 0
            third = np.rint(a + b)
            deviations = np.abs(i - a), np.abs(k - b), np.abs(third - a - b)
            along = (deviations[0] > deviations[1]) & (deviations[0] > deviations[2])
            across = ~along & (deviations[1] > deviations[2])
            i, k = np.where(along, third - k, i), np.where(across, third - i, k)
        core = (np.abs(a - i) < _CORE) & (np.abs(b - k) < _CORE)
        label = (i.astype(np.int32) - self.low[0]) * self.shape[1] + k.astype(np.int32)
        return (label - self.low[1]).astype(np.int32), core


@dataclass(frozen=True)
class FallOff:
    """Logarithm of the brightness as a polynomial of the position, up to a constant.

    ``factors`` [a, b] belongs to y**a x**b, with y and x scaled to -1 ... 1 over ``shape``.
    """

    factors: Values
    shape: tuple[int, ...]

    def at(self, positions: Values) -> Values:
        """Evaluate at positions (2, ...), (y, x) in pixels."""
        y, x = self._scaled(*positions)
        return np.asarray(np.polynomial.polynomial.polyval2d(y, x, self.factors))

    def slopes(self, positions: Values) -> Values:
        """Return the derivatives at positions (2, ...), shape (2, ...), in 1/pixel."""
        from numpy.polynomial.polynomial import polyder, polyval2d

        y, x = self._scaled(*positions)
        derivatives = (polyval2d(y, x, polyder(self.factors, axis=axis)) for axis in (0, 1))
        return np.stack(
            [2 * derivative / n for derivative, n in zip(derivatives, self.shape, strict=True)]
        )

    def over(self, y: Values, x: Values) -> Values:
        """Evaluate at all rows y and columns x, float32."""
        y, x = self._scaled(y, x)
        powers = np.arange(len(self.factors))
        rows, columns = y[:, None] ** powers, x[:, None] ** powers
        return np.asarray((rows @ self.factors @ columns.T).astype(np.float32))

    def _scaled(self, y: Values, x: Values) -> tuple[Values, Values]:
        return 2 * y / self.shape[0] - 1, 2 * x / self.shape[1] - 1


@dataclass(frozen=True)
class EqualisedPicture:
    """A picture of equalised lenslets, with their numbers and the fall that was divided out.

    In ``picture``, float32 (ny, nx), a pixel belongs to the nearest lenslet. Lenslets that the
    border cuts are invalid.
    """

    picture: Values
    lenslets: LensletIndex
    fall: FallOff


def equalise_lenslets(
    picture: Values, cell: Basis, origin: Values, share: float = 1.0
) -> EqualisedPicture:
    """Scale every lenslet to equal mean brightness and divide out the fall within it.

    The fall is the exponential of a polynomial of degree 4, fitted to the lenslets' means. A pixel
    on the border of two lenslets is scaled by both, each weighted by its share of the pixel.
    """
    lenslets = _lenslets(cell, origin, picture.shape)
    light: Values = np.zeros(lenslets.shape[0] * lenslets.shape[1])
    count: Values = np.zeros(light.size)
    blocks = range(0, picture.shape[0], _BLOCK)
    columns = np.arange(picture.shape[1])
    for at in blocks:
        block = picture[at : at + _BLOCK]
        label, core = lenslets.nearest(np.arange(at, at + len(block))[:, None], columns)
        light += np.bincount(label[core], block[core], light.size)
        count += np.bincount(label[core], minlength=light.size)
    light, count = light.reshape(lenslets.shape), count.reshape(lenslets.shape)
    full = count > _MIN_COMPLETE_SHARE * np.median(count[count > 0])
    mean = np.log(np.maximum(light, 1e-30) / np.maximum(count, 1))
    centres = lenslets.centres(np.arange(light.size)).reshape(*light.shape, 2)
    fall = _fit_fall_off(centres, mean, full, picture.shape)
    smooth = fall.at(np.moveaxis(centres, -1, 0))
    deviation = smooth - mean
    deviation -= np.median(deviation[full])
    deviation = (
        np.clip(-deviation, -np.log(_MAX_FACTOR), np.log(_MAX_FACTOR)) + (1 - share) * smooth
    )
    bright = np.exp(deviation).astype(np.float32).ravel()
    out = np.empty(picture.shape, np.float32)
    for start in blocks:
        block = picture[start : start + _BLOCK]
        y = np.arange(start, start + len(block))
        fall_off = np.exp(share * fall.over(y, columns))
        out[y] = block / (_pixel_brightness(y, columns, bright, lenslets) * fall_off)
    return EqualisedPicture(out, lenslets, fall)


def _pixel_brightness(y: Values, x: Values, bright: Values, lenslets: LensletIndex) -> Values:
    """Return the lenslet brightness at rows y and columns x, averaged over each pixel."""
    rows = np.concatenate([y[:1] - 1, y, y[-1:] + 1])
    light = bright[lenslets.nearest(rows[:, None], x)[0]]
    steps = np.abs(np.diff(light[:, 1:-1], axis=0)), np.abs(np.diff(light[1:-1], axis=1))
    light = light[1:-1]
    step = np.zeros_like(light)
    step[:, 1:-1] = np.maximum(steps[0][1:], steps[0][:-1])
    step[:, 1:] = np.maximum(step[:, 1:], steps[1])
    step[:, :-1] = np.maximum(step[:, :-1], steps[1])
    mixed = step > _MIN_BORDER_STEP * light
    i, k = np.nonzero(mixed)
    parts = [bright[lenslets.nearest(y[i] + dy, x[k] + dx)[0]] for dy, dx in _SUBPIXELS]
    light[mixed] = np.mean(parts, axis=0)
    return light


def _lenslets(cell: Basis, origin: Values, shape: tuple[int, ...]) -> LensletIndex:
    """Return the numbering of all lenslets in and near a picture."""
    short = reduced_basis(cell)
    if short[0] @ short[1] < 0:
        short[1] *= -1
    corners = np.array([(y, x) for y in (0, shape[0]) for x in (0, shape[1])])
    positions = np.rint((corners - origin) @ np.linalg.inv(short)).astype(int)
    low, high = positions.min(0) - 2, positions.max(0) + 3
    return LensletIndex(short, origin, low, tuple(int(n) for n in high - low))


def _fit_fall_off(centres: Values, mean: Values, full: Values, shape: tuple[int, ...]) -> FallOff:
    """Fit the fall of brightness, up to a constant.

    Fits log differences of lenslets two apart, robust to alternately dim ones (Cauchy weights).
    """
    degree = 4 if full.sum() > 60 else 2
    powers = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a) if a + b]
    y, x = (2 * centres[..., axis] / shape[axis] - 1 for axis in (0, 1))
    model = np.stack([y**a * x**b for a, b in powers], axis=-1)
    pairs = [
        ((slice(2, None),), (slice(None, -2),)),
        ((slice(None), slice(2, None)), (slice(None), slice(None, -2))),
    ]
    complete_pairs = [full[a] & full[b] for a, b in pairs]
    matrix = np.concatenate(
        [(model[a] - model[b])[ok] for (a, b), ok in zip(pairs, complete_pairs, strict=True)]
    )
    step = np.concatenate(
        [(mean[a] - mean[b])[ok] for (a, b), ok in zip(pairs, complete_pairs, strict=True)]
    )
    solution: Values = np.zeros(len(powers))
    for _ in range(_ROUNDS if len(step) > 2 * len(powers) else 0):
        weight = 1 / (1 + ((step - matrix @ solution) / _STEP) ** 2)
        weighted = (matrix * weight[:, None]).T
        solution = np.linalg.pinv(weighted @ matrix, hermitian=True) @ (weighted @ step)
    factors = np.zeros((degree + 1, degree + 1))
    factors[tuple(np.transpose(powers))] = solution
    return FallOff(factors, shape)


_MAX_PIXELS = 150_000  # pixels drawn at random, enough for the fit
_WIDTH = 0.5  # px: standard deviation of the smoothing of the profile
_MIN_LENSLET = 6.0  # px: minimum lenslet size with enough pixels for the fit
_MIN_ENERGY_SHARE = 0.15  # of the fall's energy: minimum part that no shift of the centres explains


def fall_off_share(even: EqualisedPicture, margin: int) -> float:
    """Return the share s, 0 to 1, of the fall of brightness within lenslets."""
    if np.hypot(*even.lenslets.cell.T).min() < _MIN_LENSLET:
        return 1.0
    position, value = _sample(even.picture, margin)
    label, core = even.lenslets.nearest(*position)
    position, value, centre = position[:, core], value[core], even.lenslets.centres(label[core]).T
    offsets = position - centre
    profile, slopes = _profile(offsets, value, even.lenslets.cell)
    fall = profile * (even.fall.slopes(centre) * offsets).sum(axis=0)
    half = (np.array(even.picture.shape)[:, None] - 1) / 2
    linear = np.stack([np.ones(len(value)), *(centre / half - 1)])
    shifts: Values = (slopes[:, None] * linear).reshape(6, -1)
    independent = fall - _fitted(shifts, fall)
    if not independent @ independent > _MIN_ENERGY_SHARE * (fall @ fall):
        return 1.0
    return float(np.clip(1 + independent @ (value - profile) / (independent @ independent), 0, 1))


def _sample(picture: Values, margin: int) -> tuple[Values, Values]:
    """Return positions (2, n) and values of all pixels, or of a fixed random subset."""
    inner = picture[margin : picture.shape[0] - margin, margin : picture.shape[1] - margin]
    selection = np.arange(inner.size)
    if inner.size > _MAX_PIXELS:
        selection = np.random.default_rng(0).integers(0, inner.size, _MAX_PIXELS)
    at = np.stack(np.divmod(selection, inner.shape[1])) + margin
    return at, picture[at[0], at[1]].astype(np.float64)


def _profile(away: Values, value: Values, cell: Values) -> tuple[Values, Values]:
    """Return the smoothed mean lenslet at positions (2, n) from the centre, and its gradient."""
    from scipy.ndimage import gaussian_filter

    pitch = float(np.hypot(*cell.T).max())
    n = int(np.clip(round(3 * pitch), 24, 96))
    inverse = np.linalg.inv(cell)
    index = np.rint(n * (inverse.T @ away)).astype(int) % n
    cell_index = index[0] * n + index[1]
    count = np.bincount(cell_index, minlength=n * n)
    total = np.bincount(cell_index, value, n * n)
    smoothed = [
        gaussian_filter(a.reshape(n, n).astype(float), _WIDTH * n / pitch, mode="wrap")
        for a in (total, count)
    ]
    table = smoothed[0] / np.maximum(smoothed[1], 1e-9)
    table = (table + np.roll(table[::-1, ::-1], (1, 1), (0, 1))) / 2  # lenslets are symmetric
    steps = [(np.roll(table, -1, axis) - np.roll(table, 1, axis)) * n / 2 for axis in (0, 1)]
    slopes = inverse @ np.stack([step.ravel()[cell_index] for step in steps])
    return table.ravel()[cell_index], slopes


def _fitted(rows: Values, value: Values) -> Values:
    """Return the linear combination of rows nearest to values."""
    return np.asarray(np.linalg.pinv(rows @ rows.T, hermitian=True) @ (rows @ value) @ rows)
