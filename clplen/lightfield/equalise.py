"""Lenslets of unequal light made alike, so that only their places are left to see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.reciprocal import Basis, Values, reduced

_BLOCK = 256  # rows at a time
_CORE = 0.35  # of a period: brightness is taken within, where no other lenslet reaches
_FULL = 0.6  # of the usual number of pixels: a lenslet that the picture does not cut much
_STEP = 0.03  # logarithm, where a difference begins to count less
_ROUNDS = 12
_MOST = 4.0  # times brighter or darker at most
_UNLIKE = 0.02  # of the light, by which lenslets differ where a pixel of both is told apart
# Places in a pixel (y, x), every one of another row and column.
_INSIDE = ((-0.375, -0.125), (-0.125, 0.375), (0.125, -0.375), (0.375, 0.125))


def equalised(picture: Values, cell: Basis, origin: Values) -> Values:
    """Every lenslet scaled to the same mean, and the fall of brightness within it taken off.

    The fall is the exponential of a polynomial of degree 4, fitted to the lenslets' means. A pixel
    on the border of two lenslets is scaled by the light of both, each by its share of the pixel.

    Parameters
    ----------
    picture : numpy.ndarray
        Shape (ny, nx).
    cell : numpy.ndarray
        Base vectors (y, x) of the lattice in pixels, as rows.
    origin : numpy.ndarray
        (y, x) of a lenslet's centre.

    Returns
    -------
    numpy.ndarray
        float32, shape (ny, nx): a pixel belongs to the lenslet whose centre is nearest. Lenslets
        that the picture cuts are not to be used.
    """
    short = reduced(cell)
    if short[0] @ short[1] < 0:
        short[1] *= -1
    corners = np.array([(y, x) for y in (0, picture.shape[0]) for x in (0, picture.shape[1])])
    places = np.rint((corners - origin) @ np.linalg.inv(short)).astype(int)
    low, high = places.min(0) - 2, places.max(0) + 3
    shape = tuple(int(n) for n in high - low)
    light: Values = np.zeros(shape[0] * shape[1])
    count: Values = np.zeros(shape[0] * shape[1])
    blocks = range(0, picture.shape[0], _BLOCK)
    lenslets = _Lenslets(short, origin, low, shape)
    columns = np.arange(picture.shape[1])
    for at in blocks:
        block = picture[at : at + _BLOCK]
        label, core = lenslets.nearest(np.arange(at, at + len(block))[:, None], columns)
        light += np.bincount(label[core], block[core], light.size)
        count += np.bincount(label[core], minlength=light.size)
    light, count = light.reshape(shape), count.reshape(shape)
    full = count > _FULL * np.median(count[count > 0])
    mean = np.log(np.maximum(light, 1e-30) / np.maximum(count, 1))
    at = origin + np.moveaxis(np.indices(shape), 0, -1) @ short + low @ short
    smooth, terms = _smooth(at, mean, full, picture.shape)
    own = _model(at, terms, picture.shape) @ smooth - mean
    own -= np.median(own[full])
    bright = np.exp(np.clip(-own, -np.log(_MOST), np.log(_MOST))).astype(np.float32).ravel()
    out = np.empty(picture.shape, np.float32)
    for start in blocks:
        block = picture[start : start + _BLOCK]
        y = np.arange(start, start + len(block))
        fall = _surface(y, columns, smooth, terms, picture.shape)
        out[y] = block / (_of_pixels(y, columns, bright, lenslets) * np.exp(fall))
    return out


@dataclass(frozen=True)
class _Lenslets:
    """Numbers of lenslets, row by row: the first has the place ``low`` on the lattice."""

    cell: Basis
    origin: Values
    low: Values
    shape: tuple[int, ...]

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


def _of_pixels(y: Values, x: Values, bright: Values, lenslets: _Lenslets) -> Values:
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
    parts = [bright[lenslets.nearest(y[i] + dy, x[k] + dx)[0]] for dy, dx in _INSIDE]
    light[of_two] = np.mean(parts, axis=0)
    return light


def _smooth(at: Values, mean: Values, full: Values, shape: Any) -> tuple[Values, list[Any]]:
    """Polynomial of the fall of brightness: its coefficients, up to a constant, and powers.

    Fitted to differences of the logarithms of lenslets two apart, which are alike where lenslets
    are dim in turns; differences that stand out (one bright, one dim) count less (Cauchy).
    """
    degree = 4 if full.sum() > 60 else 2
    terms = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a) if a + b]
    model = _model(at, terms, shape)
    pairs = [
        ((slice(2, None),), (slice(None, -2),)),
        ((slice(None), slice(2, None)), (slice(None), slice(None, -2))),
    ]
    both = [full[a] & full[b] for a, b in pairs]
    matrix = np.concatenate(
        [(model[a] - model[b])[ok] for (a, b), ok in zip(pairs, both, strict=True)]
    )
    step = np.concatenate([(mean[a] - mean[b])[ok] for (a, b), ok in zip(pairs, both, strict=True)])
    found: Values = np.zeros(len(terms))
    for _ in range(_ROUNDS if len(step) > 2 * len(terms) else 0):
        weight = 1 / (1 + ((step - matrix @ found) / _STEP) ** 2)
        weighted = (matrix * weight[:, None]).T
        found = np.linalg.pinv(weighted @ matrix, hermitian=True) @ (weighted @ step)
    return found, terms


def _model(at: Values, terms: list[Any], shape: tuple[int, ...]) -> Values:
    """Powers of places (y, x), scaled to the picture, the terms last."""
    y, x = (2 * at[..., axis] / shape[axis] - 1 for axis in (0, 1))
    return np.stack([y**a * x**b for a, b in terms], axis=-1)


def _surface(y: Values, x: Values, smooth: Values, terms: list[Any], shape: Any) -> Values:
    """The polynomial at all rows y and columns x, as a sum over products of powers, float32."""
    degree = max(a for a, _ in terms)
    factors = np.zeros((degree + 1, degree + 1))
    for (a, b), value in zip(terms, smooth, strict=True):
        factors[a, b] = value
    rows = (2 * y[:, None] / shape[0] - 1) ** np.arange(degree + 1)
    columns = (2 * x[:, None] / shape[1] - 1) ** np.arange(degree + 1)
    return np.asarray((rows @ factors @ columns.T).astype(np.float32))
