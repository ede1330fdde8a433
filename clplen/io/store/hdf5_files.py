"""HDF5 files of unknown origin: opening, bounded reading, compression."""

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
from clplen.hdf5_safety import members, require_heaps, require_own
from clplen.io.formats.untrusted import DEFLATE, Bound, listed, reading
from clplen.io.store.attributes import plain
from clplen.io.store.containers import Array, StoredArray
from clplen.outputs import MARK

SUFFIXES = (".h5", ".hdf5")
MAGIC = b"\x89HDF\r\n\x1a\n"
_ATTRIBUTE = 1 << 16  # bytes: HDF5's own limit of an attribute in an object's header
_SPARSE = 4.0  # chunks that were never written hold the fill value: a quarter has to be there
# Largest ratios of filters by number (HDF5 registry). SZIP codes up to 64 blocks of 32 samples of
# 32 bits in 9 bits or more (CCSDS 121.0-B, "remainder of segment"); LZF copies up to 264 bytes by
# 3; n-bit keeps at least 1 of 64 bits; shuffle and checksum keep the size.
_RATIOS = {
    h5py.h5z.FILTER_DEFLATE: DEFLATE,
    h5py.h5z.FILTER_SHUFFLE: 1.0,
    h5py.h5z.FILTER_FLETCHER32: 1.0,
    h5py.h5z.FILTER_SZIP: 8192.0,
    h5py.h5z.FILTER_NBIT: 64.0,
    h5py.h5z.FILTER_LZF: 88.0,
}
_OTHER = DEFLATE  # of scale-offset and of filters that plugins bring


class HDF5Container:
    """An HDF5 file as a `Container`."""

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
        known = isinstance(item, h5py.Group)
        return attributes_of(item, attributes, self.path) if known else None

    def write(
        self, name: str, values: Array, *, chunks: tuple[int, ...] | None = None, **attributes: Any
    ) -> None:
        self.file.create_dataset(name, data=values).attrs.update(attributes)

    def write_group(self, name: str, attributes: dict[str, Any]) -> None:
        self.file.create_group(name).attrs.update(attributes)


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file to read; what HDF5 says of a damaged one is a FormatError."""
    require_file(path, "HDF5 file")
    with reading(path), h5py.File(path, "r") as file:
        require_own(file, path)
        yield file


@contextmanager
def created(path: PathLike, *, durable: bool = False) -> Iterator[h5py.File]:
    """A new HDF5 file with clplen's mark, which appears whole or not at all."""
    with replacing(path, durable=durable) as temporary:
        try:
            with h5py.File(temporary, "w") as file:
                file.attrs["software"] = MARK
                yield file
        except RuntimeError as error:  # a full disk, found when the file is closed
            raise OSError(str(error)) from error


def datasets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Every dataset of a file, by its name without the first slash; soft links are not followed."""
    for name, item in members(file, Path(file.filename)):
        if item is not None:
            yield name, h5py.Dataset(item)


def dataset_of(file: h5py.File, name: str, path: Path) -> h5py.Dataset:
    """A dataset by its name."""
    dataset = file.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise FormatError(f"{path} has no dataset {name!r}; it holds {contents(file)}.")
    return dataset


def contents(file: h5py.File) -> str:
    """The datasets of a file with shapes and types, for a message."""
    found = [f"{name} {item.shape} {item.dtype}" for name, item in datasets(file)]
    return listed(found) if found else "no dataset"


def attributes_of(item: Any, names: Iterable[str], path: Path) -> dict[str, Any]:
    """Return some attributes of a dataset or group as plain Python, without missing ones."""
    found = {}
    stored = {name: item.attrs.get_id(name) for name in names if name in item.attrs}
    if any(_is_variable(attribute.get_type()) for attribute in stored.values()):
        require_heaps(path)
    for name, attribute in stored.items():
        size = attribute.get_storage_size()
        if size > _ATTRIBUTE:
            raise FormatError(
                f"{path}: the attribute {name!r} of {item.name} declares {size:,} bytes, more than "
                "an attribute holds: the file is damaged."
            )
        found[name] = plain(item.attrs[name])
    return found


def _is_variable(kind: Any) -> bool:
    """Whether values are of variable length, which lie in heaps."""
    return bool(kind.detect_class(h5py.h5t.VLEN)) or (
        isinstance(kind, h5py.h5t.TypeStringID) and bool(kind.is_variable_str())
    )


def storage(dataset: h5py.Dataset, path: Path, max_bytes: int | None) -> Bound:
    """What the file can hold of a dataset, each of whose chunks has to fit."""
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
    """The samples of a dataset, refused where it declares more than the file or memory holds."""
    name = str(dataset.name).strip("/")
    storage(dataset, path, max_bytes).require(
        math.prod(dataset.shape) * dataset.dtype.itemsize, f"the dataset {name!r}"
    )
    return np.asarray(dataset[part])


def _ratio(dataset: h5py.Dataset, path: Path) -> float:
    made = dataset.id.get_create_plist()
    filters = [made.get_filter(i) for i in range(made.get_nfilters())]
    missing = [f for f in filters if not h5py.h5z.filter_avail(f[0])]
    if missing:
        names = ", ".join(f"{f[3].decode('ascii', 'replace')} ({f[0]})" for f in missing)
        raise FormatError(
            f"{path}: {dataset.name!r} is compressed by {names}, a filter that is not installed: "
            "install hdf5plugin and import it, or repack the file with gzip."
        )
    return max(math.prod(_RATIOS.get(f[0], _OTHER) for f in filters), _SPARSE)


def number(value: Any) -> float:
    """One finite number of an attribute or dataset, NaN where there is none."""
    values = np.asarray(value)
    if values.size != 1 or values.dtype.kind not in "buif":
        return math.nan
    return float(values.reshape(-1)[0])
