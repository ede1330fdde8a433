"""Lenslets of unequal light made alike, and how much of the fall-off goes on within them.

A filter, a lamp or a relay darkens the sensor's pixels, so that lenslets are brighter on one side;
an objective that vignettes darkens every lenslet as a whole. The means of the lenslets do not tell
the two apart, but a slope that is taken off and is not there moves all centres outwards.

Of equal lenslets of the profile f(r), r from the centre, whose fall exp(g r) was taken off too
much by the share 1 - s, and whose centres are off by d, linear in the place, the picture is

    f(r) - (1 - s) (g r) f(r) - d grad f(r)

to first order. s and the six numbers of d follow by least squares: d shows at the rims of lenslets,
s all over them. Of a Gaussian profile grad f is r f up to a factor, and s cannot be told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clplen.lightfield.calibration.reciprocal import Basis, Values, reduced_basis

_BLOCK = 256  # rows at a time
_CORE = 0.35  # of a period: brightness is taken within, where no other lenslet reaches
_FULL = 0.6  # of the usual number of pixels: a lenslet that the picture does not cut much
_STEP = 0.03  # logarithm, where a difference begins to count less
_ROUNDS = 12
_MOST = 4.0  # times brighter or darker at most
_UNLIKE = 0.02  # of the light, by which lenslets differ where a pixel of both is told apart
# Places in a pixel (y, x), every one of another row and column.
_SUBPIXELS = ((-0.375, -0.125), (-0.125, 0.375), (0.125, -0.375), (0.375, 0.125))


@dataclass(frozen=True)
class LensletIndex:
    """Numbers of lenslets, row by row: the first has the place ``low`` on the lattice."""

    cell: Basis
    origin: Values
    low: Values
    shape: tuple[int, ...]

    def centres(self, label: Values) -> Values:
        """(y, x) of the centres of lenslets by their numbers, (..., 2)."""
        i, k = np.divmod(label, self.shape[1])
        places = np.stack([i, k], axis=-1) + self.low
        return np.asarray(self.origin + places @ self.cell)

    def nearest(self, y: Values, x: Values) -> tuple[Values, Values]:
        """Number of the lenslet nearest to (y, x), int32, and whether its border is far."""
        inverse = np.linalg.inv(self.cell)
        y, x = y - self.origin[0], x - self.origin[1]
        a = (y * inverse[0, 0] + x * inverse[1, 0]).astype(np.float32)
        b = (y * inverse[0, 1] + x * inverse[1, 1]).astype(np.float32)
        i, k = np.rint(a), np.rint(b)
        first, second = self.cell
        if abs(first @ second) > 0.25 * (first @ first):  # hexagons: three axes that add to 0
            third = np.rint(a + b)
            off = np.abs(i - a), np.abs(k - b), np.abs(third - a - b)
            along = (off[0] > off[1]) & (off[0] > off[2])
            across = ~along & (off[1] > off[2])
            i, k = np.where(along, third - k, i), np.where(across, third - i, k)
        core = (np.abs(a - i) < _CORE) & (np.abs(b - k) < _CORE)
        label = (i.astype(np.int32) - self.low[0]) * self.shape[1] + k.astype(np.int32)
        return (label - self.low[1]).astype(np.int32), core


@dataclass(frozen=True)
class FallOff:
    """Logarithm of the brightness as a polynomial of places, up to a constant.

    ``factors`` [a, b] belongs to y**a x**b, y and x from -1 to 1 over a picture of a ``shape``.
    """

    factors: Values
    shape: tuple[int, ...]

    def at(self, places: Values) -> Values:
        """At places (2, ...), (y, x) in pixels."""
        y, x = self._scaled(*places)
        return np.asarray(np.polynomial.polynomial.polyval2d(y, x, self.factors))

    def slopes(self, places: Values) -> Values:
        """Its derivatives at places (2, ...), (2, ...), 1/pixel."""
        from numpy.polynomial.polynomial import polyder, polyval2d

        y, x = self._scaled(*places)
        ways = (polyval2d(y, x, polyder(self.factors, axis=axis)) for axis in (0, 1))
        return np.stack([2 * way / n for way, n in zip(ways, self.shape, strict=True)])

    def over(self, y: Values, x: Values) -> Values:
        """At all rows y and columns x, as a sum over products of powers, float32."""
        y, x = self._scaled(y, x)
        powers = np.arange(len(self.factors))
        rows, columns = y[:, None] ** powers, x[:, None] ** powers
        return np.asarray((rows @ self.factors @ columns.T).astype(np.float32))

    def _scaled(self, y: Values, x: Values) -> tuple[Values, Values]:
        return 2 * y / self.shape[0] - 1, 2 * x / self.shape[1] - 1


@dataclass(frozen=True)
class EqualisedPicture:
    """A picture whose lenslets are alike, with their numbers and the fall that was taken off.

    ``picture`` float32, shape (ny, nx): a pixel belongs to the lenslet whose centre is nearest.
    Lenslets that the picture cuts are not to be used.
    """

    picture: Values
    lenslets: LensletIndex
    fall: FallOff


def equalise_lenslets(
    picture: Values, cell: Basis, origin: Values, share: float = 1.0
) -> EqualisedPicture:
    """Every lenslet scaled to the same mean, and the fall of brightness within it taken off.

    The fall is the exponential of a polynomial of degree 4, fitted to the lenslets' means. A pixel
    on the border of two lenslets is scaled by the light of both, each by its share of the pixel.
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
    full = count > _FULL * np.median(count[count > 0])
    mean = np.log(np.maximum(light, 1e-30) / np.maximum(count, 1))
    centres = lenslets.centres(np.arange(light.size)).reshape(*light.shape, 2)
    fall = _fit_fall_off(centres, mean, full, picture.shape)
    smooth = fall.at(np.moveaxis(centres, -1, 0))
    own = smooth - mean
    own -= np.median(own[full])
    own = np.clip(-own, -np.log(_MOST), np.log(_MOST)) + (1 - share) * smooth
    bright = np.exp(own).astype(np.float32).ravel()
    out = np.empty(picture.shape, np.float32)
    for start in blocks:
        block = picture[start : start + _BLOCK]
        y = np.arange(start, start + len(block))
        over = np.exp(share * fall.over(y, columns))
        out[y] = block / (_pixel_brightness(y, columns, bright, lenslets) * over)
    return EqualisedPicture(out, lenslets, fall)


def _pixel_brightness(y: Values, x: Values, bright: Values, lenslets: LensletIndex) -> Values:
    """Brightness of the lenslets in all pixels of rows y and columns x, means over a pixel."""
    rows = np.concatenate([y[:1] - 1, y, y[-1:] + 1])
    light = bright[lenslets.nearest(rows[:, None], x)[0]]
    steps = np.abs(np.diff(light[:, 1:-1], axis=0)), np.abs(np.diff(light[1:-1], axis=1))
    light = light[1:-1]
    step = np.zeros_like(light)
    step[:, 1:-1] = np.maximum(steps[0][1:], steps[0][:-1])
    step[:, 1:] = np.maximum(step[:, 1:], steps[1])
    step[:, :-1] = np.maximum(step[:, :-1], steps[1])
    of_two = step > _UNLIKE * light
    i, k = np.nonzero(of_two)
    parts = [bright[lenslets.nearest(y[i] + dy, x[k] + dx)[0]] for dy, dx in _SUBPIXELS]
    light[of_two] = np.mean(parts, axis=0)
    return light


def _lenslets(cell: Basis, origin: Values, shape: tuple[int, ...]) -> LensletIndex:
    """Numbers for all lenslets near a picture."""
    short = reduced_basis(cell)
    if short[0] @ short[1] < 0:
        short[1] *= -1
    corners = np.array([(y, x) for y in (0, shape[0]) for x in (0, shape[1])])
    places = np.rint((corners - origin) @ np.linalg.inv(short)).astype(int)
    low, high = places.min(0) - 2, places.max(0) + 3
    return LensletIndex(short, origin, low, tuple(int(n) for n in high - low))


def _fit_fall_off(at: Values, mean: Values, full: Values, shape: tuple[int, ...]) -> FallOff:
    """The fall of brightness, up to a constant.

    Fitted to differences of the logarithms of lenslets two apart, which are alike where lenslets
    are dim in turns; differences that stand out (one bright, one dim) count less (Cauchy).
    """
    degree = 4 if full.sum() > 60 else 2
    powers = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a) if a + b]
    y, x = (2 * at[..., axis] / shape[axis] - 1 for axis in (0, 1))
    model = np.stack([y**a * x**b for a, b in powers], axis=-1)
    pairs = [
        ((slice(2, None),), (slice(None, -2),)),
        ((slice(None), slice(2, None)), (slice(None), slice(None, -2))),
    ]
    both = [full[a] & full[b] for a, b in pairs]
    matrix = np.concatenate(
        [(model[a] - model[b])[ok] for (a, b), ok in zip(pairs, both, strict=True)]
    )
    step = np.concatenate([(mean[a] - mean[b])[ok] for (a, b), ok in zip(pairs, both, strict=True)])
    found: Values = np.zeros(len(powers))
    for _ in range(_ROUNDS if len(step) > 2 * len(powers) else 0):
        weight = 1 / (1 + ((step - matrix @ found) / _STEP) ** 2)
        weighted = (matrix * weight[:, None]).T
        found = np.linalg.pinv(weighted @ matrix, hermitian=True) @ (weighted @ step)
    factors = np.zeros((degree + 1, degree + 1))
    factors[tuple(np.transpose(powers))] = found
    return FallOff(factors, shape)


_PIXELS = 150_000  # at random, that are enough
_WIDTH = 0.5  # px: standard deviation of the smoothing of the profile
_SMALL = 6.0  # px: smaller lenslets have too few pixels to tell
_OWN = 0.15  # of the fall's energy that no shift of the centres explains: less tells nothing


def fall_off_share(even: EqualisedPicture, margin: int) -> float:
    """The share s of the fall that goes on within lenslets, 0 to 1."""
    if np.hypot(*even.lenslets.cell.T).min() < _SMALL:
        return 1.0
    at, value = _sample(even.picture, margin)
    label, core = even.lenslets.nearest(*at)
    at, value, centre = at[:, core], value[core], even.lenslets.centres(label[core]).T
    away = at - centre
    profile, slopes = _profile(away, value, even.lenslets.cell)
    fall = profile * (even.fall.slopes(centre) * away).sum(axis=0)
    half = (np.array(even.picture.shape)[:, None] - 1) / 2
    place = np.stack([np.ones(len(value)), *(centre / half - 1)])
    shifts: Values = (slopes[:, None] * place).reshape(6, -1)
    only = fall - _fitted(shifts, fall)
    if not only @ only > _OWN * (fall @ fall):
        return 1.0
    return float(np.clip(1 + only @ (value - profile) / (only @ only), 0, 1))


def _sample(picture: Values, margin: int) -> tuple[Values, Values]:
    """Places (2, n) and values of all pixels, of many ones chosen at random, always the same."""
    whole = picture[margin : picture.shape[0] - margin, margin : picture.shape[1] - margin]
    chosen = np.arange(whole.size)
    if whole.size > _PIXELS:
        chosen = np.random.default_rng(0).integers(0, whole.size, _PIXELS)
    at = np.stack(np.divmod(chosen, whole.shape[1])) + margin
    return at, picture[at[0], at[1]].astype(np.float64)


def _profile(away: Values, value: Values, cell: Values) -> tuple[Values, Values]:
    """The mean lenslet f at places (2, n) from the centre, and its gradient (2, n), smoothed."""
    from scipy.ndimage import gaussian_filter

    pitch = float(np.hypot(*cell.T).max())
    n = int(np.clip(round(3 * pitch), 24, 96))
    inverse = np.linalg.inv(cell)
    index = np.rint(n * (inverse.T @ away)).astype(int) % n
    where = index[0] * n + index[1]
    count = np.bincount(where, minlength=n * n)
    total = np.bincount(where, value, n * n)
    soft = [
        gaussian_filter(a.reshape(n, n).astype(float), _WIDTH * n / pitch, mode="wrap")
        for a in (total, count)
    ]
    table = soft[0] / np.maximum(soft[1], 1e-9)
    table = (table + np.roll(table[::-1, ::-1], (1, 1), (0, 1))) / 2  # lenslets are symmetric
    steps = [(np.roll(table, -1, axis) - np.roll(table, 1, axis)) * n / 2 for axis in (0, 1)]
    slopes = inverse @ np.stack([step.ravel()[where] for step in steps])
    return table.ravel()[where], slopes


def _fitted(rows: Values, value: Values) -> Values:
    """The sum of rows that is nearest to values."""
    return np.asarray(np.linalg.pinv(rows @ rows.T, hermitian=True) @ (rows @ value) @ rows)
