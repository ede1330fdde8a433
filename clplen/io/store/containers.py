"""A common interface to HDF5 files and Zarr stores: named arrays and groups with attributes.

`clplen.io.store.hdf5_files` and `clplen.io.store.zarr_files` define the two classes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from clplen.errors import FormatError
from clplen.io.formats.untrusted import Bound

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class StoredArray:
    """Array in an open container, whose samples have not been read."""

    name: str  # path in the container without outer slashes; empty for the root
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    chunks: tuple[int, ...] | None
    item: Any  # h5py.Dataset or zarr.Array
    path: Path  # file or folder of the container
    # Return the requested attributes as plain Python, leaving out missing ones.
    attributes: Callable[[Iterable[str]], dict[str, Any]]
    # Return the bound on the size of the array; reject chunks that exceed it.
    storage: Callable[[int | None], Bound]

    @property
    def what(self) -> str:
        """Name of the array as the subject of a sentence."""
        return f"the dataset {self.name!r}" if self.name else "its array"

    @property
    def nbytes(self) -> int:
        """Size of all samples in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    def require_numbers(self, largest: int) -> None:
        """Raise FormatError unless the array holds at most ``largest`` real numbers."""
        if self.dtype.kind not in "buif" or math.prod(self.shape) > largest:
            raise FormatError(
                f"{self.path}: {self.what} must hold at most {largest} real numbers, got dtype "
                f"{self.dtype} and shape {self.shape}."
            )

    def load(self, max_bytes: int | None) -> Array:
        """Read all samples; raise an error if they exceed the container or the memory."""
        self.storage(max_bytes).require(self.nbytes, self.what)
        return np.asarray(self.item[...])


class Container(Protocol):
    """Open HDF5 file or Zarr store."""

    path: Path

    def array(self, name: str) -> StoredArray | None:
        """Return an array by its name, or None."""

    def arrays(self) -> dict[str, StoredArray]:
        """Return all arrays by their names."""

    def group(self, name: str, attributes: Iterable[str]) -> dict[str, Any] | None:
        """Return the requested attributes of a group, or None if it does not exist."""

    def write(
        self, name: str, values: Array, *, chunks: tuple[int, ...] | None = None, **attributes: Any
    ) -> None:
        """Write an array; HDF5 ignores ``chunks``."""

    def write_group(self, name: str, attributes: dict[str, Any]) -> None:
        """Create a group with attributes."""
