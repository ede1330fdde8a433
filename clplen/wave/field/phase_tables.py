"""Phases in turns, reduced in double on the host before they become float32 tables.

``exp(i k z sqrt(1 - s))`` in float32 loses the field at camera distances. Every large phase of the
package is therefore a product of 1-D tables made here, times a small residual in the kernel.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Table = np.ndarray[Any, Any]


def phasor(turns: Any, dtype: Any = np.complex128) -> Table:
    """exp(2 pi i turns), reduced to half a turn in float64 and then rounded to ``dtype``."""
    reduced = np.asarray(turns, np.float64)
    reduced = reduced - np.rint(reduced)
    return np.exp(2j * np.pi * reduced).astype(dtype)


def split(values: Any, dtype: np.dtype[Any]) -> Table:
    """Float64 values as (high, low) pairs of ``dtype``, shape (..., 2)."""
    exact = np.asarray(values, np.float64)
    high = exact.astype(dtype)
    low = (exact - high.astype(np.float64)).astype(dtype)
    return np.stack([high, low], axis=-1)


def whole_and_part(values: Table, dtype: np.dtype[Any]) -> Table:
    """Float64 values as (nearest integer, rest) pairs of ``dtype``, shape (..., 2)."""
    exact = np.asarray(values, np.float64)
    whole = np.rint(exact)
    return np.stack([whole, exact - whole], axis=-1).astype(dtype)
