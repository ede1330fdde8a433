"""Zarr stores: the package zarr, version 3, of the extra ``zarr``, and what a store declares."""

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
MARKS = (".zgroup", ".zarray", "zarr.json")  # one of them lies in the root of a store
FORMAT_2: dict[str, Any] = {"zarr_format": 2}  # what is written, and what most programs read
_RATIO = 32768.0  # of Zstandard, blocks of 128 KiB in 4 bytes (RFC 8878); others pack less
_SPARSE = 4  # chunks that are not there hold the fill value: a quarter has to be there
_DEPTH = 4  # groups in groups that are looked into
_FEW = 1000  # chunks that any array may lack


def zarr_package(instead: str) -> Any:
    """The package, imported when it is needed."""
    try:
        import zarr
    except ImportError as error:
        raise FormatError(
            f"Zarr needs the package zarr: {install_advice('zarr')}, or {instead}."
        ) from error
    if zarr.__version__.startswith("2."):
        raise FormatError(
            f"Zarr needs the package zarr 3 (Python 3.11 or newer), not {zarr.__version__}, which "
            f"runs code that data contain: {install_advice('zarr')}, or {instead}."
        )
    return zarr


@contextmanager
def opened_store(path: Path, instead: str, max_bytes: int | None = None) -> Iterator[Any]:
    """The root of a store to read, a group or an array, whose metadata and chunks are checked."""
    zarr_package(instead)
    from clplen.io.store.zarr_store import open_store

    with open_store(path, max_bytes) as root:
        yield root


@contextmanager
def created_store(path: PathLike) -> Iterator[ZarrContainer]:
    """Make a new store of Zarr format 2 with clplen's mark, which appears whole or not at all."""
    zarr = zarr_package("use .h5")
    with filling(path) as folder:
        store = zarr.storage.LocalStore(folder)  # a name may look like an address
        group = zarr.open_group(store, mode="w", **FORMAT_2)
        group.attrs["software"] = MARK
        yield ZarrContainer(group, path)


class ZarrContainer:
    """A group or an array that is the root of a Zarr store, as a `Container`."""

    def __init__(self, root: Any, path: PathLike) -> None:
        self.root, self.path = root, Path(path)
        self._array_class = zarr_package("use .h5").Array

    def _item(self, name: str) -> Any:
        """Return an array or group; None where there is none."""
        if isinstance(self.root, self._array_class):
            return None if name else self.root
        return self.root.get(name) if name else self.root

    def array(self, name: str) -> StoredArray | None:
        item = self._item(name)
        return self._stored(item) if isinstance(item, self._array_class) else None

    def arrays(self) -> dict[str, StoredArray]:
        with warnings.catch_warnings():  # about types and extensions that no light field has
            warnings.simplefilter("ignore")
            return {array.name: array for array in map(self._stored, self._inside(self.root))}

    def _inside(self, group: Any, depth: int = _DEPTH) -> Iterator[Any]:
        yield from (array for _, array in group.arrays())
        for _, inner in group.groups() if depth else ():
            yield from self._inside(inner, depth - 1)

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
        else:  # part by part, so that no second copy of all is made
            for index, part in enumerate(values):
                array[index] = part
        array.attrs.update(attributes)

    def write_group(self, name: str, attributes: dict[str, Any]) -> None:
        self.root.create_group(name).attrs.update(attributes)


def _attributes_of(item: Any, names: Iterable[str]) -> dict[str, Any]:
    """Return some attributes of an array or group as plain Python, without missing ones."""
    stored = dict(item.attrs)
    return {name: plain(stored[name]) for name in names if name in stored}


def storage(array: Any, path: Path, what: str, max_bytes: int | None) -> Bound:
    """What a store can hold of an array, each of whose chunks has to fit."""
    name = str(array.path).strip("/")
    inside = f"{name}/" if name else ""
    sizes = [size for key, size in array.store.sizes.items() if key.startswith(inside)]
    chunks = array.shards or array.chunks
    count = math.prod(-(-n // c) for n, c in zip(array.shape, chunks, strict=True))
    if count > _SPARSE * len(sizes) + _FEW:
        raise FormatError(
            f"{path}: {what} has {count:,} chunks, of which at most {len(sizes):,} are there: it "
            "is damaged or incomplete."
        )
    packing = array.store.arrays[name]
    Bound(path, sum(sizes), 1, max_bytes).require(
        packing.index_bytes, f"the index of a shard of {what}"
    )
    bound = Bound(path, sum(sizes), _RATIO if packing.packed else float(_SPARSE), max_bytes)
    bound.require(math.prod(array.chunks) * np.dtype(array.dtype).itemsize, f"a chunk of {what}")
    return bound
