"""Chunks of Zarr arrays that declare or become more than their array has: refused before."""

from __future__ import annotations

import json
import shutil
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield

zarr = pytest.importorskip("zarr")
numcodecs = pytest.importorskip("numcodecs")
codecs = pytest.importorskip("zarr.codecs")

SHAPE = (2, 3, 20, 10)
BOMB = 24 << 20  # bytes that come out
MOST = 12 << 20  # bytes that may be held meanwhile


def values() -> np.ndarray:
    return np.random.default_rng(2).integers(0, 99, SHAPE, np.uint8)


def zeros(codec: Any) -> Callable[[], bytes]:
    return lambda: bytes(codec.encode(np.zeros(BOMB, np.uint8)))


def blosc() -> bytes:
    packed = bytearray(numcodecs.Blosc().encode(values()))
    packed[4:8] = struct.pack("<I", 2**31 - 1)
    return bytes(packed)


def lz4() -> bytes:
    return struct.pack("<I", 2**31 - 1) + bytes(numcodecs.LZ4().encode(values())[4:])


def lz4_negative() -> bytes:
    return b"\xff" * 4 + bytes(numcodecs.LZ4().encode(values())[4:])


def zstd_of_unknown_size() -> bytes:
    block = (1 << 17 << 3 | 1 << 1).to_bytes(3, "little") + b"\0"  # 128 KiB of one byte
    last = (1 << 3 | 1 << 1 | 1).to_bytes(3, "little") + b"\0"
    return b"\x28\xb5\x2f\xfd\x00\x58" + (BOMB >> 17) * block + last


def zstd_in_two_frames() -> bytes:
    first = bytes(numcodecs.Zstd().encode(values()))
    return first + zeros(numcodecs.Zstd())()


BOMBS = {
    "blosc": (numcodecs.Blosc(), blosc),
    "lz4": (numcodecs.LZ4(), lz4),
    "lz4-negative": (numcodecs.LZ4(), lz4_negative),
    "zstd": (numcodecs.Zstd(), zeros(numcodecs.Zstd())),
    "zstd-unknown": (numcodecs.Zstd(), zstd_of_unknown_size),
    "zstd-frames": (numcodecs.Zstd(), zstd_in_two_frames),
    "gzip": (numcodecs.GZip(), zeros(numcodecs.GZip())),
    "zlib": (numcodecs.Zlib(), zeros(numcodecs.Zlib())),
    "bz2": (numcodecs.BZ2(), zeros(numcodecs.BZ2())),
    "lzma": (numcodecs.LZMA(), zeros(numcodecs.LZMA())),
}


def refused(path: Path, device: Device, message: str) -> None:
    """Reading gives a FormatError and holds little memory meanwhile."""
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match=message):
            read_lightfield(path, device=device)
        assert tracemalloc.get_traced_memory()[1] < MOST
    finally:
        tracemalloc.stop()


def test_chunks_of_format_2(tmp_path_factory: pytest.TempPathFactory, one_device: Device):
    for name in BOMBS:
        tmp_path = tmp_path_factory.mktemp("case")
        codec, bomb = BOMBS[name]
        path = tmp_path / "a.zarr"
        array = zarr.create_array(
            str(path), shape=SHAPE, dtype="u1", chunks=SHAPE, zarr_format=2, compressors=codec
        )
        array[...] = values()
        (chunk,) = (file for file in path.rglob("*") if file.name[0].isdigit() and file.is_file())
        content = bomb()
        chunk.write_bytes(content)
        if name == "zstd":
            path = Path(shutil.make_archive(str(tmp_path / "a"), "zip", path))
        refused(
            path, one_device, r"the chunk 0\D0\D0\D0 declares at least [\d,]+ bytes for 1,200 sam"
        )


SHARDED = {
    "blosc": (lambda: codecs.BloscCodec(typesize=1), blosc),
    "zstd": (lambda: codecs.ZstdCodec(), zeros(numcodecs.Zstd())),
    "gzip": (lambda: codecs.GzipCodec(), zeros(numcodecs.GZip())),
}


def test_chunks_in_shards(tmp_path_factory: pytest.TempPathFactory, one_device: Device):
    for name, location, whole in [
        ("blosc", "start", True),
        ("zstd", "end", False),
        ("gzip", "end", True),
    ]:
        tmp_path = tmp_path_factory.mktemp("case")
        codec, bomb = SHARDED[name]
        shards = SHAPE if whole else (2, 3, 40, 10)  # read as a whole, and in part
        array = zarr.create(
            shape=SHAPE,
            dtype="u1",
            chunks=shards,
            store=str(tmp_path / "a.zarr"),
            zarr_format=3,
            codecs=[
                codecs.ShardingCodec(
                    chunk_shape=(1, 3, 20, 10),
                    codecs=[codecs.BytesCodec(), codec()],
                    index_codecs=[codecs.BytesCodec()],
                    index_location=location,
                )
            ],
        )
        array[...] = values()
        np.testing.assert_array_equal(
            read_lightfield(tmp_path / "a.zarr", device=one_device).to_numpy(), values()
        )
        (shard,) = (file for file in (tmp_path / "a.zarr" / "c").rglob("*") if file.is_file())
        content, packed, count = shard.read_bytes(), bomb(), 2 if whole else 4
        index = 0 if location == "start" else len(content) - 16 * count
        pairs = bytearray(content[index : index + 16 * count])
        place = 16 * count if location == "start" else 0
        pairs[:16] = struct.pack("<2Q", place + len(content), len(packed))
        body = content[16 * count :] if location == "start" else content[:index]
        filled = body + bytes(place + len(content) - place - len(body)) + packed
        parts = (bytes(pairs), filled) if location == "start" else (filled, bytes(pairs))
        shard.write_bytes(b"".join(parts))
        refused(
            tmp_path / "a.zarr", one_device, r"the chunk c/0/0/0/0 declares at least [\d,]+ bytes"
        )


def test_well_packed_chunks_are_read(tmp_path: Path, one_device: Device):
    for level in [9]:
        large = np.zeros((2, 2, 600, 700), np.uint16)
        for number, codec in enumerate((numcodecs.Zstd(level), numcodecs.GZip(level))):
            path = tmp_path / f"{number}.zarr"
            array = zarr.create_array(
                str(path), shape=large.shape, dtype="u2", zarr_format=2, compressors=codec
            )
            array[...] = large + number
            lf = read_lightfield(path, device=one_device)
            np.testing.assert_array_equal(lf.to_numpy(), large + number)


def test_a_packed_chunk_of_weights(tmp_path: Path, one_device: Device):
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="w", zarr_format=2)
    group.create_array("lightfield", shape=SHAPE, dtype="u1")[...] = values()
    group.create_array("weights", shape=(2, 3), dtype="f4")[...] = 1
    file = tmp_path / "a.zarr" / "weights" / ".zarray"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"chunks": [10**4, 10**5]}))
    refused(tmp_path / "a.zarr", one_device, "a chunk of the dataset 'weights' declares 4,000,000")
