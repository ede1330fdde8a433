"""Light fields in HDF5: everything comes back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from clplen.cameras.camera import PlenopticCamera
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield, write_lightfield
from clplen.lightfield.lightfield import LightField
from clplen.wave.lenslets import MicrolensArray

SHAPE = (3, 4, 5, 7, 2)


def light_field(device: Device, dtype: type = np.uint16) -> LightField:
    values = np.random.default_rng(3).integers(1, 200, SHAPE).astype(dtype)
    weights = np.linspace(0.5, 1, 12, dtype=np.float32).reshape(SHAPE[:2])
    weights[2, 1] = 0
    return LightField.from_array(
        values, device=device, spacing=(-1e-4, -2e-4, 3e-5, 4e-5), weights=weights
    )


def a_camera(device: Device):
    lenslets = MicrolensArray(
        140e-6,
        9e-3,
        count=(31, 33),
        lattice="hexagonal",
        fill="circular",
        diameter=120e-6,
        offset=(3e-6, -2e-6),
        rotation=0.01,
    )
    return PlenopticCamera.type1(
        focal_length=0.1,
        mla=lenslets,
        wavelength=633e-9,
        pixels_per_lenslet=28.5,
        device=device,
        object_distance=0.3,
        aperture_diameter=2e-3,
        field_lens=True,
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_everything_comes_back(tmp_path: Path, device: Device, dtype: type):
    lf = replace(light_field(device, dtype), camera=a_camera(device), decode="naive")
    write_lightfield(tmp_path / "a.h5", lf)
    again = read_lightfield(tmp_path / "a.h5", device=device)
    assert again.dtype == dtype
    assert again.spacing == lf.spacing
    assert again.decode == "naive"
    assert again.camera == lf.camera
    np.testing.assert_array_equal(again.to_numpy(), lf.to_numpy())
    np.testing.assert_array_equal(again.weights, lf.weights)
    assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]


def test_a_light_field_that_knows_nothing(tmp_path: Path, device: Device):
    lf = LightField.from_array(np.ones((1, 2, 3, 4), np.float32), device=device)
    write_lightfield(tmp_path / "a.h5", lf)
    again = read_lightfield(tmp_path / "a.h5", device=device)
    assert (again.spacing, again.camera, again.shape) == (None, None, (1, 2, 3, 4))


def test_layout_of_the_file(tmp_path: Path, device: Device):
    lf = replace(light_field(device), camera=a_camera(device))
    write_lightfield(tmp_path / "a.h5", lf)
    with h5py.File(tmp_path / "a.h5") as file:
        data = file["lightfield"]
        assert data.attrs["axes"] == "v:u:y:x:c"
        np.testing.assert_array_equal(data.attrs["spacing"], lf.spacing)
        np.testing.assert_array_equal(data.attrs["centre"], (1.0, 1.5))
        assert data.attrs["wavelength"] == 633e-9
        assert file["weights"].shape == SHAPE[:2]
        assert file["camera"].attrs["mla_f"] == 9e-3


def test_any_order_of_axes_is_honoured(tmp_path: Path, device: Device):
    values = np.random.default_rng(4).random(SHAPE, dtype=np.float32)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["lightfield"] = values.transpose(4, 3, 0, 2, 1)
        file["lightfield"].attrs["axes"] = "c:x:v:y:u"
    lf = read_lightfield(tmp_path / "a.h5", device=device)
    np.testing.assert_array_equal(lf.to_numpy(), values)


def test_axes_that_do_not_fit(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["lightfield"] = np.ones((2, 2, 3, 3), np.uint8)
        file["lightfield"].attrs["axes"] = "v:u:y:x:c"
    with pytest.raises(FormatError, match=r"shape \(2, 2, 3, 3\) with axes 'vuyxc'"):
        read_lightfield(tmp_path / "a.h5", device=device)


def test_another_dataset(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["LF"] = np.ones((2, 2, 3, 3), np.uint8)
    with pytest.raises(FormatError, match="no dataset 'lightfield'; it holds LF"):
        read_lightfield(tmp_path / "a.h5", device=device)


def test_a_group_and_words_are_no_samples(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("lightfield/x")
    with pytest.raises(FormatError, match="'lightfield'; it holds the group lightfield"):
        read_lightfield(tmp_path / "a.h5", device=device)
    for values, kind in ((["a", "b"], "object"), (np.ones((1, 1, 2, 2), complex), "complex128")):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["lightfield"] = values
        with pytest.raises(FormatError, match=rf"of .*a\.h5 holds {kind}, no real numbers"):
            read_lightfield(tmp_path / "a.h5", device=device)


def test_what_is_wrong_inside_names_the_file(tmp_path: Path, device: Device):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["lightfield"] = np.ones((2, 2, 3, 3), np.float32)
        file["lightfield"].attrs["spacing"] = [1, 2]
    with pytest.raises(ValueError, match=r"^.*a\.h5: spacing is \(dv, du, dy, dx\)"):
        read_lightfield(tmp_path / "a.h5", device=device)
    write_lightfield(tmp_path / "a.h5", replace(light_field(device), camera=a_camera(device)))
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["camera"].attrs["mla_pitch"] = -1.0
    with pytest.raises(FormatError, match=r"The camera in .*a\.h5 is none: "):
        read_lightfield(tmp_path / "a.h5", device=device)


@pytest.mark.parametrize("part", [0.05, 0.5, 0.95])
def test_a_truncated_file(tmp_path: Path, device: Device, part: float):
    write_lightfield(tmp_path / "a.h5", light_field(device))
    whole = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(FormatError, match=r"a\.h5 is truncated or damaged"):
        read_lightfield(tmp_path / "a.h5", device=device)


def test_a_camera_that_lacks_a_parameter(tmp_path: Path, device: Device):
    write_lightfield(tmp_path / "a.h5", replace(light_field(device), camera=a_camera(device)))
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file["camera"].attrs["mla_pitch"]
    with pytest.raises(FormatError, match=r"camera in .* lacks 'mla_pitch'"):
        read_lightfield(tmp_path / "a.h5", device=device)


def test_words_of_folders_are_refused(tmp_path: Path, device: Device):
    write_lightfield(tmp_path / "a.h5", light_field(device))
    with pytest.raises(ValueError, match="pattern=, allow_missing= does not apply to HDF5"):
        read_lightfield(tmp_path / "a.h5", device=device, pattern="{v}{u}", allow_missing=True)


def test_another_suffix(tmp_path: Path, device: Device):
    with pytest.raises(ValueError, match=r"written to \.h5 or to a new folder, not to a\.npy"):
        write_lightfield(tmp_path / "a.npy", light_field(device))
