"""HDF5 files and Zarr stores as one kind of container: arrays and groups with attributes, by name.

`clplen.io.store.hdf5_files` and `clplen.io.store.zarr_files` hold the two classes.
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
    """An array in an open container, none of whose samples were read."""

    name: str  # path in the container without slashes around it; empty if it is all of a store
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    chunks: tuple[int, ...] | None
    item: Any  # h5py.Dataset or zarr.Array
    path: Path  # of the container
    # Returns some attributes as plain Python, without missing ones.
    attributes: Callable[[Iterable[str]], dict[str, Any]]
    # Returns what the container can hold of the array, each of whose chunks has to fit.
    storage: Callable[[int | None], Bound]

    @property
    def what(self) -> str:
        """The array as the subject of a sentence."""
        return f"the dataset {self.name!r}" if self.name else "its array"

    @property
    def nbytes(self) -> int:
        """Bytes of all samples."""
        return math.prod(self.shape) * self.dtype.itemsize

    def require_numbers(self, largest: int) -> None:
        """Refuse an array of anything but real numbers, or of too many samples."""
        if self.dtype.kind not in "buif" or math.prod(self.shape) > largest:
            raise FormatError(
                f"{self.path}: {self.what} of shape {self.shape} holds {self.dtype}, not up to "
                f"{largest} real numbers."
            )

    def load(self, max_bytes: int | None) -> Array:
        """Read all samples; refuse more than the container or the memory can hold."""
        self.storage(max_bytes).require(self.nbytes, self.what)
        return np.asarray(self.item[...])


class Container(Protocol):
    """An HDF5 file or a Zarr store that is open."""

    path: Path

    def array(self, name: str) -> StoredArray | None:
        """Return an array; None where there is none of this name."""

    def arrays(self) -> dict[str, StoredArray]:
        """Return all arrays by their names."""

    def group(self, name: str, attributes: Iterable[str]) -> dict[str, Any] | None:
        """Return some attributes of a group; None where there is no group."""

    def write(
        self, name: str, values: Array, *, chunks: tuple[int, ...] | None = None, **attributes: Any
    ) -> None:
        """Write an array; HDF5 keeps it as a whole, whatever the chunks."""

    def write_group(self, name: str, attributes: dict[str, Any]) -> None:
        """Make a group with attributes."""
