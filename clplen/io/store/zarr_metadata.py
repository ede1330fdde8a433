"""Check the metadata of a Zarr store before any of its data are decoded.

The metadata name codecs; some of them, such as numcodecs' ``pickle``, run code contained in the
data. Only listed codecs are accepted, and no objects (Zarr formats 2 and 3,
https://zarr-specs.readthedocs.io).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from clplen.errors import FormatError
from clplen.io.formats.untrusted import reading

_METADATA = (".zarray", ".zgroup", ".zattrs", ".zmetadata", "zarr.json")
COMPRESSORS = ("blosc", "zstd", "lz4", "gzip", "zlib", "bz2", "lzma")
_FILTERS = ("delta", "shuffle", "fixedscaleoffset", "packbits", "crc32", "crc32c", "transpose")
_SHARDS = "sharding_indexed"
_CODECS = frozenset((*COMPRESSORS, *_FILTERS, "bytes", _SHARDS))
_V3_PREFIX = "numcodecs."  # prefix of format 3 for codec names of format 2
_CHECKSUM = "crc32c"  # appends 4 bytes; the only codec allowed after a compressor
_RAW_LZMA = 3  # lzma.FORMAT_RAW; its filters may declare any amount of memory
_V2_TYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248]|c(8|16)|[mM]8(\[\w+\])?|[SUV]\d{1,4})")
_V3_TYPE = re.compile(r"bool|u?int(8|16|32|64)|float(16|32|64)|complex(64|128)")
_MAX_ITEM_BYTES = 16  # of a complex128 number


@dataclass(frozen=True)
class Packing:
    """Packing of the chunks of an array."""

    samples: int  # in a chunk, also within a shard
    compressor: str | None  # name in format 2
    packed: bool = False  # True if a compressor or filter reduces the stored bytes
    shard: int = 0  # chunks in a shard; 0 without shards
    index_bytes: int = 0  # size of the index of a shard
    index_first: bool = False  # True if the index is at the start of a shard

    @property
    def largest(self) -> int:
        """Largest size of a chunk in memory in bytes, for any type of samples."""
        return self.samples * _MAX_ITEM_BYTES


def is_metadata(key: str) -> bool:
    """Return True if a key names metadata, also on case-insensitive file systems."""
    return key.rpartition("/")[2].lower() in _METADATA


def checked_arrays(
    documents: Iterable[tuple[str, bytes]], path: Path, form: int
) -> dict[str, Packing]:
    """Check the metadata of a store, and return the packing of its arrays."""
    packings: dict[int, dict[str, Packing]] = {2: {}, 3: {}}
    for key, content in documents:
        folder, _, name = key.rpartition("/")
        name = name.lower()
        with reading(path):
            document = json.loads(content)
            if name == ".zarray":
                packings[2][folder] = _packing_2(document, path, folder)
            elif name == ".zmetadata":
                _check_consolidated(document.get("metadata"), path)
            elif name == "zarr.json":
                if document.get("node_type") == "array":
                    packings[3][folder] = _packing_3(document, path, folder)
                inside = (document.get("consolidated_metadata") or {}).get("metadata")
                _check_consolidated(inside, path)
    return packings[form]


def _check_consolidated(metadata: Any, path: Path) -> None:
    """Check the copies of array metadata in the metadata of a group."""
    for key, document in (metadata or {}).items():
        if key.rpartition("/")[2] == ".zarray":
            _packing_2(document, path, key.removesuffix(".zarray").strip("/"))
        elif isinstance(document, dict) and document.get("node_type") == "array":
            _packing_3(document, path, key)


def _packing_2(document: dict[str, Any], path: Path, name: str) -> Packing:
    _require_type(document["dtype"], path, name)
    codecs = [*(document.get("filters") or ()), document.get("compressor")]
    named = [_codec(codec["id"], codec, path, name) for codec in codecs if codec is not None]
    return _packing(document["chunks"], named, path, name)


def _packing_3(document: dict[str, Any], path: Path, name: str) -> Packing:
    kind = document["data_type"]
    if not isinstance(kind, str) or not _V3_TYPE.fullmatch(kind):
        raise _type_error(kind.get("name") if isinstance(kind, dict) else kind, path, name)
    shape = document["chunk_grid"]["configuration"]["chunk_shape"]
    chain = _chain(document["codecs"], path, name)
    names = [codec for codec, _ in chain]
    if _SHARDS not in names:
        return _packing(shape, names, path, name)
    if set(names[names.index(_SHARDS) + 1 :]) - {_CHECKSUM}:
        raise FormatError(
            f"{path}: the shards of {_array_label(name)} are packed twice: repack it."
        )
    return _packing_of_shards(shape, dict(chain)[_SHARDS], path, name)


def _packing_of_shards(
    shape: list[int], configuration: dict[str, Any], path: Path, name: str
) -> Packing:
    inner = [codec for codec, _ in _chain(configuration["codecs"], path, name)]
    index = _chain(configuration["index_codecs"], path, name)
    packed = {codec for codec, _ in index} - {"bytes", _CHECKSUM}
    swapped = any(options.get("endian", "little") != "little" for _, options in index)
    if _SHARDS in inner or packed or swapped:
        raise FormatError(
            f"{path}: {_array_label(name)} has nested shards, or a shard index that is packed "
            "or big endian: repack it with plain shards."
        )
    chunk = configuration["chunk_shape"]
    count = math.prod(-(-n // c) for n, c in zip(shape, chunk, strict=True))
    return replace(
        _packing(chunk, inner, path, name),
        shard=count,
        index_bytes=16 * count + 4 * sum(codec == _CHECKSUM for codec, _ in index),
        index_first=configuration.get("index_location", "end") == "start",
    )


def _packing(shape: list[int], codecs: list[str], path: Path, name: str) -> Packing:
    packed = not set(codecs) <= {"bytes", "transpose", _CHECKSUM}
    return Packing(math.prod(shape), _compressor(codecs, path, name), packed)


def _chain(codecs: list[Any], path: Path, name: str) -> list[tuple[str, dict[str, Any]]]:
    """Return names and configurations of the codecs of format 3."""
    chain = []
    for codec in codecs:
        named, configuration = (codec, {}) if isinstance(codec, str) else (codec["name"], codec)
        configuration = configuration.get("configuration") or {}
        chain.append((_codec(named, configuration, path, name), configuration))
    return chain


def _codec(codec: Any, configuration: dict[str, Any], path: Path, name: str) -> str:
    """Return the name of an accepted codec in format 2."""
    short_name = str(codec).removeprefix(_V3_PREFIX)
    if short_name not in _CODECS:
        raise FormatError(
            f"{path}: {_array_label(name)} is packed with the codec {str(codec)[:60]!r}, "
            f"which is not accepted: write it with one of {', '.join(sorted(_CODECS))}."
        )
    for word in ("dtype", "astype"):
        if configuration.get(word) is not None:
            _require_type(configuration[word], path, name)
    if short_name == "lzma" and configuration.get("format") == _RAW_LZMA:
        raise FormatError(f"{path}: {_array_label(name)} is packed with raw lzma: repack it.")
    return short_name


def _compressor(names: list[str], path: Path, name: str) -> str | None:
    """Return the only compressor among codecs, or None; only a checksum may follow it."""
    indices = [i for i, codec in enumerate(names) if codec in COMPRESSORS]
    if not indices:
        return None
    if len(indices) > 1 or set(names[indices[0] + 1 :]) - {_CHECKSUM}:
        raise FormatError(
            f"{path}: {_array_label(name)} is packed with {', '.join(names)}: repack it with one "
            "compressor, the last of the codecs."
        )
    return names[indices[0]]


def _require_type(kind: Any, path: Path, name: str) -> None:
    """Raise FormatError for a data type of format 2 with objects or large items."""
    if isinstance(kind, list):
        for field in kind:
            _require_type(field[1], path, name)
    elif not _V2_TYPE.fullmatch(str(kind)):
        raise _type_error(kind, path, name)


def _type_error(kind: Any, path: Path, name: str) -> FormatError:
    return FormatError(
        f"{path}: {_array_label(name)} has the data type {str(kind)[:60]!r}, which is not accepted "
        "(objects and strings may run code): write numbers."
    )


def _array_label(name: str) -> str:
    return f"the array {name!r}" if name else "its array"
