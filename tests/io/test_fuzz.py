"""Damaged files of every format: one clear error, or a light field, and never much memory.

``benchmarks/fuzz.py`` does the same for as long as wanted.
"""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import fuzzing
import mutations
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_picture, write_picture

OPERATIONS = st.lists(
    st.tuples(
        st.integers(0, mutations.KINDS - 1),
        st.floats(0, 1, exclude_max=True),
        st.integers(0, 2**32 - 1),
    ),
    min_size=1,
    max_size=4,
)


@pytest.mark.parametrize("name", fuzzing.PARSERS)
def test_good_files_are_read(tmp_path: Path, one_device: Device, name: str):
    parser = fuzzing.PARSERS[name]
    path = parser.make(tmp_path, one_device)
    assert fuzzing.outcome(parser, path, one_device)[0] == "read"


@pytest.mark.parametrize("name", fuzzing.PARSERS)
def test_damaged_files_are_refused(
    tmp_path_factory: pytest.TempPathFactory, one_device: Device, name: str
):
    parser = fuzzing.PARSERS[name]
    good = parser.make(tmp_path_factory.mktemp("good"), one_device)

    @settings(
        max_examples=12,
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(OPERATIONS, st.integers(0, 99))
    def refused(operations: list[mutations.Operation], seed: int) -> None:
        folder = tmp_path_factory.mktemp("bad")
        shutil.copytree(good.parent, folder, dirs_exist_ok=True)
        path = folder / good.name
        mutations.damage(path, operations, random.Random(seed))
        _, peak = fuzzing.outcome(parser, path, one_device)
        assert peak <= 4 * fuzzing.size_of(path) + fuzzing.SLACK

    refused()


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
