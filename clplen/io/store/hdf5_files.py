"""Open untrusted HDF5 files, read them within bounds, and check their compression."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike, replacing, require_file
from clplen.hdf5_safety import members, require_heaps, require_internal
from clplen.io.formats.untrusted import DEFLATE, Bound, listed, reading
from clplen.io.store.attributes import plain
from clplen.io.store.containers import Array, StoredArray
from clplen.outputs import MARK

SUFFIXES = (".h5", ".hdf5")
MAGIC = b"\x89HDF\r\n\x1a\n"
_MAX_ATTRIBUTE_BYTES = 1 << 16  # HDF5's limit for an attribute in an object header
_MAX_SPARSITY = 4.0  # unwritten chunks hold the fill value: at least a quarter must be written
# Largest compression ratios of filters by number (HDF5 registry). SZIP codes up to 64 blocks of 32
# samples of 32 bits in at least 9 bits (CCSDS 121.0-B, "remainder of segment"); LZF copies up to
# 264 bytes with 3; n-bit keeps at least 1 of 64 bits; shuffle and checksum keep the size.
_MAX_RATIOS = {
    h5py.h5z.FILTER_DEFLATE: DEFLATE,
    h5py.h5z.FILTER_SHUFFLE: 1.0,
    h5py.h5z.FILTER_FLETCHER32: 1.0,
    h5py.h5z.FILTER_SZIP: 8192.0,
    h5py.h5z.FILTER_NBIT: 64.0,
    h5py.h5z.FILTER_LZF: 88.0,
}
_DEFAULT_MAX_RATIO = DEFLATE  # for scale-offset and plugin filters


class HDF5Container:
    """HDF5 file as a `Container`."""

    def __init__(self, file: h5py.File, path: PathLike) -> None:
        self.file, self.path = file, Path(path)

    def array(self, name: str) -> StoredArray | None:
        item = self.file.get(name) if name else None
        return self._stored(name, item) if isinstance(item, h5py.Dataset) else None

    def arrays(self) -> dict[str, StoredArray]:
        return {name: self._stored(name, item) for name, item in datasets(self.file)}

    def _stored(self, name: str, item: h5py.Dataset) -> StoredArray:
        return StoredArray(
            name.strip("/"),
            item.shape or (),
            item.dtype,
            item.chunks,
            item,
            self.path,
            lambda names: attributes_of(item, names, self.path),
            lambda max_bytes: storage(item, self.path, max_bytes),
        )

    def group(self, name: str, attributes: Iterable[str]) -> dict[str, Any] | None:
        item = self.file.get(name)
        is_group = isinstance(item, h5py.Group)
        return attributes_of(item, attributes, self.path) if is_group else None

    def write(
        self, name: str, values: Array, *, chunks: tuple[int, ...] | None = None, **attributes: Any
    ) -> None:
        self.file.create_dataset(name, data=values).attrs.update(attributes)

    def write_group(self, name: str, attributes: dict[str, Any]) -> None:
        self.file.create_group(name).attrs.update(attributes)


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file to read; raise FormatError if it is damaged."""
    require_file(path, "HDF5 file")
    with reading(path), h5py.File(path, "r") as file:
        require_internal(file, path)
        yield file


@contextmanager
def create_hdf5(path: PathLike, *, durable: bool = False) -> Iterator[h5py.File]:
    """Create an HDF5 file with clplen's mark; it appears only when it is complete."""
    with replacing(path, durable=durable) as temporary:
        try:
            with h5py.File(temporary, "w") as file:
                file.attrs["software"] = MARK
                yield file
        except RuntimeError as error:  # a full disk, reported on closing
            raise OSError(str(error)) from error


def datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield the datasets of a file and their names without the first slash; skip soft links."""
    for name, item in members(file, Path(file.filename)):
        if item is not None:
            yield name, h5py.Dataset(item)


def dataset_of(file: h5py.File, name: str, path: Path) -> h5py.Dataset:
    """Return a dataset by its name."""
    dataset = file.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise FormatError(f"{path} has no dataset {name!r}; it has {contents(file)}.")
    return dataset


def contents(file: h5py.File) -> str:
    """Return the names, shapes and dtypes of the datasets of a file, for a message."""
    descriptions = [f"{name} {item.shape} {item.dtype}" for name, item in datasets(file)]
    return listed(descriptions) if descriptions else "no dataset"


def attributes_of(item: Any, names: Iterable[str], path: Path) -> dict[str, Any]:
    """Return the requested attributes of a dataset or group, leaving out missing ones."""
    values = {}
    stored = {name: item.attrs.get_id(name) for name in names if name in item.attrs}
    if any(_is_variable(attribute.get_type()) for attribute in stored.values()):
        require_heaps(path)
    for name, attribute in stored.items():
        size = attribute.get_storage_size()
        if size > _MAX_ATTRIBUTE_BYTES:
            raise FormatError(
                f"{path}: the attribute {name!r} of {item.name} declares {size:,} bytes, more than "
                "HDF5 allows: the file is damaged."
            )
        values[name] = plain(item.attrs[name])
    return values


def _is_variable(kind: Any) -> bool:
    """Return True if values have variable length and are stored in heaps."""
    return bool(kind.detect_class(h5py.h5t.VLEN)) or (
        isinstance(kind, h5py.h5t.TypeStringID) and bool(kind.is_variable_str())
    )


def storage(dataset: h5py.Dataset, path: Path, max_bytes: int | None) -> Bound:
    """Return the bound on the size of a dataset; reject chunks that exceed it."""
    stored = min(dataset.id.get_storage_size(), path.stat().st_size)
    if dataset.chunks is None:
        return Bound(path, stored, 1.0, max_bytes)
    bound = Bound(path, stored, _ratio(dataset, path), max_bytes)
    bound.require(
        math.prod(dataset.chunks) * dataset.dtype.itemsize, f"a chunk of {dataset.name!r}"
    )
    return bound


def read_array(
    dataset: h5py.Dataset, path: Path, max_bytes: int | None, part: Any = ...
) -> np.ndarray[Any, Any]:
    """Read a dataset; raise an error if it declares more than the file or memory can hold."""
    name = str(dataset.name).strip("/")
    storage(dataset, path, max_bytes).require(
        math.prod(dataset.shape) * dataset.dtype.itemsize, f"the dataset {name!r}"
    )
    return np.asarray(dataset[part])


def _ratio(dataset: h5py.Dataset, path: Path) -> float:
    properties = dataset.id.get_create_plist()
    filters = [properties.get_filter(i) for i in range(properties.get_nfilters())]
    missing = [f for f in filters if not h5py.h5z.filter_avail(f[0])]
    if missing:
        names = ", ".join(f"{f[3].decode('ascii', 'replace')} ({f[0]})" for f in missing)
        raise FormatError(
            f"{path}: {dataset.name!r} is compressed with {names}, a filter that is not installed: "
            "install and import hdf5plugin, or repack the file with gzip."
        )
    return max(math.prod(_MAX_RATIOS.get(f[0], _DEFAULT_MAX_RATIO) for f in filters), _MAX_SPARSITY)


def number(value: Any) -> float:
    """Return the number in an attribute or dataset of size 1, or NaN."""
    values = np.asarray(value)
    if values.size != 1 or values.dtype.kind not in "buif":
        return math.nan
    return float(values.reshape(-1)[0])
