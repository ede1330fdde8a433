"""float64 twins of the maps along an axis: explicit matrices of what a `Line` says it does.

The matrices come from the definitions, sums of exponentials; no FFT is used. Nothing here imports
the package under test: a line is anything with the attributes of `clplen.compute.fft.lines.Line`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def dft_matrix(length: int) -> np.ndarray:
    """exp(-2 pi i jk/L), its argument reduced in integers."""
    k = np.arange(length)
    return np.exp(-2j * np.pi * (np.outer(k, k) % length) / length)


def matrix(line: Any) -> np.ndarray:
    """The (m, n) matrix of a line: factors, place, transform, cut, factors."""
    if line.kind == "none":
        return np.eye(line.n, dtype=complex)
    placed = np.zeros((line.length, line.n), complex)
    placed[line.offset + np.arange(line.n), np.arange(line.n)] = 1
    if line.pre is not None:
        placed = placed * line.pre
    forward = dft_matrix(line.length)
    back = forward.conj() / line.length
    if line.kind == "convolve":
        made = back @ (line.kernel[:, None] * (forward @ placed))
    else:
        made = (forward if line.kind == "forward" else back) @ placed
    kept = made[line.start : line.start + line.m]
    return kept if line.post is None else line.post[:, None] * kept


def apply(u: np.ndarray, y: Sequence[Any], x: Sequence[Any]) -> np.ndarray:
    """Maps of both axes on u (..., ny, nx), in float64."""
    u = np.asarray(u, complex)
    for line in y:
        u = np.einsum("ij,...jk->...ik", matrix(line), u)
    for line in x:
        u = np.einsum("ij,...kj->...ki", matrix(line), u)
    return u


def unfolded(quadrant: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The spectrum (my, mx) that is even in both axes, from its quadrant."""
    if quadrant.shape == shape:
        return quadrant
    y, x = (np.minimum(np.arange(n), n - np.arange(n)) for n in shape)
    return quadrant[np.ix_(y, x)]
