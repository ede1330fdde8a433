"""Heaps of HDF5 that would keep the library busy for ever."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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
        with pytest.raises(FormatError, match=rf"a\.h5: the texts at byte {heap:,} are damaged"):
            read_lightfield(path, device=device)


def test_heaps_that_are_cut_off_end_themselves(tmp_path: Path):
    path = tmp_path / "a.h5"
    for rest in (b"", b"\1", b"\0\x10" + bytes(6), (1 << 40).to_bytes(8, "little") + b"\1" * 40):
        path.write_bytes(b"data GCOL\1\0\0\0" + rest)
        require_heaps(path)
