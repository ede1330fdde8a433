"""Focal stacks, disparities and pictures as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from clplen.errors import FormatError, ShapeError
from clplen.io import read_pfm, read_picture, write_pfm, write_picture


def test_pfm_keeps_values_and_rows(tmp_path: Path):
    for shape in [(5, 7), (5, 7, 3)]:
        values = np.random.default_rng(2).normal(size=shape).astype(np.float32)
        values[1, 2] = np.inf
        write_pfm(tmp_path / "a.pfm", values)
        np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), values)


def test_pfm_is_what_the_format_says(tmp_path: Path):
    write_pfm(tmp_path / "a.pfm", np.array([[1, 2, 3], [4, 5, 6]], np.float32))
    head, rows = b"Pf\n3 2\n-1.00000000000000000000\n", np.array([4, 5, 6, 1, 2, 3], "<f4")
    assert (tmp_path / "a.pfm").read_bytes() == head + rows.tobytes()  # the lower row first


def test_pfm_that_is_damaged(tmp_path: Path):
    path = tmp_path / "a.pfm"
    refused((FormatError, "no file", lambda: read_pfm(path)))
    path.write_bytes(b"P6\n3 2\n255\n")
    refused((FormatError, r"a\.pfm is not a PFM file", lambda: read_pfm(path)))
    path.write_bytes(b"Pf\n3 2\n-1\n" + bytes(20))
    refused(
        (FormatError, r"truncated: \(2, 3\) samples need 24 bytes, got 20", lambda: read_pfm(path)),
        (ShapeError, r"got \(2, 3, 4\)", lambda: write_pfm(path, np.zeros((2, 3, 4)))),
    )


def test_shapes_that_are_no_picture(tmp_path: Path):
    for suffix in [".png", ".tif"]:
        for shape in [(4,), (3, 4, 1), (3, 4, 2), (0, 4)]:
            with pytest.raises(ShapeError, match=r"shape \(y, x\) or \(y, x, 3\), got"):
                write_picture(tmp_path / f"a{suffix}", np.zeros(shape, np.uint8))


def test_types_of_pictures(tmp_path: Path):
    for shape in ((3, 5), (1, 9, 3), (3, 4, 3)):
        mask = np.random.default_rng(3).random(shape) > 0.5
        write_picture(tmp_path / "a.tif", mask)
        np.testing.assert_array_equal(read_picture(tmp_path / "a.tif"), mask.astype(np.uint8))
    with pytest.raises(ValueError, match="real numbers, got complex64"):
        write_picture(tmp_path / "a.tif", np.zeros((2, 3), np.complex64))
