"""Zarr stores: the package zarr, version 3, of the extra ``zarr``, and what a store declares."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import install_advice
from clplen.errors import FormatError
from clplen.io.formats.untrusted import Bound
from clplen.io.store import attributes

SUFFIX = ".zarr"
MARKS = (".zgroup", ".zarray", "zarr.json")  # one of them lies in the root of a store
FORMAT_2: dict[str, Any] = {"zarr_format": 2}  # what is written, and what most programs read
_RATIO = 32768.0  # of Zstandard, blocks of 128 KiB in 4 bytes (RFC 8878); others pack less
_SPARSE = 4  # chunks that are not there hold the fill value: a quarter has to be there
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


def array_name(array: Any) -> str:
    return str(array.path).strip("/")


def attributes_of(item: Any) -> dict[str, Any]:
    """The attributes of an array or group as plain Python."""
    return {name: attributes.plain(value) for name, value in dict(item.attrs).items()}


def storage(array: Any, path: Path, what: str, max_bytes: int | None) -> Bound:
    """What a store can hold of an array, each of whose chunks has to fit."""
    inside = f"{array_name(array)}/" if array_name(array) else ""
    sizes = [size for key, size in array.store.sizes.items() if key.startswith(inside)]
    chunks = array.shards or array.chunks
    count = math.prod(-(-n // c) for n, c in zip(array.shape, chunks, strict=True))
    if count > _SPARSE * len(sizes) + _FEW:
        raise FormatError(
            f"{path}: {what} has {count:,} chunks, of which at most {len(sizes):,} are there: it "
            "is damaged or incomplete."
        )
    packing = array.store.arrays[array_name(array)]
    Bound(path, sum(sizes), 1, max_bytes).require(
        packing.index_bytes, f"the index of a shard of {what}"
    )
    bound = Bound(path, sum(sizes), _RATIO if packing.packed else float(_SPARSE), max_bytes)
    bound.require(math.prod(array.chunks) * np.dtype(array.dtype).itemsize, f"a chunk of {what}")
    return bound
