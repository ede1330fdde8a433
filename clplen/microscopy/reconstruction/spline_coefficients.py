"""Pictures as sums of cubic B-splines about their pixels.

    f[k] = (c[k - 1] + 4 c[k] + c[k + 1])/6

along either axis (Unser 1999). A sum of splines between the pixels is off by some
h^4 of the pixel h where f is smooth, cubic convolution by h^3 (Keys 1981).
"""

from __future__ import annotations

from typing import Any

import numpy as np

Vector = np.ndarray[Any, Any]

_BESIDE, _MIDDLE = 1 / 6, 2 / 3  # the spline at the next pixel and at its own


def spline_coefficients(pictures: Vector) -> Vector:
    """The coefficients c of B-splines that pass through all pixels; none lie outside a picture."""
    found = np.asarray(pictures, np.float64)
    for axis in (-1, -2):
        found = np.moveaxis(_along_last(np.moveaxis(found, axis, -1)), -1, axis)
    return found


def _along_last(values: Vector) -> Vector:
    """The same along the last axis."""
    from scipy.linalg import solveh_banded  # a slow import

    n = values.shape[-1]
    if n == 1:
        return values / _MIDDLE
    bands = np.array([np.full(n, _BESIDE), np.full(n, _MIDDLE)])
    lines = values.reshape(-1, n).T
    return np.asarray(solveh_banded(bands, lines, check_finite=False)).T.reshape(values.shape)
