"""Raw images with their cameras in HDF5, and light fields with cameras of both kinds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from refusals import refused

from clplen import LightField, MicrolensArray, PlenopticCamera
from clplen.cameras.optics.camera_aberrations import Aberrations, LensletScatter
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield, read_raw, write_lightfield, write_raw
from clplen.io.raw.raw_files import is_raw_file
from clplen.lightfield.raw.raw_image import RawImage


def camera_of(device: Device, kind: str) -> Any:
    """Odd numbers throughout."""
    words: dict[str, Any] = {
        "focal_length": 0.031, "wavelength": 532e-9, "pixels_per_lenslet": 13.5, "device": device,
        "image_distance": 0.067,
    }  # fmt: skip
    mla = {"count": (11, 13), "offset": (1.3e-5, -2e-5), "rotation": 0.02, "diameter": 140e-6}
    if kind == "type1":
        array = MicrolensArray(150e-6, 10e-3, fill="circular", **mla)
        return PlenopticCamera.type1(mla=array, field_lens=True, **words)
    if kind == "galilean":
        array = MicrolensArray(150e-6, 12e-3, fill="full", **mla)
        return PlenopticCamera.type2(mla=array, a=-0.021, aperture_diameter=1.1e-3, **words)
    lengths = (10e-3, 11e-3, 9.7e-3)
    array = MicrolensArray(150e-6, lengths, lattice="hexagonal", fill="full", **mla)
    bent = Aberrations(
        main_lens={5: 1.3e-7}, scatter=LensletScatter(tilt=1e-4, seed=5), sensor_shift=3e-5
    )
    return PlenopticCamera.type2(
        mla=array, m=0.17, aperture_diameter=1.2e-3, aberrations=bent, **words
    )


def raw_of(device: Device, kind: str, channels: tuple[int, ...] = ()) -> RawImage:
    camera = camera_of(device, kind)
    values = np.random.default_rng(3).normal(size=(*camera.grid.shape, *channels))
    return camera.raw_image(device.upload(values.astype(np.float32)))


@pytest.mark.parametrize(
    ("kind", "channels"), [("type1", ()), ("galilean", (3,)), ("hexagonal", ())]
)
def test_a_raw_image_and_its_camera_come_back(
    tmp_path: Path, device: Device, kind: str, channels: tuple[int, ...]
) -> None:
    raw = raw_of(device, kind, channels)
    write_raw(tmp_path / "raw.h5", raw)
    assert is_raw_file(tmp_path / "raw.h5")
    back = read_raw(tmp_path / "raw.h5", device=device)
    np.testing.assert_array_equal(back.to_numpy(), raw.to_numpy())
    assert back.camera == raw.camera
    for name in ("sub_images", "cells", "spacing", "lens_types", "pixel_pitch"):
        assert getattr(back, name) == getattr(raw, name)
    if kind != "type1":
        for name in ("m", "a", "b", "array_distance"):
            assert getattr(back.camera, name) == getattr(raw.camera, name)


def test_a_light_field_keeps_a_focused_camera(tmp_path: Path, device: Device) -> None:
    camera = camera_of(device, "hexagonal")
    lf = LightField.from_array(np.zeros((2, 3, 4, 5)), device=device, camera=camera)
    write_lightfield(tmp_path / "a.h5", lf)
    assert read_lightfield(tmp_path / "a.h5", device=device).camera == camera
    pytest.importorskip("zarr")
    write_lightfield(tmp_path / "a.zarr", lf)
    assert read_lightfield(tmp_path / "a.zarr", device=device).camera == camera


def test_what_makes_no_raw_file(tmp_path: Path, device: Device) -> None:
    raw, path = raw_of(device, "galilean"), tmp_path / "raw.h5"
    suffixes = r"must end in \.h5 .* or \.tif .* got .*raw\.npy"
    write_raw(path, raw)
    refused(
        (ValueError, suffixes, lambda: write_raw(tmp_path / "raw.npy", raw)),
        (ValueError, "TIFF needs the digital", lambda: write_raw(tmp_path / "raw.tif", raw)),
        (ValueError, "has no camera of", lambda: write_raw(path, replace(raw, camera=None))),
        (FormatError, "raw image, not a light field", lambda: read_lightfield(path)),
        (ValueError, "white=, dark= and grid= do not", lambda: read_raw(path, white="w.tif")),
        (ValueError, "image= and frame= do not apply", lambda: read_raw(path, frame=1)),
    )

    def smaller(file: h5py.File) -> None:
        values = file["raw"][1:]
        del file["raw"]
        file["raw"] = values

    many = {"aberrations": Aberrations().to_json(), "mla_count": (10**5, 10**5)}
    for change, said in (
        (smaller, "must hold real numbers on the sensor of its camera"),
        (lambda file: file.pop("camera"), "does not describe the camera"),
        (lambda file: file.pop("raw"), "has no dataset 'raw'"),
        (lambda file: file["camera"].attrs.pop("m"), "has no parameter 'm'"),
        (lambda file: file["camera"].attrs.update(m=-2.0), "before the array"),
        (lambda file: file["camera"].attrs.update(aberrations="{"), "is invalid"),
        (lambda file: file["camera"].attrs.update(many), "lenslets are more than 10,000,000"),
        (lambda file: file["camera"].attrs.update(mla_f=np.zeros(3)), "not 0"),
    ):
        write_raw(path, raw)
        with h5py.File(path, "a") as file:
            change(file)
        refused((FormatError, said, lambda: read_raw(path, device=device)))
    path.write_bytes(path.read_bytes()[:900])
    refused((FormatError, "truncated or damaged", lambda: read_raw(path, device=device)))
    assert not is_raw_file(tmp_path / "none.h5")
