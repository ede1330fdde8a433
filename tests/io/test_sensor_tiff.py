"""Mosaics of sensors in files: TIFF that any reader opens, HDF5, and their way to colour views."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile

from clplen import LightField, MicrolensArray, PlenopticCamera, Sensor, SurfaceScene
from clplen.cameras import ColorFilterArray, PixelArray, Plane
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield, read_raw, write_raw
from clplen.lightfield import Lattice, RawImage

SENSOR = Sensor(5e3, full_well=6000.0, bit_depth=12, black_level=128, white_level=4000)
PER_UNIT = 5e3 * (4000 - 128) / 6000


def camera_of(device: Device, filters: ColorFilterArray | None = None) -> Any:
    """Lenslets 9 pixels apart."""
    return PlenopticCamera.type1(
        focal_length=0.04, object_distance=0.4, aperture_diameter=5e-3, wavelength=540e-9,
        mla=MicrolensArray(36e-6, 0.28e-3, count=(41, 43), fill="full"), device=device,
        pixels=PixelArray(pitch=4e-6, filters=filters),
    )  # fmt: skip


@pytest.fixture(scope="module")
def exposed(device: Device) -> dict[str, RawImage]:
    """Raw images of three colours each, by rays, and what two mosaics make of them."""
    even = camera_of(device).expose(SurfaceScene(Plane(0.0)), model="rays")
    light = even.to_numpy() / even.to_numpy().max()
    y, x = np.indices(light.shape)
    waves = {
        "R": 0.9 + 0.1 * np.cos(y / 30), "G": 0.6 + 0.2 * np.sin(x / 40), "B": 0.3 + 5e-4 * (x - y),
    }  # fmt: skip
    found = {
        name: replace(even, data=device.upload((light * wave).astype(np.float32)))
        for name, wave in waves.items()
    }
    for filters in (ColorFilterArray.bayer("GRBG"), ColorFilterArray.quad_bayer("RGGB")):
        tile = np.array(filters.tile)
        names = tile[y % len(tile), x % len(tile)]
        mosaic = np.select([names == name for name in waves], [light * w for w in waves.values()])
        found["GRBG" if len(tile) == 2 else "quad"] = replace(
            even, data=device.upload(mosaic.astype(np.float32)), mosaic=filters.tile,
            camera=camera_of(device, filters),
        )  # fmt: skip
    return found


def colours_of(exposed: dict[str, RawImage]) -> np.ndarray[Any, Any]:
    """Views of the three colours without noise or mosaic, in digital numbers."""
    views = [LightField.from_raw(exposed[name]).to_numpy() for name in "RGB"]
    return np.stack(views, axis=-1) * PER_UNIT


def test_any_reader_opens_the_tiff_and_finds_the_tags(
    exposed: dict[str, RawImage], tmp_path: Path
) -> None:
    raw = SENSOR.record(exposed["GRBG"])
    raw.save(tmp_path / "raw.tif")
    values = imageio.imread(tmp_path / "raw.tif")
    assert values.dtype == np.uint16
    np.testing.assert_array_equal(values, raw.to_numpy())
    with tifffile.TiffFile(tmp_path / "raw.tif") as file:
        tags = file.pages.first.tags
        assert tags[33421].value == (2, 2)  # CFARepeatPatternDim
        assert bytes(tags[33422].value) == bytes([1, 0, 2, 1])  # CFAPattern: green 1, red 0, blue 2
        assert tags[50714].value == (1280000, 10000)  # BlackLevel, rational
        assert tags[50717].value == 4000  # WhiteLevel
        down, across = tags[282].value
        assert down / across == pytest.approx(0.01 / 4e-6)
    write_raw(tmp_path / "white.tif", raw, white_balance=(2.0, 1.0, 1.6))
    with tifffile.TiffFile(tmp_path / "white.tif") as file:
        neutral = np.array(file.pages.first.tags[50728].value, float)
        np.testing.assert_allclose(neutral[::2] / neutral[1::2], [0.5, 1, 0.625])


@pytest.mark.parametrize("name", ["GRBG", "quad"])
@pytest.mark.parametrize("suffix", [".h5", ".tif"])
def test_from_exposure_to_views_in_colour(
    exposed: dict[str, RawImage], tmp_path: Path, device: Device, name: str, suffix: str
) -> None:
    """Exposed, saved, read and decoded: the views of noise-free colour planes."""
    raw, path = SENSOR.record(exposed[name]), tmp_path / f"raw{suffix}"
    raw.save(path)
    if suffix == ".h5":
        again = read_raw(path, device=device)
        assert again.mosaic == raw.mosaic
        assert again.levels == raw.levels
        assert again.camera.pixels == raw.camera.pixels
        np.testing.assert_array_equal(again.to_numpy(), raw.to_numpy())
        views = LightField.from_raw(again).to_numpy()
    else:
        lattice = tmp_path / "lattice.json"
        lattice_of(raw).save(lattice)
        # without a white image, the dark rims of pupils 9 pixels wide bend what is fitted within
        views = read_lightfield(
            path, grid=lattice, views=(9, 9), step=1, demosaic="after", device=device
        ).to_numpy()
    wanted = colours_of(exposed)
    if suffix == ".tif":  # lenslets whose views all lie on the picture
        cut = (np.array(wanted.shape[2:4]) - views.shape[2:4]) // 2
        assert (cut <= 1).all()
        wanted = wanted[:, :, cut[0] : len(wanted[0, 0]) - cut[0], cut[1] : -cut[1] or None]
    assert views.shape == wanted.shape
    inner = (slice(2, -2), slice(2, -2), slice(2, -2), slice(2, -2))
    error = (views - wanted)[inner] / wanted[inner].mean(axis=(0, 1, 2, 3))
    # what a mosaic lacks comes from neighbours, of four by four filters as far as the pupil's rim;
    # the black level would be .07, another colour .3
    rms = np.sqrt((error**2).mean(axis=(0, 1, 2, 3)))
    assert rms.max() < {"GRBG": 0.05, "quad": 0.12}[name]
    assert np.abs(np.median(error, axis=(0, 1, 2, 3))).max() < 0.02


def lattice_of(raw: RawImage) -> Lattice:
    grid = raw.sub_images
    return Lattice("square", grid.first, grid.row_step, grid.column_step, raw.shape)


def test_black_levels_and_white_balance_of_a_captured_frame(
    exposed: dict[str, RawImage], tmp_path: Path, device: Device
) -> None:
    raw = exposed["GRBG"]
    words: dict[str, Any] = {"views": (9, 9), "step": 1, "device": device}
    lattice_of(raw).save(tmp_path / "lattice.json")
    words["grid"] = tmp_path / "lattice.json"
    plain = replace(SENSOR, black_level=0, white_level=4000 - 128).record(raw)
    write_raw(tmp_path / "plain.tif", plain)
    write_raw(tmp_path / "lifted.tif", SENSOR.record(raw), white_balance=(2.0, 1.0, 1.6))
    first, second = (
        read_lightfield(tmp_path / f"{name}.tif", **words).to_numpy()
        for name in ("plain", "lifted")
    )
    lit = first > 200
    assert lit.mean() > 0.3
    factors = np.broadcast_to([2.0, 1.0, 1.6], first.shape)
    np.testing.assert_allclose(second[lit], (first * factors)[lit], atol=1.2 * 2)
    # the colours that are told win over the file's
    other = read_lightfield(tmp_path / "plain.tif", bayer="RGGB", **words).to_numpy()
    assert np.abs(other - first).max() > 100


def test_what_tiff_cannot_keep(exposed: dict[str, RawImage], tmp_path: Path) -> None:
    path, raw = tmp_path / "raw.tif", SENSOR.record(exposed["GRBG"])
    deep = replace(SENSOR, bit_depth=17, white_level=None).record(exposed["GRBG"])
    clear = replace(raw, mosaic=(("R", "clear"),))
    for one, name, words, said in (
        (exposed["GRBG"], path, {}, "TIFF needs the digital numbers of a sensor"),
        (deep, path, {}, "up to 16 bits"),
        (clear, path, {}, "no number for the filter 'clear'"),
        (raw, path, {"white_balance": (1.0, 0.0, 2.0)}, "three factors above 0"),
        (raw, tmp_path / "raw.h5", {"white_balance": (1.0, 1.0, 2.0)}, "requires TIFF"),
    ):
        with pytest.raises(ValueError, match=said):
            write_raw(name, one, **words)
    assert not path.exists()


def changed(path: Path, code: int, **entry: int) -> None:
    """Overwrite the count or the inline value of a tag."""
    content = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        at = file.pages.first.tags[code].offset
    if "count" in entry:
        content[at + 4 : at + 8] = struct.pack("<I", entry["count"])
    if "value" in entry:
        content[at + 8 : at + 12] = struct.pack("<I", entry["value"])
    path.write_bytes(bytes(content))


def test_damaged_tags_are_refused(exposed: dict[str, RawImage], tmp_path: Path) -> None:
    raw, path = SENSOR.record(exposed["GRBG"]), tmp_path / "raw.tif"
    lattice = tmp_path / "lattice.json"
    lattice_of(raw).save(lattice)
    for code, entry, said in (
        (33422, {"value": 0x01020900}, "CFAPattern must hold"),
        (33421, {"value": 3}, "33421|CFAPattern"),
        (50713, {"value": 0x00020002}, "BlackLevel must hold 2 x 2 numbers, got 1"),
    ):
        write_raw(path, raw)
        changed(path, code, **entry)
        with pytest.raises(FormatError, match=said):
            read_raw(path, grid=lattice)
