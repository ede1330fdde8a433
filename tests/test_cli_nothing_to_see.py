"""Light fields in which nothing can be found, and arrays that may be several things."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import invoke_on as run

from clplen import read_lightfield
from clplen.compute.device import Device
from clplen.errors import FormatError

PLANES = ["--disparities", "-1:1:5"]


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).random(shape, np.float32)


NOTHING = {
    "black": (np.zeros((5, 5, 40, 50), np.float32), "the views show no detail, they are black"),
    "black colours": (np.zeros((5, 5, 40, 50, 3), np.uint8), "no detail, they are black"),
    "constant": (np.full((5, 5, 40, 50), 7, np.uint8), "the views show no detail."),
    "bright": (np.full((4, 4, 40, 50), 3e4, np.float32), "the views show no detail."),
    "one view": (random(1, 1, 40, 50), "a single view looks alike"),
}


def test_nothing_is_the_sharpest(tmp_path: Path, device: Device):
    for name in NOTHING:
        values, reason = NOTHING[name]
        np.save(tmp_path / "lf.npy", values)
        result = run(device, "stack", tmp_path / "lf.npy", "-o", tmp_path / "s.tif", *PLANES)
        assert result.exit_code == 0, result.output
        assert "holds 5 planes; no plane is the sharpest" in result.stdout
        assert reason in result.stdout
        assert "number 0" not in result.output
        assert "sharpest plane is" not in result.output
        words = (
            "refocus",
            tmp_path / "lf.npy",
            "-o",
            tmp_path / "r.tif",
            "--all-in-focus",
            *PLANES,
        )
        result = run(device, *words)
        assert result.exit_code == 0, result.output
        assert "none of them the sharpest" in result.output


def test_little_detail_is_still_found(tmp_path: Path, device: Device):
    """A contrast of a thousandth, at any level; and one row of views."""
    for scale in (1e-6, 1, 1e4):
        for shape in ((5, 5, 60, 70), (1, 5, 60, 70)):
            values = scale * (1 + 1e-3 * random(*shape))
            np.save(tmp_path / "lf.npy", values.astype(np.float32))
            result = run(device, "stack", tmp_path / "lf.npy", "-o", tmp_path / "s.tif", *PLANES)
            assert "the sharpest is number" in result.stdout, result.output


def test_a_depth_map_of_nothing_says_so(tmp_path: Path, device: Device):
    np.save(tmp_path / "lf.npy", np.zeros((5, 5, 40, 50), np.float32))
    result = run(device, "depth", tmp_path / "lf.npy", "-o", tmp_path / "d.pfm", *PLANES)
    assert result.exit_code == 0, result.output
    assert "0 % of the pixels are reliable" in result.stdout
    assert "too little detail to measure" in result.stdout


MANY = {
    "views last": (40, 40, 3, 3),
    "views last, colours": (40, 50, 5, 5, 3),
    "pictures in colour": (9, 64, 80, 3),
    "many small pictures": (100, 100, 8, 8),
}


@pytest.mark.parametrize("kind", ["npy", "h5"])
@pytest.mark.parametrize("name", MANY)
def test_more_views_than_pixels_are_asked_for(tmp_path: Path, device: Device, name: str, kind: str):
    values = random(*MANY[name])
    path = tmp_path / f"lf.{kind}"
    if kind == "npy":
        np.save(path, values)
    else:
        with h5py.File(path, "w") as file:
            file["LF"] = values
    with pytest.raises(FormatError, match=r"more views than pixels: .* order='vuyxc?'.*'yxvuc?'"):
        read_lightfield(path, device=device)
    own = "vuyxc"[: values.ndim]
    assert read_lightfield(path, device=device, order=own).shape == values.shape
    turned = read_lightfield(path, device=device, order="yxvuc"[: values.ndim])
    assert turned.shape[:2] == values.shape[2:4]
    result = run(device, "stack", path, "-o", tmp_path / "s.tif", *PLANES)
    assert result.exit_code == 1
    assert "--order yxvu" in " ".join(result.output.split())
    assert not (tmp_path / "s.tif").exists()


def test_pictures_are_no_light_fields(tmp_path: Path, device: Device):
    for shape in ((40, 50, 3), (40, 50), (5, 5, 9, 9, 3, 2)):
        np.save(tmp_path / "lf.npy", random(*shape))
        with pytest.raises(FormatError, match="must have 4 or 5 dimensions"):
            read_lightfield(tmp_path / "lf.npy", device=device)
