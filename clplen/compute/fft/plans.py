"""What stays on a device between calls: plans bounded in bytes, and working memory that is lent."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from clplen.compute.drivers.forked import Guard
from clplen.types import Array

T = TypeVar("T")


class PlanCache:
    """Values kept by key until their bytes exceed a limit (least recently used first out).

    Parameters
    ----------
    limit_bytes : int
        Sum of the sizes of the kept values. A single larger value is returned but not kept.

    Attributes
    ----------
    hits, misses : int
        How often a value was found and made.
    nbytes : int
        Bytes held now.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self.hits = 0
        self.misses = 0
        self.nbytes = 0
        self._items: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._lock = Guard()

    def __len__(self) -> int:
        return len(self._items)

    def get(self, key: Hashable, make: Callable[[], T], size: Callable[[T], int]) -> T:
        """The value of ``key``, made by ``make`` when it is not there.

        Parameters
        ----------
        key : hashable
            Everything that determines the value.
        make : callable
            Makes the value.
        size : callable
            Bytes that a value holds.
        """
        with self._lock:
            if key in self._items:
                self.hits += 1
                self._items.move_to_end(key)
                return self._items[key][0]
        value = make()
        nbytes = size(value)
        with self._lock:
            self.misses += 1
            if key in self._items:  # made by another thread meanwhile: one plan for both
                return self._items[key][0]
            if nbytes <= self.limit_bytes:
                self._items[key] = (value, nbytes)
                self.nbytes += nbytes
                while self.nbytes > self.limit_bytes:
                    _, (_, dropped) = self._items.popitem(last=False)
                    self.nbytes -= dropped
        return value

    def clear(self) -> None:
        """Drop every value."""
        with self._lock:
            self._items.clear()
            self.nbytes = 0


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
