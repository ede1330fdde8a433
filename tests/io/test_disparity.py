"""Disparity maps of other programs."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile

from clplen.errors import FormatError
from clplen.io import read_disparity, write_pfm

SHAPE = (5, 7)


def disparity() -> np.ndarray:
    values = np.random.default_rng(8).normal(size=SHAPE).astype(np.float32)
    values[1, 2] = np.nan
    return values


def test_pfm(tmp_path: Path):
    for start in ["Pf\n7 5\n-1\n", "Pf # a\n# b 3\n7\n#c\n5\n-1.5e0 \r\n", "Pf 7 5 1\n"]:
        order = "<f4" if "-1" in start else ">f4"
        rows = disparity()[::-1].astype(order).tobytes()
        (tmp_path / "a.pfm").write_bytes(start.encode() + rows)
        np.testing.assert_array_equal(read_disparity(tmp_path / "a.pfm"), disparity())


def test_tiff_and_npy(tmp_path: Path):
    for dtype in [">f4", "<f8"]:
        values = disparity().astype(dtype)
        np.save(tmp_path / "a.npy", values)
        np.save(tmp_path / "t.npy", np.asfortranarray(values))
        tifffile.imwrite(tmp_path / "a.tif", values, byteorder=dtype[0])
        for name in ("a.npy", "t.npy", "a.tif"):
            again = read_disparity(tmp_path / name, shape=SHAPE)
            assert again.dtype == np.float32
            assert again.dtype.isnative
            np.testing.assert_array_equal(again, values.astype(np.float32))


def test_integers_are_refused_in_one_sentence(tmp_path: Path):
    imageio.imwrite(tmp_path / "a.png", np.ones(SHAPE, np.uint8))
    np.save(tmp_path / "a.npy", np.ones(SHAPE, int))
    for name, dtype in (("a.png", "uint8"), ("a.npy", "int64")):
        with pytest.raises(FormatError) as caught:
            read_disparity(tmp_path / name)
        assert str(caught.value) == (
            f"{tmp_path / name} must hold floats, got {dtype}, whose levels are not disparities "
            "in pixels: give PFM, a TIFF of floats or .npy."
        )


def test_other_shapes(tmp_path: Path):
    write_pfm(tmp_path / "a.pfm", np.ones((5, 7, 3)))
    with pytest.raises(FormatError, match=r"map must have shape \(y, x\), got \(5, 7, 3\)"):
        read_disparity(tmp_path / "a.pfm")
    np.save(tmp_path / "a.npy", np.ones((7, 5)))
    with pytest.raises(FormatError, match=r"must have 5 x 7 pixels \(y, x\), got 7 x 5"):
        read_disparity(tmp_path / "a.npy", shape=SHAPE)
    np.save(tmp_path / "a.npy", np.ones((0, 5)))
    with pytest.raises(FormatError, match=r"got \(0, 5\)|Cannot read"):
        read_disparity(tmp_path / "a.npy")


def npy(header: str, values: bytes = bytes(140)) -> bytes:
    return b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header.encode() + values


def test_damage(tmp_path: Path):
    for content in [
        b"\x93NUMPY",
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (99999, 99999)}"),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296)}"),
        npy("{'descr': '<f4', 'fortran_order': False, 'shape': (-5, 7)}"),
        npy("{'descr': '|O', 'fortran_order': False, 'shape': (5, 7)}"),
        npy("{'descr': '<f4', 'fortran_order': False"),
        npy("[" * 1000),
        b"Pf\n7 5\n-1\n" + bytes(139),
        b"Pf\n999999999 999999999\n-1\n" + bytes(140),
        b"Pf\n0 5\n-1\n" + bytes(140),
        b"Pf\n7 5\n-.e\n" + bytes(140),
        b"Pf\n" + b"9" * 5000 + b" 5\n-1\n" + bytes(140),
        b"Pf\n" + b" " * 10**6,
        b"hello",
    ]:
        (tmp_path / "a.dat").write_bytes(content)
        tracemalloc.start()
        with pytest.raises(FormatError, match=r"a\.dat"):
            read_disparity(tmp_path / "a.dat")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2 * len(content) + (1 << 20)
