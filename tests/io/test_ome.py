"""OME-TIFF: pictures, depth maps and time series, as other programs see them."""

from __future__ import annotations

import json
import logging
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import write_depth, write_image, write_stack
from clplen.io.raw.raw_files import read_frame
from clplen.io.store import ome_tiff
from clplen.lightfield.refocusing.focal_stacks import FocalStack

SPACING = (-1e-3, -1e-3, -2e-6, 3e-6)


def values(*shape: int) -> np.ndarray:
    return np.random.default_rng(4).normal(size=shape).astype(np.float32)


def require_valid(path: Path, *, sizes: dict[str, int], channels: int) -> dict[str, str]:
    """What the OME schema demands of an image, and how its planes lie in the file."""
    with tifffile.TiffFile(path) as file:
        assert file.is_ome
        pages = len(file.pages)
        root = ET.fromstring(file.ome_metadata)
    assert root.tag == "{http://www.openmicroscopy.org/Schemas/OME/2016-06}OME"
    (image,) = root.findall("{*}Image")
    order = [child.tag.rpartition("}")[2] for child in image]
    assert order == ["Description", "Pixels"]
    pixels = image.find("{*}Pixels")
    found = pixels.attrib
    assert {"ID", "DimensionOrder", "Type"} <= found.keys()
    assert found["Type"] == "float"
    assert {axis: int(found[f"Size{axis}"]) for axis in "XYZCT"} == sizes
    inside = [child.tag.rpartition("}")[2] for child in pixels]
    assert inside == ["Channel"] * channels + ["TiffData"] * inside.count("TiffData")
    samples = sum(int(c.get("SamplesPerPixel", 1)) for c in pixels.findall("{*}Channel"))
    assert samples == sizes["C"]
    planes = sum(int(data.get("PlaneCount", 1)) for data in pixels.findall("{*}TiffData"))
    assert planes == pages == sizes["Z"] * sizes["T"] * channels
    return found


@pytest.mark.parametrize("shape", [(5, 7), (7, 4, 3)])
def test_a_picture_knows_its_pixels(tmp_path: Path, device: Device, shape: tuple[int, ...]):
    data = values(*shape)
    path = tmp_path / "a.ome.tif"
    write_image(path, Image(device.upload(data), device), spacing=SPACING, description="linear")
    np.testing.assert_array_equal(tifffile.imread(path), data)
    colours = 3 if len(shape) == 3 else 1
    sizes = {"X": shape[1], "Y": shape[0], "Z": 1, "C": colours, "T": 1}
    found = require_valid(path, sizes=sizes, channels=1)
    assert float(found["PhysicalSizeX"]) == pytest.approx(3)
    assert float(found["PhysicalSizeY"]) == pytest.approx(2)
    assert found["PhysicalSizeXUnit"] == found["PhysicalSizeYUnit"] == "µm"
    text = ET.fromstring(tifffile.tiffcomment(path)).findtext("{*}Image/{*}Description")
    assert json.loads(text) == {"values": "linear"}


def a_depth(**maps: np.ndarray) -> SimpleNamespace:
    unknown = np.full((6, 5), np.nan, np.float32)
    given = {"disparity": values(6, 5), "confidence": abs(values(6, 5)), "alpha": unknown}
    return SimpleNamespace(**({"z": unknown} | given | maps))


def test_depth_has_named_channels(tmp_path: Path):
    depth = a_depth(z=values(6, 5) + 1)
    path = tmp_path / "d.ome.tiff"
    write_depth(path, depth, spacing=SPACING)
    expected = [depth.disparity, depth.confidence, depth.z]
    np.testing.assert_array_equal(tifffile.imread(path), expected)
    with tifffile.TiffFile(path) as file:
        assert file.series[0].axes == "CYX"
    sizes = {"X": 5, "Y": 6, "Z": 1, "C": 3, "T": 1}
    found = require_valid(path, sizes=sizes, channels=3)
    assert float(found["PhysicalSizeX"]) == pytest.approx(3)
    root = ET.fromstring(tifffile.tiffcomment(path))
    names = [channel.get("Name") for channel in root.iter() if channel.tag.endswith("}Channel")]
    assert names == ["disparity", "confidence", "z"]
    said = json.loads(root.findtext("{*}Image/{*}Description"))
    assert list(said) == names
    assert "metres" in said["z"]


def test_stacks_are_valid_and_large_ones_bigtiff(tmp_path: Path, device: Device, monkeypatch):
    for shape in ((4, 5, 7), (2, 5, 7, 3)):
        known = (np.arange(shape[0]), np.full(shape[0], np.nan))
        stack = FocalStack(device.upload(values(*shape)), device, *known, spacing=SPACING)
        write_stack(tmp_path / "s.tif", stack)
        colours = 3 if len(shape) == 4 else 1
        sizes = {"X": 7, "Y": 5, "Z": shape[0], "C": colours, "T": 1}
        require_valid(tmp_path / "s.tif", sizes=sizes, channels=1)
    with tifffile.TiffFile(tmp_path / "s.tif") as file:
        assert not file.is_bigtiff
    monkeypatch.setattr(ome_tiff, "BIG", 800)
    write_stack(tmp_path / "s.tif", stack)
    with tifffile.TiffFile(tmp_path / "s.tif") as file:
        assert file.is_bigtiff
        np.testing.assert_array_equal(file.asarray(), stack.to_numpy())


@pytest.fixture
def series(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """TCZYX of a microscope, as OME-TIFF."""
    data = np.random.default_rng(1).integers(0, 4000, (3, 2, 4, 9, 11)).astype(np.uint16)
    path = tmp_path / "t.ome.tif"
    tifffile.imwrite(path, data, metadata={"axes": "TCZYX"}, compression="zlib")
    return path, data


def test_one_frame_of_a_time_series(series: tuple[Path, np.ndarray], caplog):
    path, data = series
    with caplog.at_level(logging.INFO, "clplen.io"):
        frame, bayer = read_frame(path, frame=17)
    np.testing.assert_array_equal(frame, data[2, 0, 1])
    assert frame.dtype == np.uint16
    assert bayer is None
    assert caplog.messages == [f"read frame 17 of 24 (T = 2, C = 0, Z = 1) of {path}"]
    np.testing.assert_array_equal(read_frame(path, frame=0)[0], data[0, 0, 0])


def test_frames_that_are_not_there(series: tuple[Path, np.ndarray], tmp_path: Path):
    path, data = series
    with pytest.raises(FormatError, match=r"has 24 frames \(T = 3, C = 2, Z = 4\): give frame="):
        read_frame(path)
    for number in (24, -1):
        with pytest.raises(FormatError, match=rf"frame must .* got {number}: .*24 frames"):
            read_frame(path, frame=number)
    tifffile.imwrite(tmp_path / "one.tif", data[0, 0, 0])
    np.testing.assert_array_equal(read_frame(tmp_path / "one.tif", frame=0)[0], data[0, 0, 0])
    (tmp_path / "a.png").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"frame= requires a TIFF"):
        read_frame(tmp_path / "a.png", frame=1)
