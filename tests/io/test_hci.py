"""Parameters and truth of the HCI 4D benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clplen import io
from clplen.errors import FormatError
from clplen.io import HciParameters, read_parameters, write_pfm
from clplen.io.results import hci

CFG = """
[intrinsics]
focal_length_mm = 100
image_resolution_x_px = 512
image_resolution_y_px = 384
sensor_size_mm = 35
fstop = 100.0

[extrinsics]
num_cams_x = 9
num_cams_y = 7
baseline_mm = 50.5
focus_distance_m = 7.5
center_cam_x_m = 0.25

[meta]
scene = cotton %(100)
category = training
disp_min = -1.4
disp_max = 1.5
depth_map_scale = 10.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parameters.cfg").write_text(CFG)
    return tmp_path


def test_parameters(folder: Path):
    expected = HciParameters(
        focal_length_mm=100, sensor_size_mm=35, fstop=100, image_resolution_x_px=512,
        image_resolution_y_px=384, num_cams_x=9, num_cams_y=7, baseline_mm=50.5,
        focus_distance_m=7.5, disp_min=-1.4, disp_max=1.5, depth_map_scale=10,
        scene="cotton %(100)", category="training",
    )  # fmt: skip
    for path in (folder, folder / "parameters.cfg"):
        assert read_parameters(path) == expected
    assert isinstance(read_parameters(folder).num_cams_x, int)


def test_disparity_and_depth(folder: Path):
    parameters = read_parameters(folder)
    depth = np.array([[5.0, 7.5, 9.0], [30.0, np.inf, 4.0]])
    # the larger pixel count 512, all in mm
    by_hand = 50.5 * 100 * 512 * (1 / (1000 * depth) - 1 / 7500) / 35
    disparity = parameters.disparity(depth)
    np.testing.assert_allclose(disparity, by_hand, rtol=1e-12, atol=1e-12)
    assert disparity[0, 1] == 0
    assert disparity[0, 0] > 0  # nearer is larger
    np.testing.assert_allclose(parameters.depth(disparity), depth, rtol=1e-12)
    assert parameters.depth(disparity[1, 1] - 1) == np.inf
    assert parameters.disparity(0.0) == np.inf


def test_planes(folder: Path):
    planes = read_parameters(folder).planes()
    np.testing.assert_allclose(planes, np.linspace(-1.4, 1.5, 30), atol=1e-12)
    planes = read_parameters(folder).planes(step=0.4)
    assert (planes[0], planes[-1]) == (-1.4, 1.5)
    assert np.diff(planes).max() <= 0.4
    assert len(planes) == 9
    with pytest.raises(ValueError, match="disp_min must be less than disp_max"):
        HciParameters(disp_min=1.0).planes()
    for step in (0, -1, np.nan, 1e-9):
        with pytest.raises(ValueError, match="must be positive and give less than a million"):
            read_parameters(folder).planes(step=step)


def test_what_is_not_said_is_none(tmp_path: Path):
    with pytest.raises(FormatError, match=r"no file .*parameters\.cfg; some scenes"):
        read_parameters(tmp_path)
    (tmp_path / "parameters.cfg").write_text("[meta]\nscene = a\nother = 3\n[else]\nx = y\n")
    parameters = read_parameters(tmp_path)
    assert parameters == HciParameters(scene="a")
    with pytest.raises(ValueError, match="needs baseline_mm, focal_length_mm, sensor_size_mm, foc"):
        parameters.disparity(3)
    (tmp_path / "parameters.cfg").write_bytes(bytes(2 << 20))
    with pytest.raises(FormatError, match="too large"):
        read_parameters(tmp_path)


def test_damaged_parameters(folder: Path):
    for change, said in [
        (("100\n", "many\n"), "focal_length_mm must be a positive number, got 'many'"),
        (("= 512", "= 512.5"), "image_resolution_x_px must be a positive integer, got '512.5'"),
        (("= 35", "= -35"), "sensor_size_mm must be a positive number, got '-35'"),
        (("-1.4", "nan"), "disp_min must be a number, got 'nan'"),
        (("[meta]", "[extrinsics]"), "not a readable INI file .*already exists"),
        (("[intrinsics]", "intrinsics"), "not a readable INI file .*no section headers"),
        ((CFG, "[other]\nx = 1\n"), "none of the sections intrinsics, extrinsics, meta"),
        ((CFG, ""), "none of the sections"),
        (("cotton", "\udcff"), "not a readable INI file"),
    ]:
        text = CFG.replace(*change)
        (folder / "parameters.cfg").write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(FormatError, match=rf"parameters\.cfg.*{said}"):
            read_parameters(folder)


def test_truth(folder: Path):
    with pytest.raises(FormatError, match=r"no true disparity .*gt_disp_lowres\.pfm is missing"):
        hci.read_truth(folder)
    depth = np.random.default_rng(9).uniform(5, 9, (5, 7)).astype(np.float32)
    write_pfm(folder / "gt_depth_lowres.pfm", depth)
    by_hand = 50.5 * 100 * 512 * (1 / (1000 * depth.astype(float)) - 1 / 7500) / 35
    np.testing.assert_allclose(hci.read_truth(folder), by_hand, rtol=1e-6, atol=1e-6)
    disparity = np.random.default_rng(9).normal(size=(5, 7)).astype(np.float32)
    write_pfm(folder / "gt_disp_lowres.pfm", disparity)
    write_pfm(folder / "gt_disp_highres.pfm", 2 * disparity)
    np.testing.assert_array_equal(hci.read_truth(folder), disparity)
    np.testing.assert_array_equal(hci.read_truth(folder, high=True), 2 * disparity)
    np.testing.assert_array_equal(io.read_truth(folder), disparity)
    with pytest.raises(FormatError, match="is a folder without a dataset 'disp_highres'"):
        io.read_truth(folder, dataset="disp_highres")
    (folder / "gt_disp_lowres.pfm").unlink()
    (folder / "parameters.cfg").write_text("[meta]\nscene = a\n")
    with pytest.raises(FormatError, match=r"parameters\.cfg: Depth in metres needs baseline_mm"):
        hci.read_truth(folder)
