"""What the metadata of a Zarr store declare, checked before anything in it is decoded.

Codecs are programs that are named in the metadata; some of them, such as numcodecs' ``pickle``, run
code that the data contain. Only codecs on a list are accepted, and no objects (Zarr formats 2 and
3, https://zarr-specs.readthedocs.io).
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
_OF_V3 = "numcodecs."  # what format 3 puts before the names of format 2
_AFTER = "crc32c"  # 4 bytes after what it protects: the only codec beyond a compressor
_RAW_LZMA = 3  # lzma.FORMAT_RAW, whose filters declare any amount of memory
_V2_TYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248]|c(8|16)|[mM]8(\[\w+\])?|[SUV]\d{1,4})")
_V3_TYPE = re.compile(r"bool|u?int(8|16|32|64)|float(16|32|64)|complex(64|128)")
_LARGEST = 16  # bytes of a number


@dataclass(frozen=True)
class Packing:
    """How the chunks of an array are packed."""

    samples: int  # of a chunk; of a shard, of a chunk in it
    compressor: str | None  # its name in format 2
    packed: bool = False  # whether a compressor or filter makes the stored bytes fewer
    shard: int = 0  # chunks in a shard; 0 where there are no shards
    index_bytes: int = 0  # of the index of a shard
    index_first: bool = False  # whether the index lies at the beginning of a shard

    @property
    def largest(self) -> int:
        """Bytes that a chunk may have in memory, whatever the type of its samples."""
        return self.samples * _LARGEST


def is_metadata(key: str) -> bool:
    """Whether a key is one of metadata, on file systems that ignore case too."""
    return key.rpartition("/")[2].lower() in _METADATA


def checked_arrays(
    documents: Iterable[tuple[str, bytes]], path: Path, form: int
) -> dict[str, Packing]:
    """Check the metadata of a store, and tell how its arrays are packed."""
    found: dict[int, dict[str, Packing]] = {2: {}, 3: {}}
    for key, content in documents:
        folder, _, name = key.rpartition("/")
        name = name.lower()
        with reading(path):
            document = json.loads(content)
            if name == ".zarray":
                found[2][folder] = _packing_2(document, path, folder)
            elif name == ".zmetadata":
                _check_consolidated(document.get("metadata"), path)
            elif name == "zarr.json":
                if document.get("node_type") == "array":
                    found[3][folder] = _packing_3(document, path, folder)
                inside = (document.get("consolidated_metadata") or {}).get("metadata")
                _check_consolidated(inside, path)
    return found[form]


def _check_consolidated(metadata: Any, path: Path) -> None:
    """Check the copies of the arrays' metadata in those of a group."""
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
    if set(names[names.index(_SHARDS) + 1 :]) - {_AFTER}:
        raise FormatError(f"{path}: the shards of {_called(name)} are packed once more: repack it.")
    return _packing_of_shards(shape, dict(chain)[_SHARDS], path, name)


def _packing_of_shards(
    shape: list[int], configuration: dict[str, Any], path: Path, name: str
) -> Packing:
    inner = [codec for codec, _ in _chain(configuration["codecs"], path, name)]
    index = _chain(configuration["index_codecs"], path, name)
    packed = {codec for codec, _ in index} - {"bytes", _AFTER}
    swapped = any(words.get("endian", "little") != "little" for _, words in index)
    if _SHARDS in inner or packed or swapped:
        raise FormatError(
            f"{path}: {_called(name)} has shards in shards, or an index of them that is packed or "
            "big endian: repack it with plain shards."
        )
    chunk = configuration["chunk_shape"]
    count = math.prod(-(-n // c) for n, c in zip(shape, chunk, strict=True))
    return replace(
        _packing(chunk, inner, path, name),
        shard=count,
        index_bytes=16 * count + 4 * sum(codec == _AFTER for codec, _ in index),
        index_first=configuration.get("index_location", "end") == "start",
    )


def _packing(shape: list[int], codecs: list[str], path: Path, name: str) -> Packing:
    packed = not set(codecs) <= {"bytes", "transpose", _AFTER}
    return Packing(math.prod(shape), _compressor(codecs, path, name), packed)


def _chain(codecs: list[Any], path: Path, name: str) -> list[tuple[str, dict[str, Any]]]:
    """Names and configurations of the codecs of format 3."""
    found = []
    for codec in codecs:
        named, configuration = (codec, {}) if isinstance(codec, str) else (codec["name"], codec)
        configuration = configuration.get("configuration") or {}
        found.append((_codec(named, configuration, path, name), configuration))
    return found


def _codec(codec: Any, configuration: dict[str, Any], path: Path, name: str) -> str:
    """The name of a codec in format 2, if it is accepted."""
    known = str(codec).removeprefix(_OF_V3)
    if known not in _CODECS:
        raise FormatError(
            f"{path}: {_called(name)} is packed by the codec {str(codec)[:60]!r}, which is not "
            f"accepted: write it with one of {', '.join(sorted(_CODECS))}."
        )
    for word in ("dtype", "astype"):
        if configuration.get(word) is not None:
            _require_type(configuration[word], path, name)
    if known == "lzma" and configuration.get("format") == _RAW_LZMA:
        raise FormatError(f"{path}: {_called(name)} is packed by lzma without a container: repack.")
    return known


def _compressor(names: list[str], path: Path, name: str) -> str | None:
    """The compressor among codecs: one, and nothing but a checksum after it."""
    found = [i for i, codec in enumerate(names) if codec in COMPRESSORS]
    if not found:
        return None
    if len(found) > 1 or set(names[found[0] + 1 :]) - {_AFTER}:
        raise FormatError(
            f"{path}: {_called(name)} is packed by {', '.join(names)}: repack it with one "
            "compressor, the last of the codecs."
        )
    return names[found[0]]


def _require_type(kind: Any, path: Path, name: str) -> None:
    """Refuse a data type of format 2 with objects, of no known kind or of huge items."""
    if isinstance(kind, list):
        for field in kind:
            _require_type(field[1], path, name)
    elif not _V2_TYPE.fullmatch(str(kind)):
        raise _type_error(kind, path, name)


def _type_error(kind: Any, path: Path, name: str) -> FormatError:
    return FormatError(
        f"{path}: {_called(name)} holds the data type {str(kind)[:60]!r}, which is not accepted "
        "(objects and texts may run code): write numbers."
    )


def _called(name: str) -> str:
    return f"the array {name!r}" if name else "its array"
