"""What is written of results is read back: stacks, depth, pictures, truths, points, parameters."""

from __future__ import annotations

import math
from pathlib import Path

import h5py
import numpy as np
import pytest

from clplen.cameras.scenes.ground_truth import Truth
from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import (
    HciParameters,
    read_depth,
    read_image,
    read_npy,
    read_parameters,
    read_ply,
    read_scene_truth,
    read_stack,
    write_depth,
    write_image,
    write_npy,
    write_parameters,
    write_ply,
    write_stack,
    write_truth,
)
from clplen.io.store import picture_series
from clplen.lightfield.depth.depth_maps import DepthMap
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.outputs import is_ours

SPACING = (-1e-3, -1e-3, -2e-6, 3e-6)
SERIES = ["a.ome.tif", "a.tif", "a.zarr"]


def values(*shape: int) -> np.ndarray:
    return np.random.default_rng(6).normal(size=shape).astype(np.float32)


def test_a_focal_stack(tmp_path_factory: pytest.TempPathFactory, device: Device):
    for shape in [(2, 7, 5, 3), (1, 7, 5), (3, 7, 5, 1)]:
        for name in SERIES:
            tmp_path = tmp_path_factory.mktemp("case")
            disparities = np.linspace(-1, 1, shape[0])
            alphas = np.where(disparities < 0, np.nan, 1.5)
            data = values(*shape)
            stack = FocalStack(device.upload(data), device, disparities, alphas, SPACING)
            write_stack(tmp_path / name, stack)
            found = read_stack(tmp_path / name, device=device)
            assert found.shape == shape
            np.testing.assert_array_equal(found.to_numpy(), data)
            np.testing.assert_array_equal(found.disparities, disparities)
            np.testing.assert_array_equal(found.alphas, alphas)
            assert found.spacing is not None
            np.testing.assert_allclose(found.spacing, (math.nan, math.nan, 2e-6, 3e-6))
            write_stack(tmp_path / f"again-{name}", found)
            np.testing.assert_array_equal(
                read_stack(tmp_path / f"again-{name}").disparities, disparities
            )


def test_a_focal_stack_is_read_in_parts(
    tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch
):
    data = values(2, 1030, 3, 3)  # two chunks high
    stack = FocalStack(device.upload(data), device, np.arange(2.0), np.ones(2))
    write_stack(tmp_path / "a.zarr", stack)
    monkeypatch.setattr(picture_series, "_BLOCK_BYTES", 1)
    np.testing.assert_array_equal(read_stack(tmp_path / "a.zarr", device=device).to_numpy(), data)


def test_a_picture(tmp_path_factory: pytest.TempPathFactory, device: Device):
    for shape in [(7, 5, 3), (7, 5, 1), (1, 5)]:
        for name in SERIES:
            tmp_path = tmp_path_factory.mktemp("case")
            data = values(*shape)
            write_image(tmp_path / name, Image(device.upload(data), device), spacing=SPACING)
            np.testing.assert_array_equal(
                read_image(tmp_path / name, device=device).to_numpy(), data
            )
            with pytest.raises(FormatError, match="has no disparities for its"):
                read_stack(tmp_path / name, device=device)


def test_a_depth_map(tmp_path: Path):
    for has_z in [True, False]:
        for name in [f"{has_z}.ome.tif", f"{has_z}.zarr", "a.pfm", "a.tif"]:
            disparity, confidence = values(2, 7, 5)
            unknown = np.full_like(disparity, np.nan)
            depth = DepthMap(disparity, unknown, disparity + 1 if has_z else unknown, confidence)
            write_depth(tmp_path / name, depth, spacing=SPACING)
            found = read_depth(tmp_path / name)
            np.testing.assert_array_equal(found.disparity, disparity)
            np.testing.assert_array_equal(found.alpha, unknown)
            holds_all = name.startswith(str(has_z))
            np.testing.assert_array_equal(found.z, depth.z if holds_all else unknown)
            np.testing.assert_array_equal(found.confidence, confidence if holds_all else unknown)


def test_what_is_another_thing(tmp_path: Path, device: Device):
    stack = FocalStack(device.upload(values(2, 7, 5)), device, np.arange(2.0), np.ones(2))
    write_stack(tmp_path / "a.ome.tif", stack)
    with pytest.raises(FormatError, match="must have one picture, got 2"):
        read_image(tmp_path / "a.ome.tif", device=device)
    with pytest.raises(FormatError, match="has no names for its maps"):
        read_depth(tmp_path / "a.ome.tif")
    with pytest.raises(FormatError, match="There is no focal stack"):
        read_stack(tmp_path / "none.tif", device=device)
    content = (tmp_path / "a.ome.tif").read_bytes()
    (tmp_path / "b.ome.tif").write_bytes(content[: len(content) // 2])
    with pytest.raises(FormatError, match=r"b\.ome\.tif"):
        read_stack(tmp_path / "b.ome.tif", device=device)


def test_a_truth(tmp_path: Path):
    for has_z in [True, False]:
        disparity, z = values(2, 7, 5)
        truth = Truth(
            disparity,
            z if has_z else np.full_like(z, np.nan),
            np.arange(35, dtype=np.int32).reshape(7, 5) - 1,
            {"edges": disparity > 0, "planes": disparity < 0},
        )
        write_truth(tmp_path / "a.h5", truth)
        found = read_scene_truth(tmp_path / "a.h5")
        for name in ("disparity", "z", "surface"):
            np.testing.assert_array_equal(getattr(found, name), getattr(truth, name))
            assert getattr(found, name).dtype == getattr(truth, name).dtype
        assert found.masks.keys() == truth.masks.keys()
        for name, mask in truth.masks.items():
            np.testing.assert_array_equal(found.masks[name], mask)
    for wrong in (2.0**31, np.nan):
        with h5py.File(tmp_path / "a.h5", "a") as file:
            del file["surface"]
            file["surface"] = np.full((7, 5), wrong)
        with pytest.raises(FormatError, match=r"a\.h5 is damaged"):
            read_scene_truth(tmp_path / "a.h5")


def test_points(tmp_path: Path):
    for coloured in [True, False]:
        points = values(9, 3)
        colours = np.arange(27, dtype=np.uint8).reshape(9, 3) if coloured else None
        write_ply(tmp_path / "a.ply", points, colours, comment="metres")
        found, seen = read_ply(tmp_path / "a.ply")
        np.testing.assert_array_equal(found, points)
        assert (seen is None) == (colours is None)
        if colours is not None and seen is not None:
            np.testing.assert_array_equal(seen, colours)
        content = (tmp_path / "a.ply").read_bytes()
        for damaged, message in (
            (content[:-5], "has 8 of 9 points"),
            (content.replace(b"vertex 9", b"vertex 99999999999"), "has 9 of 99,999,999,999"),
            (content.replace(b"float x", b"list uchar int x"), "not a readable PLY"),
            (b"ply\nformat ascii 1.0\nend_header\n", "not a binary PLY"),
            (b"", "not a binary PLY"),
        ):
            (tmp_path / "b.ply").write_bytes(damaged)
            with pytest.raises(FormatError, match=message):
                read_ply(tmp_path / "b.ply")


def test_a_numpy_file(tmp_path: Path):
    write_npy(tmp_path / "a.npy", values(3, 4))
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy"), values(3, 4))
    with pytest.raises(FormatError, match=r"needs 48 bytes, more than 10"):
        read_npy(tmp_path / "a.npy", max_bytes=10)
    with pytest.raises(ValueError, match="must be real numbers, got complex128"):
        write_npy(tmp_path / "c.npy", np.ones(3, complex))
    np.save(tmp_path / "b.npy", np.array(["text"]))
    with pytest.raises(FormatError, match="must hold real numbers"):
        read_npy(tmp_path / "b.npy")


def test_parameters(tmp_path: Path):
    parameters = HciParameters(
        focal_length_mm=100.5, num_cams_x=9, disp_min=-1.5, scene="cotton", category="training"
    )
    write_parameters(tmp_path, parameters)
    assert read_parameters(tmp_path) == parameters
    assert is_ours(tmp_path / "parameters.cfg")
