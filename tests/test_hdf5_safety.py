"""Heaps of HDF5 that would keep the library busy for ever."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from clplen import hdf5_safety
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.hdf5_safety import require_heaps
from clplen.io import read_lightfield, write_lightfield
from clplen.lightfield.model.light_field import LightField


def test_an_object_without_a_size(tmp_path: Path, device: Device):
    path = tmp_path / "a.h5"
    values = np.zeros((1, 2, 3, 4), np.uint8)
    write_lightfield(path, LightField.from_array(values, device=device))
    good = path.read_bytes()
    heap = good.index(b"GCOL")
    require_heaps(path)
    read_lightfield(path, device=device)
    for place in (good.index(b"v:u:y:x", heap) - 16, good.index(b"calibrated", heap) - 16):
        path.write_bytes(good[:place] + bytes(16) + good[place + 16 :])
        with pytest.raises(FormatError, match=rf"a\.h5: the strings at byte {heap:,} are damaged"):
            read_lightfield(path, device=device)


def test_heaps_that_are_cut_off_end_themselves(tmp_path: Path):
    path = tmp_path / "a.h5"
    for rest in (b"", b"\1", b"\0\x10" + bytes(6), (1 << 40).to_bytes(8, "little") + b"\1" * 40):
        path.write_bytes(b"data GCOL\1\0\0\0" + rest)
        require_heaps(path)


def test_heaps_before_and_behind_a_hole(tmp_path: Path):
    path, mark = tmp_path / "a.h5", b"GCOL\1\0\0\0"
    size = 4096 - len(mark) + 3  # three zeros of the mark begin the hole, where they are not stored
    for place, heap in ((size, mark.rstrip(b"\0")), (1 << 30, mark + b"\x30" + bytes(39))):
        with path.open("wb") as file:
            file.seek(place)
            file.write(heap)
            file.truncate((1 << 30) + 64)
        with path.open("rb") as file:
            (first, end), *rest = hdf5_safety._extents(file.fileno(), path.stat().st_size)
        assert first <= place < place + len(mark) <= max([end, *(last for _, last in rest)])
        if place > size:
            with pytest.raises(FormatError, match=f"byte {place:,} are damaged"):
                require_heaps(path)


def test_groups_that_are_too_deep_or_too_many(
    tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "a.h5"
    write_lightfield(path, LightField.from_array(np.zeros((1, 2, 3, 4)), device=device))
    with h5py.File(path, "a") as file:
        group = file
        for _ in range(hdf5_safety.MAX_DEPTH - 1):
            group = group.create_group("g")
    read_lightfield(path, device=device)
    with h5py.File(path, "a") as file:
        file["/".join("g" * (hdf5_safety.MAX_DEPTH - 1))].create_group("g")
    with pytest.raises(FormatError, match=r"a\.h5 has more than .* levels of groups"):
        read_lightfield(path, device=device)
    with h5py.File(path, "a") as file:
        del file["g"]
        for name in "abc":
            file.create_dataset(f"few/{name}", data=np.zeros(2))
    read_lightfield(path, device=device)
    monkeypatch.setattr(hdf5_safety, "MAX_OBJECTS", 4)
    with pytest.raises(FormatError, match=r"a\.h5 has more than 4 links"):
        read_lightfield(path, device=device)


def test_every_dataset_is_listed_once(tmp_path: Path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        first = file.create_group("a/b")
        first["up"], first["root"], file["again"] = file["a"], file["/"], first
        first["nowhere"], first["self"] = h5py.SoftLink("/none"), h5py.SoftLink("/a/b/self")
        first["x"] = file["y"] = np.arange(3)
        file["z"] = file["y"]
        found = [name for name, _ in hdf5_safety.members(file, path)]
        assert len(found) == 2
        assert {file[name].id.get_offset() for name in found} == {
            file[name].id.get_offset() for name in ("a/b/x", "y")
        }
