"""Damaged files of every format: one clear error, or a light field, and never much memory.

A few files of each format here, always the same ones; ``benchmarks/fuzz.py`` makes others for as
long as wanted.
"""

from __future__ import annotations

import json
import random
import shutil
import zipfile
from io import BytesIO
from pathlib import Path

import fuzzing
import mutations
import numpy as np
import pytest
import tifffile

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_picture, write_picture

FILES = 5  # of each format, always the same ones
PARTS = 4  # of the formats, for tests that run beside each other


@pytest.mark.parametrize("part", range(PARTS))
def test_good_files_are_read_and_damaged_ones_refused(
    tmp_path_factory: pytest.TempPathFactory, one_device: Device, part: int
):
    for name in list(fuzzing.PARSERS)[part::PARTS]:
        if "zarr" in name:
            pytest.importorskip("zarr")
        parser = fuzzing.PARSERS[name]
        good = parser.make(tmp_path_factory.mktemp("good"), one_device)
        assert fuzzing.outcome(parser, good, one_device)[0] == "read", name
        for seed in range(FILES):
            folder = tmp_path_factory.mktemp("bad")
            shutil.copytree(good.parent, folder, dirs_exist_ok=True)
            path, source = folder / good.name, random.Random(f"{name} {seed}")
            mutations.damage(path, mutations.operations(source), source)
            _, peak = fuzzing.outcome(parser, path, one_device)
            assert peak <= 4 * fuzzing.size_of(path) + fuzzing.SLACK, (name, seed)


def tried(name: str, device: Device, good: Path, data: bytes) -> None:
    """A reader with other bytes in place of a good file."""
    good.write_bytes(data)
    _, peak = fuzzing.outcome(fuzzing.PARSERS[name], good, device)
    assert peak <= 4 * len(data) + fuzzing.SLACK


def test_every_tag_of_a_tiff(tmp_path: Path, one_device: Device):
    for name in ["ome-depth", "tiff-tiles"]:
        good = fuzzing.PARSERS[name].make(tmp_path, one_device)
        data = good.read_bytes()
        count = len(mutations.tiff_entries(data))
        assert count > 10
        for entry in range(min(count, 14)):  # of the first pages
            for field in (1, 2, 3):  # type, count, value
                for value in (0, 5):
                    damage = (8, (entry + 0.5) / count, 4 * value + field)
                    tried(name, one_device, good, mutations.mutated(data, [damage]))


@pytest.mark.thorough
def test_every_field_of_a_zip(tmp_path: Path, one_device: Device):
    for name in ["zarr-zip", "zip"]:
        pytest.importorskip("zarr")
        good = fuzzing.PARSERS[name].make(tmp_path, one_device)
        data = good.read_bytes()
        for number in range(24):  # three kinds of heads, eight fields
            for where in (0.2, 0.5, 0.85):
                tried(name, one_device, good, mutations.mutated(data, [(9, where, number)]))
        for cut in range(0, len(data), len(data) // 20):
            tried(name, one_device, good, mutations.mutated(data, [(10, cut / len(data), cut)]))


def test_checksums_are_mended(tmp_path: Path):
    write_picture(tmp_path / "a.png", np.arange(35, dtype=np.uint8).reshape(5, 7))
    good = (tmp_path / "a.png").read_bytes()
    assert mutations.with_checksums(good) == good
    bad = good.replace(b"IHDR\0\0\0\7", b"IHDR\0\0\0\6")
    (tmp_path / "a.png").write_bytes(bad)
    with pytest.raises(FormatError):
        read_picture(tmp_path / "a.png")
    wrong = bad[:29] + bytes(4) + bad[33:]
    assert mutations.with_checksums(wrong) == mutations.with_checksums(bad) != bad


def test_the_damage_is_what_it_says():
    data = bytes(range(10))
    assert mutations.mutated(data, [(0, 0.5, 0)]) == data[:5]
    assert mutations.mutated(data, [(1, 0.0, 3)])[0] == 8
    assert mutations.mutated(data, [(2, 0.2, 0)]) == b"\0\1\xff\xff\xff\xff" + data[6:]
    assert mutations.mutated(data, [(4, 0.0, 2)]) == data[3:]
    assert mutations.mutated(b"a 12 b", [(6, 0.0, 2)]) == b"a 999999999999 b"
    assert mutations.mutated(b"", [(7, 0.9, 1)]) == b""


def test_the_damage_of_structures(tmp_path: Path):
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((2, 4, 5), "u2"), metadata=None)
    tifffile.imwrite(tmp_path / "b.tif", np.zeros((4, 5), "u2"), metadata=None, bigtiff=True)
    classic = (tmp_path / "a.tif").read_bytes()
    for data, pages in ((classic, 2), ((tmp_path / "b.tif").read_bytes(), 1)):
        found = mutations.tiff_entries(data)
        with tifffile.TiffFile(BytesIO(data)) as file:
            assert len(found) == sum(len(page.tags) for page in file.pages)
            assert len(file.pages) == pages
    longer = mutations.mutated(classic, [(8, 0.0, 2)])  # the count of the first tag
    changed = [i for i, pair in enumerate(zip(classic, longer, strict=True)) if len(set(pair)) > 1]
    first = mutations.tiff_entries(classic)[0][1]
    assert changed
    assert set(changed) <= set(range(first + 4, first + 8))

    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a/.zarray", json.dumps({"dtype": "<f4", "filters": [{"id": "delta"}]}))
        archive.writestr("a/0.0", bytes(99))
    packed = (tmp_path / "a.zip").read_bytes()
    for what in (9, 10, 11, 12):
        assert mutations.mutated(packed, [(what, 0.4, 1)]) != packed
    text = b'{"dtype": "<f4", "filters": [{"id": "delta"}]}'
    codecs = {mutations.mutated(text, [(12, 0.9, n)], ".zarray") for n in range(60)}
    assert any(b'"id": "pickle"' in one for one in codecs)
    assert any(
        b'"dtype": "|O"' in one
        for one in codecs | {mutations.mutated(text, [(12, 0.0, n)], ".zarray") for n in range(60)}
    )
    assert (
        mutations.mutated(text, [(11, 0.0, 1)], "a.json")
        == json.dumps({"dtype": -1, "filters": [{"id": "delta"}]}).encode()
    )
