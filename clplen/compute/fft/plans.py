"""Caches of a device between calls: plans up to a limit in bytes, and shared working memory."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from clplen.compute.drivers.forked import Guard
from clplen.types import Array

T = TypeVar("T")


class PlanCache:
    """Cache of values with a limit in bytes; the least recently used are dropped first."""

    def __init__(self, limit_bytes: int, sibling: PlanCache | None = None) -> None:
        self.limit_bytes = limit_bytes
        self.hits = 0
        self.misses = 0
        self.nbytes = 0
        self._items: OrderedDict[tuple[PlanCache, Hashable], tuple[Any, int]] = OrderedDict()
        self._lock = Guard()
        if sibling is not None:
            self._items, self._lock = sibling._items, sibling._lock

    def __len__(self) -> int:
        return sum(owner is self for owner, _ in tuple(self._items))

    @property
    def shared_bytes(self) -> int:
        """Bytes of this cache and of its siblings."""
        with self._lock:
            return sum(nbytes for _, nbytes in self._items.values())

    def get(self, key: Hashable) -> Any:
        """Return the value of a key, or None."""
        entry = (self, key)
        with self._lock:
            if entry not in self._items:
                return None
            self.hits += 1
            self._items.move_to_end(entry)
            return self._items[entry][0]

    def keep(self, key: Hashable, value: T, nbytes: int) -> T:
        """Store a new value; return it, or the value that another thread stored first."""
        entry = (self, key)
        with self._lock:
            self.misses += 1
            if entry in self._items:
                stored: T = self._items[entry][0]
                return stored
            if nbytes <= self.limit_bytes:
                self._items[entry] = (value, nbytes)
                self.nbytes += nbytes
                while self.shared_bytes > self.limit_bytes:
                    (owner, _), (_, dropped) = self._items.popitem(last=False)
                    owner.nbytes -= dropped
        return value

    def clear(self) -> None:
        """Drop every value."""
        with self._lock:
            for entry in [entry for entry in self._items if entry[0] is self]:
                del self._items[entry]
            self.nbytes = 0


class Workspace:
    """Working memory that keeps the largest array returned so far, up to a limit."""

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self._buffer = np.empty(0, np.uint8)
        self._lock = Guard()

    @property
    def nbytes(self) -> int:
        """Bytes cached at present."""
        return self._buffer.nbytes

    def clear(self) -> None:
        """Free the cached memory."""
        with self._lock:
            self._buffer = np.empty(0, np.uint8)

    @contextmanager
    def borrow(self, shape: Sequence[int], dtype: np.dtype[Any]) -> Iterator[Array]:
        """Yield an uninitialised array; concurrent borrowers get different arrays."""
        nbytes = math.prod(shape) * dtype.itemsize
        with self._lock:
            buffer, self._buffer = self._buffer, np.empty(0, np.uint8)
        if buffer.nbytes < nbytes:
            buffer = np.empty(nbytes, np.uint8)
        try:
            yield buffer[:nbytes].view(dtype).reshape(shape)
        finally:
            with self._lock:
                if self._buffer.nbytes < buffer.nbytes <= self.limit_bytes:
                    self._buffer = buffer


class Slots:
    """Numbered scratch arrays of a thread, enlarged on demand."""

    def __init__(self) -> None:
        self._slots: dict[int, Array] = {}

    def take(self, slot: int, shape: Sequence[int], dtype: np.dtype[Any]) -> Array:
        """Return the array of a slot, uninitialised; its previous content is lost."""
        nbytes = math.prod(shape) * dtype.itemsize
        if slot not in self._slots or self._slots[slot].nbytes < nbytes:
            self._slots[slot] = np.empty(nbytes, np.uint8)
        return self._slots[slot][:nbytes].view(dtype).reshape(shape)
