"""Read and write Zarr stores with the package zarr, version 3, of the extra ``zarr``."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import install_advice
from clplen.errors import FormatError
from clplen.files import PathLike, filling
from clplen.io.formats.untrusted import Bound
from clplen.io.store.attributes import plain
from clplen.io.store.containers import Array, StoredArray
from clplen.outputs import MARK

SUFFIX = ".zarr"
MARKS = (".zgroup", ".zarray", "zarr.json")  # files that mark the root of a store
FORMAT_2: dict[str, Any] = {"zarr_format": 2}  # the format written; most programs read it
_MAX_RATIO = 32768.0  # of Zstandard: blocks of 128 KiB in 4 bytes (RFC 8878); others pack less
_MAX_SPARSITY = 4  # missing chunks hold the fill value: at least a quarter must be stored
_MAX_DEPTH = 4  # levels of nested groups that are listed
_FREE_MISSING_CHUNKS = 1000  # any array may lack so many chunks


def zarr_package(alternative: str) -> Any:
    """Import and return the package zarr; raise FormatError if it is missing or too old."""
    try:
        import zarr
    except ImportError as error:
        raise FormatError(
            f"Zarr needs the package zarr: {install_advice('zarr')}, or {alternative}."
        ) from error
    if zarr.__version__.startswith("2."):
        raise FormatError(
            f"Zarr needs the package zarr 3 (Python 3.11 or newer), got {zarr.__version__}, a "
            f"version that may run code in data: {install_advice('zarr')}, or {alternative}."
        )
    return zarr


@contextmanager
def open_checked(path: Path, alternative: str, max_bytes: int | None = None) -> Iterator[Any]:
    """Open a store to read and yield its root; its metadata and chunks are checked."""
    zarr_package(alternative)
    from clplen.io.store.zarr_store import open_store

    with open_store(path, max_bytes) as root:
        yield root


@contextmanager
def create_zarr(path: PathLike) -> Iterator[ZarrContainer]:
    """Create a store of Zarr format 2 with clplen's mark; it appears only when complete."""
    zarr = zarr_package("use .h5")
    with filling(path) as folder:
        store = zarr.storage.LocalStore(folder)  # a name may look like a URL
        group = zarr.open_group(store, mode="w", **FORMAT_2)
        group.attrs["software"] = MARK
        yield ZarrContainer(group, path)


class ZarrContainer:
    """Root of a Zarr store, a group or an array, as a `Container`."""

    def __init__(self, root: Any, path: PathLike) -> None:
        self.root, self.path = root, Path(path)
        self._array_class = zarr_package("use .h5").Array

    def _item(self, name: str) -> Any:
        """Return an array or group by its name, or None."""
        if isinstance(self.root, self._array_class):
            return None if name else self.root
        return self.root.get(name) if name else self.root

    def array(self, name: str) -> StoredArray | None:
        item = self._item(name)
        return self._stored(item) if isinstance(item, self._array_class) else None

    def arrays(self) -> dict[str, StoredArray]:
        with warnings.catch_warnings():  # about types and extensions unused in light fields
            warnings.simplefilter("ignore")
            return {
                array.name: array for array in map(self._stored, self._nested_arrays(self.root))
            }

    def _nested_arrays(self, group: Any, depth: int = _MAX_DEPTH) -> Iterator[Any]:
        yield from (array for _, array in group.arrays())
        for _, inner in group.groups() if depth else ():
            yield from self._nested_arrays(inner, depth - 1)

    def _stored(self, item: Any) -> StoredArray:
        name = str(item.path).strip("/")
        what = f"the dataset {name!r}" if name else "its array"
        return StoredArray(
            name,
            tuple(int(n) for n in item.shape),
            np.dtype(item.dtype),
            tuple(int(n) for n in item.chunks),
            item,
            self.path,
            lambda names: _attributes_of(item, names),
            lambda max_bytes: storage(item, self.path, what, max_bytes),
        )

    def group(self, name: str, attributes: Iterable[str]) -> dict[str, Any] | None:
        item = self._item(name)
        if item is None or isinstance(item, self._array_class):
            return None
        return _attributes_of(item, attributes)

    def write(
        self, name: str, values: Array, *, chunks: tuple[int, ...] | None = None, **attributes: Any
    ) -> None:
        array = zarr_package("use .h5").create(
            values.shape, chunks=chunks or values.shape, dtype=values.dtype,
            store=self.root.store, path=name, **FORMAT_2,
        )  # fmt: skip
        if chunks is None:
            array[...] = values
        else:  # part by part, without a copy of the whole
            for index, part in enumerate(values):
                array[index] = part
        array.attrs.update(attributes)

    def write_group(self, name: str, attributes: dict[str, Any]) -> None:
        self.root.create_group(name).attrs.update(attributes)


def _attributes_of(item: Any, names: Iterable[str]) -> dict[str, Any]:
    """Return the requested attributes of an array or group, leaving out missing ones."""
    stored = dict(item.attrs)
    return {name: plain(stored[name]) for name in names if name in stored}


def storage(array: Any, path: Path, what: str, max_bytes: int | None) -> Bound:
    """Return the bound on the size of an array; reject chunks that exceed it."""
    name = str(array.path).strip("/")
    inside = f"{name}/" if name else ""
    sizes = [size for key, size in array.store.sizes.items() if key.startswith(inside)]
    chunks = array.shards or array.chunks
    count = math.prod(-(-n // c) for n, c in zip(array.shape, chunks, strict=True))
    if count > _MAX_SPARSITY * len(sizes) + _FREE_MISSING_CHUNKS:
        raise FormatError(
            f"{path}: {what} has {count:,} chunks, but at most {len(sizes):,} are stored: the file "
            "is damaged or incomplete."
        )
    packing = array.store.arrays[name]
    Bound(path, sum(sizes), 1, max_bytes).require(
        packing.index_bytes, f"the index of a shard of {what}"
    )
    bound = Bound(
        path, sum(sizes), _MAX_RATIO if packing.packed else float(_MAX_SPARSITY), max_bytes
    )
    bound.require(math.prod(array.chunks) * np.dtype(array.dtype).itemsize, f"a chunk of {what}")
    return bound
