"""Damaged files of every format: one clear error, or a light field, and never much memory.

A few files of each format here, always the same ones; ``benchmarks/fuzz.py`` makes others for as
long as wanted.
"""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import fuzzing
import mutations
import pytest

from clplen.compute.device import Device

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
