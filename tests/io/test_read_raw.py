"""Raw lenslet images with the lattice of their lenslets."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from clplen.compute.device import Device
from clplen.errors import FormatError, ShapeError
from clplen.io import read_raw
from clplen.io.formats.picture import write_picture
from clplen.io.raw.raw_files import read_frame
from clplen.io.raw.raytrix import FocusType, RaytrixCalibration, write_raytrix
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.lenslet_lattice import Lattice

LATTICE = Lattice("square", (20.5, 30.25), (7, 0.1), (-0.1, 8), (41, 66))


@pytest.fixture
def frame() -> np.ndarray:
    return np.random.default_rng(5).integers(0, 60000, (41, 66)).astype(np.uint16)


@pytest.fixture
def calibration() -> RaytrixCalibration:
    types = tuple(FocusType((x, 0), (1 + abs(x), 4)) for x in (0, 1, -1))
    return RaytrixCalibration(
        (2.5, -3.0), 9.3, (1, 0), (0.5, -(0.75**0.5)), 0.01, 1.0, 2.1, (3, -(3**0.5)), None, types
    )


def test_a_raytrix_picture_with_its_lenses(
    tmp_path: Path, device: Device, frame: np.ndarray, calibration: RaytrixCalibration
):
    write_raytrix(tmp_path / "a.xml", calibration)
    with pytest.raises(FormatError, match=r"has no picture a .*give image="):
        read_raw(tmp_path / "a.xml", device=device)
    write_picture(tmp_path / "a.png", frame)
    raw = read_raw(tmp_path / "a.xml", device=device)
    np.testing.assert_array_equal(raw.to_numpy(), frame)
    assert np.isnan(raw.pixel_pitch)
    assert raw.lattice == calibration.lattice((41, 66))
    assert raw.lens_types == calibration.types()
    assert raw.sub_images == raw.cells == raw.lattice.grid((9, 9))
    assert "lenslets" in repr(raw)
    views = device.download(resample(raw.data, raw.sub_images, device))
    y, x = (n // 2 for n in raw.sub_images.count)
    assert views[:, :, y, x].std() > 1000  # a sub-image lies there


def test_a_calibration_without_lens_types(
    tmp_path: Path, device: Device, frame: np.ndarray, calibration: RaytrixCalibration
):
    write_raytrix(tmp_path / "a.xml", replace(calibration, lens_types=()))
    write_picture(tmp_path / "a.png", frame)
    for words in ({"path": "a.xml"}, {"path": "a.png", "grid": tmp_path / "a.xml"}):
        with pytest.raises(FormatError, match=r"a\.xml has no <lens_type>.*an element for each"):
            read_raw(tmp_path / words.pop("path"), device=device, **words)
    write_raytrix(tmp_path / "a.xml", calibration)
    raw = read_raw(tmp_path / "a.png", grid=tmp_path / "a.xml", device=device)
    assert raw.lens_types == calibration.types()


def test_colour_pictures_are_read_but_not_sliced(
    tmp_path: Path, device: Device, frame: np.ndarray, calibration: RaytrixCalibration
):
    colour = np.stack([frame, frame // 2, frame // 3], -1).astype(np.uint8)
    write_raytrix(tmp_path / "a.xml", calibration)
    write_picture(tmp_path / "other.png", colour)
    raw = read_raw(tmp_path / "a.xml", image=tmp_path / "other.png", device=device)
    np.testing.assert_array_equal(raw.to_numpy(), colour)
    assert raw.shape == (41, 66)
    with pytest.raises(ShapeError, match="colour picture of lenslets cannot be sliced"):
        resample(raw.data, raw.sub_images, device)


def test_a_frame_with_a_saved_grid(tmp_path: Path, device: Device, frame: np.ndarray):
    grid = tmp_path / "grid.json"
    write_picture(tmp_path / "a.tif", frame)
    write_picture(tmp_path / "b.tif", frame[1:])
    LATTICE.save(grid)
    raw = read_raw(tmp_path / "a.tif", grid=grid, device=device)
    np.testing.assert_array_equal(raw.to_numpy(), frame)
    assert (raw.lattice.row, raw.lattice.column) == (LATTICE.row, LATTICE.column)
    assert raw.lens_types == ()
    read, other = partial(read_raw, tmp_path / "a.tif"), r"of shape \(40, 66\), got \(41, 66\)"
    refused(
        (FormatError, r"a\.tif are unknown: give white=.*grid=", read),
        (ValueError, "not both", lambda: read(grid="g", white="w")),
        (FormatError, other, lambda: read_raw(tmp_path / "b.tif", grid=grid)),
    )


def a_white_image(pitch: float) -> np.ndarray:
    """Round lenslets on a square lattice, one of them at (40.3, 50.1)."""
    y, x = np.mgrid[:90, :110]
    waves = np.cos(2 * np.pi * (y - 40.3) / pitch) + np.cos(2 * np.pi * (x - 50.1) / pitch)
    return (8000 + 3000 * waves).astype(np.uint16)


def test_white_and_dark(tmp_path: Path, device: Device):
    frame = np.random.default_rng(5).integers(0, 60000, (90, 110)).astype(np.uint16)
    names = [tmp_path / f"{name}.tif" for name in ("raw", "white", "dark")]
    dark = np.random.default_rng(6).integers(0, 300, frame.shape).astype(np.uint16)
    for name, values in zip(names, (frame, a_white_image(9.3) + dark, dark), strict=True):
        write_picture(name, values)
    raw = read_raw(names[0], white=names[1], dark=names[2], device=device)
    np.testing.assert_array_equal(raw.to_numpy(), frame.astype(np.float32) - dark)
    assert raw.lattice.trust == "high"
    assert raw.lattice.pitch == pytest.approx((9.3, 9.3), rel=1e-3)
    away = (np.array((40.3, 50.1)) - raw.lattice.origin) / 9.3
    np.testing.assert_allclose(away, np.round(away), atol=0.02)
    write_picture(names[1], np.stack([a_white_image(9.3)] * 3, -1))
    write_picture(names[0], np.stack([frame] * 3, -1))
    colour = read_raw(names[0], white=names[1], device=device)
    assert colour.lattice.pitch == pytest.approx((9.3, 9.3), rel=1e-3)
    write_picture(names[1], frame[:, 1:])
    with pytest.raises(FormatError, match=r"white\.tif must have the shape .* got \(90, 109\)"):
        read_raw(names[0], white=names[1], device=device)


def test_frames_of_other_kinds(tmp_path: Path, frame: np.ndarray):
    write_picture(tmp_path / "a.png", frame)
    read, bayer = read_frame(tmp_path / "a.png")
    np.testing.assert_array_equal(read, frame)
    assert bayer is None
    (tmp_path / "a.dat").write_bytes(b"12345678")
    said = r"a\.dat is not a raw frame: give a picture"
    refused(
        (FormatError, "There is no file", lambda: read_frame(tmp_path / "b.png")),
        (FormatError, said, lambda: read_frame(tmp_path / "a.dat")),
    )
