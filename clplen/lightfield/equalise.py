"""Lenslets of unequal light made alike, so that only their places are left to see."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.lightfield.reciprocal import Basis, Values, reduced

_BLOCK = 256  # rows at a time
_FULL = 0.97  # of the largest number of pixels: a lenslet that the picture does not cut
_CUT = 0.2  # a lenslet that is cut has another mean by less than this logarithm
_MOST = 4.0  # times brighter or darker at most


def equalised(picture: Values, cell: Basis, origin: Values) -> Values:
    """Every lenslet scaled to the same mean, and the fall of brightness within it taken off.

    The fall is a polynomial of degree 4 through the logarithms of the lenslets' means.

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
        float32, shape (ny, nx): a pixel belongs to the lenslet whose centre is nearest.
    """
    short = reduced(cell)
    if short[0] @ short[1] < 0:
        short[1] *= -1
    corners = np.array([(y, x) for y in (0, picture.shape[0]) for x in (0, picture.shape[1])])
    places = np.rint((corners - origin) @ np.linalg.inv(short)).astype(int)
    low, high = places.min(0) - 2, places.max(0) + 3
    shape = tuple(int(n) for n in high - low)
    light, count = np.zeros(shape[0] * shape[1]), np.zeros(shape[0] * shape[1])
    blocks = range(0, picture.shape[0], _BLOCK)
    labels = [_labels(picture[at : at + _BLOCK].shape, at, short, origin, low, shape) for at in blocks]
    for at, label in zip(blocks, labels, strict=True):
        values = picture[at : at + _BLOCK].ravel()
        light += np.bincount(label.ravel(), values, light.size)
        count += np.bincount(label.ravel(), minlength=light.size)
    full = count > _FULL * count.max()
    mean = np.log(np.maximum(light, 1e-30) / np.maximum(count, 1))
    i, k = np.divmod(np.arange(light.size), shape[1])
    at = origin + np.stack([i + low[0], k + low[1]], axis=1) @ short
    smooth, terms = _smooth(at[full], mean[full], picture.shape)
    own = _model(*at.T, terms, picture.shape) @ smooth - mean
    own[~full & (np.abs(own) < _CUT)] = 0
    own[count == 0] = 0
    own = np.clip(own, -np.log(_MOST), np.log(_MOST)).astype(np.float32)
    out = np.empty(picture.shape, np.float32)
    for start, label in zip(blocks, labels, strict=True):
        block = picture[start : start + _BLOCK]
        y, x = np.arange(start, start + len(block)), np.arange(picture.shape[1])
        fall = _surface(y, x, smooth, terms, picture.shape)
        out[start : start + _BLOCK] = block * np.exp(own[label] - fall)
    return out


def _smooth(at: Values, mean: Values, shape: tuple[int, ...]) -> tuple[Values, list[Any]]:
    """Polynomial through logarithms of brightness: its coefficients and powers."""
    degree = 4 if len(at) > 60 else 2 if len(at) > 12 else 0
    terms = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]
    model = _model(*at.T, terms, shape)
    lit = mean > mean.max() - np.log(20)
    return np.linalg.lstsq(model[lit], mean[lit], rcond=None)[0], terms


def _model(y: Values, x: Values, terms: list[Any], shape: tuple[int, ...]) -> Values:
    y, x = 2 * y / shape[0] - 1, 2 * x / shape[1] - 1
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


def _labels(
    block: tuple[int, ...], at: int, cell: Basis, origin: Values, low: Values, shape: tuple[int, ...]
) -> Values:
    """Number of the nearest lenslet of every pixel of a block of rows, int32."""
    inverse = np.linalg.inv(cell)
    y = np.arange(at, at + block[0])[:, None] - origin[0]
    x = np.arange(block[1])[None, :] - origin[1]
    a = (y * inverse[0, 0] + x * inverse[1, 0]).astype(np.float32)
    b = (y * inverse[0, 1] + x * inverse[1, 1]).astype(np.float32)
    i, k = np.rint(a), np.rint(b)
    if abs(cell[0] @ cell[1]) > 0.25 * (cell[0] @ cell[0]):  # hexagons: three axes that add to 0
        third = np.rint(a + b)
        off = np.abs(i - a), np.abs(k - b), np.abs(third - a - b)
        first = (off[0] > off[1]) & (off[0] > off[2])
        second = ~first & (off[1] > off[2])
        i, k = np.where(first, third - k, i), np.where(second, third - i, k)
    return np.asarray((i.astype(np.int32) - low[0]) * shape[1] + k.astype(np.int32) - low[1])


