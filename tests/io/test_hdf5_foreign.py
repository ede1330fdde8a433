"""HDF5 of other programs: HCI, MATLAB 7.3, plenoptomos, and the truth beside the samples."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from refusals import refused

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield, read_truth

SHAPE = (3, 5, 7, 11, 3)  # prime and all different, but for the colours


def values_of(shape: tuple[int, ...] = SHAPE, dtype: Any = np.uint8) -> np.ndarray:
    return np.random.default_rng(8).integers(1, 250, shape).astype(dtype)


def write_matlab(path: Path, **variables: np.ndarray) -> None:
    """As MATLAB writes version 7.3: axes reversed, behind a block of 512 bytes with its name."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in variables.items():
            file[name.replace("__", "/")] = values.T
            file[name.replace("__", "/")].attrs["MATLAB_class"] = np.bytes_(values.dtype.name)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def write_hci_2013(path: Path, **attributes: Any) -> tuple[np.ndarray, np.ndarray]:
    """The samples and the depth."""
    depth = np.random.default_rng(9).uniform(8, 20, SHAPE[:4]).astype(np.float32)
    depth[1, 2, 3, 4] = 0
    known = {"dH": 0.1, "focalLength": [900.0], "shift": np.float32(2.5)}
    with h5py.File(path, "w") as file:
        file["LF"] = values_of()
        file["GT_DEPTH"] = depth
        file.attrs.update({k: v for k, v in (known | attributes).items() if v is not None})
    return values_of(), depth


def test_hci_2013(tmp_path: Path, device: Device, caplog: pytest.LogCaptureFixture):
    values, depth = write_hci_2013(tmp_path / "lf.h5")
    with caplog.at_level(logging.INFO, logger="clplen.io"):
        lf = read_lightfield(tmp_path / "lf.h5", device=device, flip_u=True)
    np.testing.assert_array_equal(lf.to_numpy(), values[:, ::-1])
    assert "the dataset 'LF' with axes v:u:y:x:c (guessed), flip_u" in caplog.text
    truth = read_truth(tmp_path / "lf.h5")
    assert truth.dtype == np.float32
    assert np.isnan(truth[3, 4])
    expected = 0.1 * 900 / np.where(depth == 0, np.nan, depth)[1, 2].astype(float) - 2.5
    np.testing.assert_allclose(truth, expected, rtol=1e-6)  # rounded once to float32


def test_hci_2016_in_hdf5(tmp_path: Path, device: Device):
    maps = np.random.default_rng(9).normal(size=(2, 7, 11)).astype(np.float32)
    with h5py.File(tmp_path / "scene.h5", "w") as file:
        file["LF"] = values_of()
        file["disp_lowres"], file["disp_highres"] = maps[0], np.kron(maps[1], np.ones((2, 2)))
        file["depth_lowres"] = maps[1]
    lf = read_lightfield(tmp_path / "scene.h5", device=device)
    np.testing.assert_array_equal(lf.to_numpy(), values_of())
    np.testing.assert_array_equal(read_truth(tmp_path / "scene.h5"), maps[0])
    high = read_truth(tmp_path / "scene.h5", dataset="disp_highres")
    np.testing.assert_array_equal(high[::2, 1::2], maps[1])


def test_a_truth_that_is_not_there(tmp_path: Path):
    path = tmp_path / "lf.h5"
    refused((FormatError, r"There is no HDF5 file .*lf\.h5", lambda: read_truth(path)))
    write_hci_2013(path, shift=None, dH=[1.0, 2.0])
    held = r"no dataset 'disp'; it has GT_DEPTH \(3, 5, 7, 11\)"
    no_map = r"'/LF' must be a map .* shape \(3, 5, 7, 11, 3\)"
    refused(
        (
            FormatError,
            r"lf\.h5 must have the numbers dH, shift .* d = dH focalLength",
            lambda: read_truth(path),
        ),
        (FormatError, held, lambda: read_truth(path, dataset="disp")),
        (FormatError, no_map, lambda: read_truth(path, dataset="LF")),
    )
    for name, values, message in (
        ("LF", values_of(), "has no true disparity, neither"),
        ("GT_DEPTH", np.ones((2, 3, 4, 5)), "with a centre view"),
    ):
        with h5py.File(path, "w") as file:
            file[name] = values
        refused((FormatError, message, lambda: read_truth(path)))


def test_lftoolbox_7_3(tmp_path: Path, device: Device):
    for dtype, channels in [
        (np.uint8, 0),
        (np.float32, 1),
        (np.uint16, 2),
        (np.uint8, 3),
        (np.float32, 4),
    ]:
        values = values_of((3, 5, 7, 11, channels)[: 5 if channels else 4], dtype)
        if channels in (2, 4):
            values[2, 4, ..., -1] = 0
            values[1, 3, ..., :-1] = 0
        write_matlab(tmp_path / "a.mat", LF=values, other=np.ones((3, 3, 3, 3)))
        lf = read_lightfield(tmp_path / "a.mat", device=device)
        assert lf.dtype == dtype
        if channels not in (2, 4):
            np.testing.assert_array_equal(lf.to_numpy(), values)
            continue
        colours = values[..., 0] if channels == 2 else values[..., :3]
        np.testing.assert_array_equal(lf.to_numpy(), colours)
        full = 1 if dtype == np.float32 else np.iinfo(dtype).max
        weights = values[..., -1].mean(axis=(2, 3)) / full
        weights[1, 3] = 0  # dark throughout
        assert weights[2, 4] == 0
        np.testing.assert_allclose(lf.weights, weights, rtol=1e-6)


def test_a_matlab_array_of_another_name(
    tmp_path: Path, device: Device, caplog: pytest.LogCaptureFixture
):
    values = values_of((2, 3, 5, 4, 4))
    write_matlab(tmp_path / "a.mat", spectra=values)
    with caplog.at_level(logging.INFO, logger="clplen.io"):
        lf = read_lightfield(tmp_path / "a.mat", device=device, order="uvxyc")
    np.testing.assert_array_equal(lf.to_numpy(), values.transpose(1, 0, 3, 2, 4))  # no weight
    assert "axes u:v:x:y:c (as given) of MATLAB, reversed in HDF5" in caplog.text


def test_a_matlab_struct_of_hci_2016(tmp_path: Path, device: Device):
    truth = np.random.default_rng(9).normal(size=(7, 11)).astype(np.float32)
    write_matlab(tmp_path / "LF.mat", LF__LF=values_of(dtype=float), LF__disp_lowres=truth)
    lf = read_lightfield(tmp_path / "LF.mat", device=device)
    np.testing.assert_array_equal(lf.to_numpy(), values_of())
    np.testing.assert_array_equal(read_truth(tmp_path / "LF.mat"), truth)


def test_plenoptomos(tmp_path: Path, device: Device):
    for order in ["v:u:t:s", "t:s:v:u", "s:v:t:u"]:
        values = values_of(SHAPE[:4], np.float32)
        letters = order.replace(":", "")
        with h5py.File(tmp_path / "a.vox", "w") as file:
            file["data/image"] = values.transpose(["vuts".index(letter) for letter in letters])
            file["data/image"].attrs.update(
                {"axes": order, "units": "counts", "mode": "micro-image"}
            )
            file["data/white"] = np.ones_like(values)
        lf = read_lightfield(tmp_path / "a.vox", device=device)
        np.testing.assert_array_equal(lf.to_numpy(), values)


def write_raw(path: Path, values: np.ndarray, pitch: Any, offset: float = 0) -> None:
    """As plenoptomos writes a light field: rows V y + v, columns U x + u."""
    v, u, y, x = values.shape
    with h5py.File(path, "w") as file:
        picture = values.transpose(2, 0, 3, 1).reshape(y * v, x * u)
        file.create_dataset("data/image", data=picture, compression="gzip")
        file["data/image"].attrs.update({"axes": "tau:sigma", "mode": "raw"})
        camera = file.create_group("instrument/camera")
        camera["micro_lens/size"] = np.array([v, u], np.int32)
        camera["micro_lens/physical_size"] = np.array(pitch, np.float32) * 5e-3
        camera["sensor/pixel_size"] = np.array([5e-3, 5e-3], np.float32)
        camera["micro_lenses_array/position"] = np.array([0, 0, 9], np.float32)
        camera["sensor/position"] = np.array([offset, offset, 10], np.float32)


def test_a_raw_picture_of_plenoptomos(tmp_path: Path, device: Device):
    values = values_of(SHAPE[:4], np.uint16)
    write_raw(tmp_path / "a.vox", values, (3, 5))
    lf = read_lightfield(tmp_path / "a.vox", device=device)
    np.testing.assert_array_equal(lf.to_numpy(), values)


def test_a_raw_picture_that_has_to_be_decoded(tmp_path: Path, device: Device):
    values = values_of(SHAPE[:4], np.uint16)
    write_raw(tmp_path / "a.vox", values, (3.01, 5))
    with pytest.raises(FormatError, match=r"got 3\.01 x 5 pixels .* save 'data/image' as TIFF"):
        read_lightfield(tmp_path / "a.vox", device=device)
    write_raw(tmp_path / "a.vox", values, (3, 5), offset=0.01)
    with pytest.raises(FormatError, match="from 2 x 2 on"):
        read_lightfield(tmp_path / "a.vox", device=device)
    write_raw(tmp_path / "a.vox", values, (3, 5))
    with h5py.File(tmp_path / "a.vox", "a") as file:
        file["instrument/camera/micro_lens/size"][:] = 3, 6
        file["instrument/camera/micro_lens/physical_size"][:] = 15e-3, 30e-3
    with pytest.raises(FormatError, match=r"multiple of its lenslets .* got \(21, 55\)"):
        read_lightfield(tmp_path / "a.vox", device=device)
    with h5py.File(tmp_path / "a.vox", "a") as file:
        del file["instrument/camera/sensor/position"]
    with pytest.raises(
        FormatError, match="raw picture without 'instrument/camera/sensor/position'"
    ):
        read_lightfield(tmp_path / "a.vox", device=device)
