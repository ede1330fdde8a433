"""A cache of plans bounded in bytes: what was used longest ago goes first."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from clplen.compute.drivers.forked import Guard

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
