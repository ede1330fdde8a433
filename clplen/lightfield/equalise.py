"""Lenslets of unequal light made alike, so that only their places are left to see."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.lightfield.reciprocal import Basis, Values, reduced

_BLOCK = 256  # rows at a time
_CORE = 0.35  # of a period: brightness is taken within, where no other lenslet reaches
_FULL = 0.6  # of the usual number of pixels: a lenslet that the picture does not cut much
_STEP = 0.03  # logarithm, where a difference begins to count less
_ROUNDS = 12
_MOST = 4.0  # times brighter or darker at most


def equalised(picture: Values, cell: Basis, origin: Values) -> Values:
    """Every lenslet scaled to the same mean, and the fall of brightness within it taken off.

    The fall is the exponential of a polynomial of degree 4, fitted to the lenslets' means.

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
    labels = []
    for at in blocks:
        block = picture[at : at + _BLOCK]
        label, core = _labels(block.shape, at, short, origin, low, shape)
        light += np.bincount(label[core], block[core], light.size)
        count += np.bincount(label[core], minlength=light.size)
        labels.append(label)
    light, count = light.reshape(shape), count.reshape(shape)
    full = count > _FULL * np.median(count[count > 0])
    mean = np.log(np.maximum(light, 1e-30) / np.maximum(count, 1))
    at = origin + np.moveaxis(np.indices(shape), 0, -1) @ short + low @ short
    smooth, terms = _smooth(at, mean, full, picture.shape)
    own = _model(at, terms, picture.shape) @ smooth - mean
    own -= np.median(own[full])
    own = np.clip(own, -np.log(_MOST), np.log(_MOST)).astype(np.float32).ravel()
    out = np.empty(picture.shape, np.float32)
    for start, label in zip(blocks, labels, strict=True):
        block = picture[start : start + _BLOCK]
        y, x = np.arange(start, start + len(block)), np.arange(picture.shape[1])
        fall = _surface(y, x, smooth, terms, picture.shape)
        out[start : start + _BLOCK] = block * np.exp(own[label] - fall)
    return out


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


def _labels(
    block: tuple[int, ...],
    at: int,
    cell: Basis,
    origin: Values,
    low: Values,
    shape: tuple[int, ...],
) -> tuple[Values, Values]:
    """Number of every pixel's nearest lenslet, int32, for a block of rows; who is well inside."""
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
    core = (np.abs(a - i) < _CORE) & (np.abs(b - k) < _CORE)
    label = (i.astype(np.int32) - low[0]) * shape[1] + k.astype(np.int32) - low[1]
    return label.astype(np.int32), core
