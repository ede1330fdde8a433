"""Damage to files on purpose: bytes, numbers, names, nesting, and the structures of TIFF, zip, JSON
and Zarr's metadata; and small files that declare much: sparse ones and bombs."""

from __future__ import annotations

import io
import json
import os
import random
import re
import shutil
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import imageio.v3 as imageio
import numpy as np
import scipy.io
import tifffile

Operation = tuple[int, float, int]  # what, where (0 to 1), with which number
KINDS = 16  # of operations

_EXTREMES = (b"1" + b"0" * 400, b"-1" + b"0" * 400, b"9" * 5000, b"1e400", b"-1e308", b"5e-324")
_EXTREMES += (
    b"18446744073709551616",
    b"-9223372036854775809",
    b"Infinity",
    b"-0.0",
    b"0.0",
    b"1e9",
)
_NAMES = (
    b"../../x",
    b"/etc/passwd",
    b"/dev/zero",
    b"$x$",
    b"\xff\xfe",
    b"x" * 70000,
    b"a\0b",
    b".",
)
_DEPTHS = (100, 1000, 20000)
_OPENED = ((b"[", b"]"), (b'{"a":', b"}"), (b"{a=", b"}"), (b"a.", b""), (b"<a>", b"</a>"))
SPARSE = 1 << 30  # bytes of a file with a hole
BOMB = 12000  # pixels a side
_PICTURE = 9000  # of a PNG, which Pillow still reads
_LENGTHS = (2**32 - 1, 2**31, 2**31 - 1, 0, 1, 2**16, 2**24)
_NUMBERS = (b"-1", b"0", b"999999999999", b"nan", b"1e999", b"", b"[]", b"null")
_VALUES = (None, -1, 0, 1, 2**31 - 1, 2**62, 1e308, "", "x", [], {}, [1, 2], {"a": 1}, True)
_CODECS = ("blosc", "zstd", "lz4", "gzip", "zlib", "bz2", "lzma", "delta", "shuffle", "packbits")
_CODECS += ("crc32", "bytes", "transpose", "sharding_indexed", "pickle", "vlen-utf8", "")
_DTYPES = ("|u1", "<f8", "|O", "|V2147483647", "<U999999999", "float64", "string", "r2147483640")
_JSON = (".json", ".zarray", ".zattrs", ".zgroup", ".zmetadata")
_TIFF_TYPES = (*range(1, 19), 0, 255, 65535)
_TIFF_TAGS = (254, 256, 257, 258, 259, 262, 270, 273, 277, 278, 279, 284, 317, 320, 322, 323, 324)
_TIFF_TAGS += (325, 330, 338, 339, 347, 530, 34377, 37724, 42112, 50839, 65426)
_ZIP_FIELDS = (  # of a head: place and size
    (b"PK\1\2", ((6, 2), (8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (30, 2), (42, 4))),
    (b"PK\3\4", ((4, 2), (6, 2), (8, 2), (14, 4), (18, 4), (22, 4), (26, 2), (28, 2))),
    (b"PK\5\6", ((8, 2), (10, 2), (12, 4), (16, 4), (20, 2))),
)


def operations(source: random.Random) -> list[Operation]:
    """One to four random operations."""
    return [
        (source.randrange(KINDS), source.random(), source.randrange(1 << 32))
        for _ in range(source.randint(1, 4))
    ]


def mutated(data: bytes, operations: list[Operation], name: str = "") -> bytes:
    """Bytes, damaged one operation after the other; those of structures need one to damage."""
    for what, where, number in operations:
        if data:
            act = _OF_STRUCTURES.get(what % KINDS)
            changed = act(data, where, number, name) if act else None
            data = _of_bytes(data, what % 8, where, number) if changed is None else changed
    return data


def _of_bytes(data: bytes, what: int, where: float, number: int) -> bytes:
    out = bytearray(data)
    place = int(where * len(out))
    size = 1 + number % 64
    match what:
        case 0:
            del out[place:]
        case 1:
            out[place] ^= 1 << number % 8
        case 2:
            order = "<I" if number % 2 else ">I"
            out[place : place + 4] = struct.pack(order, _LENGTHS[number // 2 % len(_LENGTHS)])
        case 3:
            other = number % len(out)
            first, second = bytes(out[place : place + size]), bytes(out[other : other + size])
            out[place : place + size], out[other : other + size] = second, first
        case 4:
            del out[place : place + size]
        case 5:
            out[place:place] = out[number % len(out) :][:size]
        case 6:
            found = list(re.finditer(rb"-?\d+(?:\.\d+)?", bytes(out[:100000])))
            if found:
                start, end = found[int(where * len(found))].span()
                out[start:end] = _NUMBERS[number % len(_NUMBERS)]
        case _:
            out[place] = number % 256
    return bytes(out)


def _extreme_number(data: bytes, where: float, number: int, _: str) -> bytes | None:
    """A number in a text becomes far too large, too small or none."""
    return _exchanged(rb"-?\d+(?:\.\d+)?", data, where, _EXTREMES[number % len(_EXTREMES)])


def _name(data: bytes, where: float, number: int, _: str) -> bytes | None:
    """A text between quotes becomes another name."""
    return _exchanged(rb"(?<=\")[\w .:-]+(?=\")", data, where, _NAMES[number % len(_NAMES)])


def _nesting(data: bytes, where: float, number: int, _: str) -> bytes | None:
    """A number in a text comes to lie deep in lists, tables, elements or a dotted key."""
    start, end = _OPENED[number % len(_OPENED)]
    depth = _DEPTHS[number // 5 % len(_DEPTHS)]
    return _exchanged(rb"\b\d+(?:\.\d+)?", data, where, start * depth + b"1" + end * depth)


def _exchanged(pattern: bytes, data: bytes, where: float, new: bytes) -> bytes | None:
    places = list(re.finditer(pattern, data[:100000]))
    if not places:
        return None
    start, end = places[int(where * len(places))].span()
    return data[:start] + new + data[end:]


def _tiff_tag(data: bytes, where: float, number: int, _: str) -> bytes | None:
    """A tag of a directory of a TIFF gets another number, type, count or value."""
    entries = tiff_entries(data)
    if not entries:
        return None
    order, place, wide = entries[int(where * len(entries))]
    value = (*_LENGTHS, number >> 8, len(data), len(data) - 1)[number // 4 % (len(_LENGTHS) + 3)]
    out = bytearray(data)
    field = number % 4
    if field == 0:
        struct.pack_into(f"{order}H", out, place, _TIFF_TAGS[number // 4 % len(_TIFF_TAGS)])
    elif field == 1:
        struct.pack_into(f"{order}H", out, place + 2, _TIFF_TYPES[number // 4 % len(_TIFF_TYPES)])
    else:
        size = "Q" if wide else "I"
        step = struct.calcsize(size) * (field - 2)
        struct.pack_into(f"{order}{size}", out, place + 4 + step, value)
    return bytes(out)


def tiff_entries(data: bytes) -> list[tuple[str, int, bool]]:
    """Byte order, place and whether it is one of BigTIFF, of every tag of a TIFF."""
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None or len(data) < 16:
        return []
    wide = struct.unpack_from(f"{order}H", data, 2)[0] == 43
    count, offset, size = ("Q", "Q", 20) if wide else ("H", "I", 12)
    (place,) = struct.unpack_from(f"{order}{offset}", data, 8 if wide else 4)
    found: list[tuple[str, int, bool]] = []
    while 0 < place < len(data) - 10 and len(found) < 500:
        (tags,) = struct.unpack_from(f"{order}{count}", data, place)
        first = place + struct.calcsize(count)
        end = first + size * tags
        if end + struct.calcsize(offset) > len(data):
            break
        found += [(order, at, wide) for at in range(first, end, size)]
        (place,) = struct.unpack_from(f"{order}{offset}", data, end)
    return found


def _zip_header(data: bytes, where: float, number: int, _: str) -> bytes | None:
    """A field of a central directory entry, or of the local header beside it, is changed."""
    mark, fields = _ZIP_FIELDS[number % 3]
    places = [match.start() for match in re.finditer(re.escape(mark), data)]
    if data[:2] != b"PK" or not places:
        return None
    offset, size = fields[number // 3 % len(fields)]
    at = places[int(where * len(places))] + offset
    value = (*_LENGTHS, 8, 12, 14, number >> 8)[number // 27 % (len(_LENGTHS) + 4)]
    return data[:at] + (value % 256**size).to_bytes(size, "little") + data[at + size :]


def _zip_truncated(data: bytes, where: float, number: int, _: str) -> bytes | None:
    """Bytes before the central directory are missing, or it is."""
    start = data.find(b"PK\1\2")
    if data[:2] != b"PK" or start < 0:
        return None
    if number % 4 == 0:
        return data[: start + int(where * (len(data) - start))]
    place = int(where * start)
    return data[:place] + data[min(place + number % 200, start) :]


def _json_value(data: bytes, where: float, number: int, name: str) -> bytes | None:
    """A value somewhere in JSON, a file or a member of an archive, becomes another one."""

    def change(document: Any) -> None:
        places = [(holder, key) for holder in _nodes(document) for key in _keys(holder)]
        if places:
            holder, key = places[int(where * len(places))]
            holder[key] = _VALUES[number % len(_VALUES)]

    return _in_json(data, number, name, change)


def _zarr_codec(data: bytes, where: float, number: int, name: str) -> bytes | None:
    """A codec of an array is exchanged, doubled or gone; or its data type is another one."""

    def change(document: Any) -> None:
        found = [node for node in _nodes(document) if {"id", "name", "dtype"} & set(_keys(node))]
        lists = [node for node in _nodes(document) if isinstance(node, list) and node]
        if found and number % 3:
            node = found[int(where * len(found))]
            for key, words in (("id", _CODECS), ("name", _CODECS), ("dtype", _DTYPES)):
                if key in node:
                    node[key] = words[number // 3 % len(words)]
        elif lists:
            chosen = lists[int(where * len(lists))]
            chosen.append(chosen[0]) if number % 2 else chosen.pop()

    return _in_json(data, number, name, change)


def _in_json(data: bytes, number: int, name: str, change: Callable[[Any], None]) -> bytes | None:
    """JSON after a change, in a file or in one member of an archive."""
    if data[:2] == b"PK":
        return _in_member(data, number, lambda part: _in_json(part, number, _JSON[0], change))
    if not name.endswith(_JSON):
        return None
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return None
    change(document)
    return json.dumps(document).encode()


def _in_member(data: bytes, number: int, change: Callable[[bytes], bytes | None]) -> bytes | None:
    """An archive, one of whose members in JSON is changed."""
    out = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
            names = [item for item in old.namelist() if item.endswith(_JSON)]
            for item in old.namelist():
                part = old.read(item)
                if names and item == names[number // 7 % len(names)]:
                    part = change(part) or part
                new.writestr(item, part)
    except Exception:  # damaged before
        return None
    return out.getvalue() if names else None


def _nodes(document: Any) -> list[Any]:
    """Every list and object in JSON."""
    if not isinstance(document, dict | list):
        return []
    inside = document.values() if isinstance(document, dict) else document
    return [document, *(node for value in inside for node in _nodes(value))]


def _keys(node: Any) -> list[Any]:
    return list(node) if isinstance(node, dict) else list(range(len(node)))


_OF_STRUCTURES: dict[int, Callable[[bytes, float, int, str], bytes | None]] = {
    8: _tiff_tag,
    9: _zip_header,
    10: _zip_truncated,
    11: _json_value,
    12: _zarr_codec,
    13: _extreme_number,
    14: _name,
    15: _nesting,
}


def enlarge(path: Path, source: random.Random) -> None:
    """Make a file, or a member of an archive, longer by zeros that take no room on the disk."""
    if path.suffix == ".zip" and source.random() < 0.5:
        with zipfile.ZipFile(path) as old:
            parts = {name: old.read(name) for name in old.namelist() if name[-1] != "/"}
        longer = source.choice(sorted(parts))
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as new:
            for name, content in parts.items():
                with new.open(name, "w") as member:
                    member.write(content)
                    for _ in range(SPARSE >> 25 if name == longer else 0):
                        member.write(bytes(1 << 24))
        return
    os.truncate(_one_file(path, source), SPARSE)


def bomb(path: Path) -> bool:
    """Replace a file by a small one of its kind that declares much; False where none is known."""
    suffix, zeros = path.suffix.lower(), np.zeros((BOMB, BOMB), np.uint8)
    if suffix == ".zarr":
        _zarr_bomb(path)
        return True
    if path.is_dir():
        parts = [part for part in path.rglob("*") if part.suffix.lower() in (".png", ".tif")]
        return bool(parts) and bomb(sorted(parts)[0])
    if suffix == ".png":
        imageio.imwrite(path, zeros[:_PICTURE, :_PICTURE], plugin="pillow", extension=".png")
    elif suffix == ".tif":
        tifffile.imwrite(path, zeros, compression="zlib", tile=(4000, 4000), metadata=None)
    elif suffix == ".h5":
        with h5py.File(path, "r+") as file:
            found: list[h5py.Dataset] = []
            file.visititems(lambda _, item: found.append(item))
            for old in [item for item in found if isinstance(item, h5py.Dataset) and item.ndim > 1]:
                name, about, ones = old.name, dict(old.attrs), (1,) * (old.ndim - 2)
                shape, chunks = (BOMB, BOMB, *ones), (1000, 1000, *ones)
                kind = old.dtype
                del file[name]
                made = file.create_dataset(name, shape, kind, chunks=chunks, compression="gzip")
                for column in range(0, BOMB, 1000):  # the other rows of chunks are missing
                    part = zlib.compress(bytes(1_000_000 * kind.itemsize))
                    made.id.write_direct_chunk((0, column, *(0 for _ in ones)), part)
                made.attrs.update(about)
    elif suffix == ".mat":
        scipy.io.savemat(path, {"LF": zeros.reshape(3, 4, -1, 100)}, do_compression=True)
    elif suffix == ".npy":
        head = np.lib.format.header_data_from_array_1_0(zeros) | {"shape": (3, 4, BOMB, BOMB // 12)}
        with path.open("wb") as file:
            np.lib.format.write_array_header_1_0(file, head)
            file.truncate(file.tell() + zeros.size)
    elif suffix == ".zip" and _is_store(path):
        with tempfile.TemporaryDirectory() as place:
            shutil.unpack_archive(path, place)
            _zarr_bomb(Path(place))
            shutil.make_archive(str(path.with_suffix("")), "zip", place)
    elif suffix == ".lfp":
        _lytro_bomb(path)
    elif suffix == ".zip":
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as file:
            for name in file.namelist()[:1]:
                file.writestr(f"{name}.png", bytes(1 << 27))
    elif suffix in (".json", ".toml", ".cfg", ".xml", ".csv", ".txt", ".ply", ".pfm"):
        text = path.read_bytes()
        path.write_bytes(text + text.splitlines(keepends=True)[-1] * 200_000)
    else:
        return False
    return True


def _is_store(path: Path) -> bool:
    """Whether an archive holds a Zarr store."""
    with zipfile.ZipFile(path) as file:
        return bool({".zgroup", "zarr.json"} & set(file.namelist()))


def _zarr_bomb(path: Path) -> None:
    """A large array in place of the largest of a store, three quarters of whose chunks lack."""
    import numcodecs
    import zarr

    group = zarr.open_group(str(path), mode="r+")
    form = group.metadata.zarr_format
    packed = numcodecs.GZip(1) if form == 2 else zarr.codecs.GzipCodec(level=1)
    name, old = max(group.arrays(), key=lambda found: found[1].size)
    first, second = sorted(range(old.ndim), key=lambda axis: old.shape[axis])[-2:]
    side = int(BOMB / (old.size / old.shape[first] / old.shape[second]) ** 0.5)
    shape = [side if axis in (first, second) else n for axis, n in enumerate(old.shape)]
    chunks = [-(-side // 4) if axis in (first, second) else 1 for axis in range(old.ndim)]
    made = group.create_array(
        name, shape=shape, chunks=chunks, dtype=old.dtype, attributes=dict(old.attrs),
        overwrite=True, fill_value=1, compressors=packed,
    )  # fmt: skip
    made[tuple(slice(chunks[axis] if axis == first else None) for axis in range(old.ndim))] = 0


def _lytro_bomb(path: Path) -> None:
    """A container whose raw image is a hole."""
    data, nbytes = path.read_bytes(), BOMB * BOMB * 12 // 8
    raw = data.index(b"\x89LFC")
    about = data.index(b"\x89LFC", raw + 1)
    start = about + 96
    text = re.sub(rb'("(?:width|height)": )\d+', rb"\g<1>%d" % BOMB, data[start:].rstrip(b"\0"))
    with path.open("wb") as file:
        file.write(data[: raw + 12] + struct.pack(">I", nbytes) + data[raw + 16 : raw + 96])
        file.seek(nbytes, os.SEEK_CUR)
        file.write(data[about : about + 12] + struct.pack(">I", len(text)))
        file.write(data[about + 16 : start] + text)


def _one_file(path: Path, source: random.Random) -> Path:
    if path.is_dir():
        return source.choice(sorted(file for file in path.rglob("*") if file.is_file()))
    return path


def damage(path: Path, ops: list[Operation], source: random.Random) -> bytes:
    """Damage a file, or one file of a folder, and return what it is now."""
    file = _one_file(path, source)
    data = mutated(file.read_bytes(), ops, file.name)
    if data[:4] == b"\x89PNG" and source.random() < 0.7:
        data = with_checksums(data)
    file.write_bytes(data)
    return data


def with_checksums(data: bytes) -> bytes:
    """A PNG whose chunks have the checksums of what they hold now, to get past these."""
    out, place = bytearray(data), 8
    while place + 12 <= len(out):
        end = place + 8 + int.from_bytes(out[place : place + 4], "big")
        if end + 4 > len(out):
            break
        out[end : end + 4] = zlib.crc32(out[place + 4 : end]).to_bytes(4, "big")
        place = end + 4
    return bytes(out)
