"""What stays on a device between calls: plans bounded in bytes, and working memory that is lent."""

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
    """Values kept by key until their bytes exceed a limit (least recently used first out)."""

    def __init__(self, limit_bytes: int, beside: PlanCache | None = None) -> None:
        self.limit_bytes = limit_bytes
        self.hits = 0
        self.misses = 0
        self.nbytes = 0
        self._items: OrderedDict[tuple[PlanCache, Hashable], tuple[Any, int]] = OrderedDict()
        self._lock = Guard()
        if beside is not None:
            self._items, self._lock = beside._items, beside._lock

    def __len__(self) -> int:
        return sum(owner is self for owner, _ in tuple(self._items))

    @property
    def shared_bytes(self) -> int:
        """Bytes held by this cache and by those beside it."""
        with self._lock:
            return sum(nbytes for _, nbytes in self._items.values())

    def get(self, key: Hashable) -> Any:
        """Return the value of ``key``, or None."""
        place = (self, key)
        with self._lock:
            if place not in self._items:
                return None
            self.hits += 1
            self._items.move_to_end(place)
            return self._items[place][0]

    def keep(self, key: Hashable, value: T, nbytes: int) -> T:
        """Keep a new value; return it, or that of another thread which was faster."""
        place = (self, key)
        with self._lock:
            self.misses += 1
            if place in self._items:
                other: T = self._items[place][0]
                return other
            if nbytes <= self.limit_bytes:
                self._items[place] = (value, nbytes)
                self.nbytes += nbytes
                while self.shared_bytes > self.limit_bytes:
                    (owner, _), (_, dropped) = self._items.popitem(last=False)
                    owner.nbytes -= dropped
        return value

    def clear(self) -> None:
        """Drop every value."""
        with self._lock:
            for place in [place for place in self._items if place[0] is self]:
                del self._items[place]
            self.nbytes = 0


class Workspace:
    """Keeps the largest array lent so far, up to a limit, for the next borrower."""

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
        """An uninitialised array; what two borrowers at a time get is never the same."""
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
