"""Host memory that is used again: fresh pages cost as much as a pass over them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from clplen.compute.drivers.forked import Guard
from clplen.types import Array


class Workspace:
    """Keeps the largest array lent so far, up to a limit, for the next borrower.

    Parameters
    ----------
    limit_bytes : int
        A larger array is lent but not kept.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self._kept = np.empty(0, np.uint8)
        self._lock = Guard()

    @property
    def nbytes(self) -> int:
        """Bytes held now."""
        return self._kept.nbytes

    def clear(self) -> None:
        """Give back what is kept."""
        with self._lock:
            self._kept = np.empty(0, np.uint8)

    @contextmanager
    def borrow(self, shape: Sequence[int], dtype: np.dtype[Any]) -> Iterator[Array]:
        """An uninitialised array; what two borrowers at a time get is never the same.

        Parameters
        ----------
        shape : sequence of int
        dtype : numpy.dtype
        """
        wanted = math.prod(shape) * dtype.itemsize
        with self._lock:
            buffer, self._kept = self._kept, np.empty(0, np.uint8)
        if buffer.nbytes < wanted:
            buffer = np.empty(wanted, np.uint8)
        try:
            yield buffer[:wanted].view(dtype).reshape(shape)
        finally:
            with self._lock:
                if self._kept.nbytes < buffer.nbytes <= self.limit_bytes:
                    self._kept = buffer


class Slots:
    """The numbered scratch arrays of one thread, grown when needed."""

    def __init__(self) -> None:
        self._slots: dict[int, Array] = {}

    def take(self, slot: int, shape: Sequence[int], dtype: np.dtype[Any]) -> Array:
        """The array of a slot, uninitialised; what it held before is lost."""
        wanted = math.prod(shape) * dtype.itemsize
        if slot not in self._slots or self._slots[slot].nbytes < wanted:
            self._slots[slot] = np.empty(wanted, np.uint8)
        return self._slots[slot][:wanted].view(dtype).reshape(shape)
