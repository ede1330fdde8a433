"""Focal stacks, disparities and pictures as files."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from clplen.compute.device import Device
from clplen.errors import FormatError, ShapeError
from clplen.io import (
    read_pfm,
    read_picture,
    write_depth,
    write_pfm,
    write_picture,
    write_stack,
)
from clplen.lightfield.refocusing.focal_stacks import FocalStack


def a_stack(device: Device, shape: tuple[int, ...], **known) -> FocalStack:
    values = np.random.default_rng(2).normal(size=shape).astype(np.float32)
    d = np.linspace(-1, 2, shape[0])
    alphas = known.pop("alphas", np.full(shape[0], np.nan))
    return FocalStack(device.upload(values), device, d, alphas, **known)


@pytest.mark.parametrize(
    ("shape", "axes"),
    [((5, 7, 9), "ZYX"), ((2, 7, 9, 3), "ZYXS"), ((3, 5, 3), "ZYX"), ((4, 3, 5, 3), "ZYXS")],
)
def test_a_stack_is_one_series(tmp_path: Path, device: Device, shape: tuple[int, ...], axes: str):
    stack = a_stack(device, shape)
    write_stack(tmp_path / "s.tif", stack)
    again = tifffile.imread(tmp_path / "s.tif")
    assert again.dtype == np.float32
    np.testing.assert_array_equal(again, stack.to_numpy())
    with tifffile.TiffFile(tmp_path / "s.tif") as file:
        assert file.is_ome
        assert [series.axes for series in file.series] == [axes]
        assert len(file.pages) == shape[0]


def test_a_stack_says_what_its_planes_are(tmp_path: Path, device: Device):
    camera = SimpleNamespace(dz=lambda alpha: (alpha - 1) / 10)
    alphas = np.array([0.75, 1.0, 1.5])
    stack = a_stack(
        device, (3, 4, 5), alphas=alphas, camera=camera, spacing=(-1e-3, -1e-3, 2e-6, 3e-6)
    )
    write_stack(tmp_path / "s.tif", stack)
    root = ET.fromstring(tifffile.tiffcomment(tmp_path / "s.tif"))
    name = "{*}Image/{*}"
    said = json.loads(root.findtext(f"{name}Description"))
    assert said["disparities"] == [-1.0, 0.5, 2.0]
    assert said["alphas"] == [0.75, 1.0, 1.5]
    assert said["dz_m"] == pytest.approx([-0.025, 0, 0.05])
    pixels = root.find(f"{name}Pixels").attrib
    assert float(pixels["PhysicalSizeX"]) == pytest.approx(3)
    assert float(pixels["PhysicalSizeY"]) == pytest.approx(2)
    assert pixels["PhysicalSizeXUnit"] == "µm"


def test_unknown_alphas_are_null(tmp_path: Path, device: Device):
    write_stack(tmp_path / "s.tif", a_stack(device, (2, 4, 5)))
    root = ET.fromstring(tifffile.tiffcomment(tmp_path / "s.tif"))
    assert json.loads(root.findtext("{*}Image/{*}Description"))["alphas"] == [None, None]


def test_a_stack_in_another_format(tmp_path: Path, device: Device):
    with pytest.raises(ValueError, match=r"written as \.tif or \.zarr, not as s\.png"):
        write_stack(tmp_path / "s.png", a_stack(device, (2, 4, 5)))


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_pfm_keeps_values_and_rows(tmp_path: Path, shape: tuple[int, ...]):
    values = np.random.default_rng(2).normal(size=shape).astype(np.float32)
    values[1, 2] = np.inf
    write_pfm(tmp_path / "a.pfm", values)
    np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), values)


def test_pfm_is_what_the_format_says(tmp_path: Path):
    write_pfm(tmp_path / "a.pfm", np.array([[1, 2, 3], [4, 5, 6]], np.float32))
    lower_row_first = np.array([4, 5, 6, 1, 2, 3], "<f4").tobytes()
    assert (
        tmp_path / "a.pfm"
    ).read_bytes() == b"Pf\n3 2\n-1.00000000000000000000\n" + lower_row_first


def test_pfm_of_others(tmp_path: Path):
    rows = np.array([4, 5, 6, 1, 2, 3], ">f4").tobytes()
    (tmp_path / "a.pfm").write_bytes(b"Pf\n# made elsewhere\n3 2\n1.000\n" + rows)
    np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), [[1, 2, 3], [4, 5, 6]])


def test_pfm_that_is_damaged(tmp_path: Path):
    path = tmp_path / "a.pfm"
    with pytest.raises(FormatError, match="no file"):
        read_pfm(path)
    path.write_bytes(b"P6\n3 2\n255\n")
    with pytest.raises(FormatError, match=r"a\.pfm is not a PFM file"):
        read_pfm(path)
    path.write_bytes(b"Pf\n3 2\n-1\n" + bytes(20))
    with pytest.raises(FormatError, match=r"truncated: \(2, 3\) samples need 24 bytes, 20 are"):
        read_pfm(path)
    with pytest.raises(ShapeError, match=r"not \(2, 3, 4\)"):
        write_pfm(path, np.zeros((2, 3, 4)))


@pytest.mark.parametrize("suffix", [".pfm", ".tif"])
def test_depth_is_written_as_disparity(tmp_path: Path, suffix: str):
    disparity = np.random.default_rng(2).normal(size=(5, 7)).astype(np.float32)
    write_depth(tmp_path / f"d{suffix}", SimpleNamespace(disparity=disparity))
    read = read_pfm if suffix == ".pfm" else read_picture
    np.testing.assert_array_equal(read(tmp_path / f"d{suffix}"), disparity)


def test_depth_in_another_format(tmp_path: Path):
    with pytest.raises(ValueError, match=r"\.pfm, \.tif or \.zarr, not as d\.png"):
        write_depth(tmp_path / "d.png", SimpleNamespace(disparity=np.zeros((2, 2), np.float32)))


@pytest.mark.parametrize("shape", [(4,), (3, 4, 1), (3, 1, 1), (3, 4, 2), (3, 4, 4), (0, 4)])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_shapes_that_are_no_picture(tmp_path: Path, shape: tuple[int, ...], suffix: str):
    with pytest.raises(ShapeError, match=r"shape \(y, x\) or \(y, x, 3\), not"):
        write_picture(tmp_path / f"a{suffix}", np.zeros(shape, np.uint8))


def test_types_of_pictures(tmp_path: Path):
    for shape in ((3, 5), (1, 9, 3), (3, 4, 3)):
        mask = np.random.default_rng(3).random(shape) > 0.5
        write_picture(tmp_path / "a.tif", mask)
        np.testing.assert_array_equal(read_picture(tmp_path / "a.tif"), mask.astype(np.uint8))
    with pytest.raises(ValueError, match="real numbers, not complex64"):
        write_picture(tmp_path / "a.tif", np.zeros((2, 3), np.complex64))


def test_png_takes_integers_only(tmp_path: Path):
    values = np.arange(12, dtype=np.uint8).reshape(3, 4)
    write_picture(tmp_path / "a.png", values)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), values)
    with pytest.raises(ValueError, match=r"a\.png cannot hold float32"):
        write_picture(tmp_path / "a.png", values.astype(np.float32))
