"""``clplen score``."""

from __future__ import annotations

import json
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner, Result
from command_line import said

from clplen.cli import main
from clplen.io import write_pfm

TRUTH = np.random.default_rng(2).uniform(-1, 1, (40, 50)).astype(np.float32)


def run(*words: object) -> Result:
    return CliRunner().invoke(main, ["score", *(str(word) for word in words)])


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    """A map of 40 x 50, in PFM."""
    write_pfm(tmp_path / "truth.pfm", TRUTH)
    return tmp_path / "truth.pfm"


def test_a_table_and_json(truth: Path, tmp_path: Path) -> None:
    wrong = TRUTH.copy()
    wrong[20, 20] += 0.5
    wrong[21, 20] = np.nan
    tifffile.imwrite(tmp_path / "found.tif", wrong)
    result = run(tmp_path / "found.tif", truth)
    assert result.exit_code == 0, result.output
    assert "BadPix 0.07" in result.output
    values = json.loads(run(tmp_path / "found.tif", truth, "--json").output)
    assert values["pixels"] == 200
    assert values["badpix_07"] == pytest.approx(1)
    assert values["missing"] == pytest.approx(0.5)
    assert values["mae_planes"] is None
    np.save(tmp_path / "empty.npy", TRUTH * np.nan)
    values = json.loads(run(tmp_path / "empty.npy", truth, "--json").output)
    assert (values["q25"], values["mse"]) == ("infinite", None)


def test_offset_border_and_mask(truth: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "cut.npy", TRUTH[5:, 3:])
    values = json.loads(run(tmp_path / "cut.npy", truth, "--offset", 5, 3, "--json").output)
    assert (values["pixels"], values["badpix_01"]) == (200, 0)
    mask = np.zeros((40, 50), np.uint8)
    mask[18:20] = 255
    imageio.imwrite(tmp_path / "mask.png", mask)
    words = ("--mask", tmp_path / "mask.png", "--border", 10, "--json")
    assert json.loads(run(truth, truth, *words).output)["pixels"] == 60


def test_what_lies_beside_a_truth_of_the_benchmark_is_used(tmp_path: Path) -> None:
    write_pfm(tmp_path / "gt_disp_lowres.pfm", TRUTH)
    for word, level in (("planes", 255), ("fine", 0), ("fine_surrounding", 255)):
        imageio.imwrite(tmp_path / f"mask_{word}_lowres.png", np.full((40, 50), level, np.uint8))
    (tmp_path / "parameters.cfg").write_text(
        "[intrinsics]\nfocal_length_mm = 100\nimage_resolution_x_px = 50\n"
        "image_resolution_y_px = 40\nsensor_size_mm = 35\n"
        "[extrinsics]\nbaseline_mm = 45\nfocus_distance_m = 8\n[meta]\nscene = s\n"
    )
    write_pfm(tmp_path / "found.pfm", TRUTH + np.float32(0.2))
    result = run(tmp_path / "found.pfm", tmp_path / "gt_disp_lowres.pfm", "--json")
    values = json.loads(result.output)
    assert (values["fattening"], values["thinning"], values["edges"]) == (100, None, None)
    assert values["bumpiness_planes"] == pytest.approx(0, abs=1e-4)
    assert 0 < values["mae_planes"] < 45
    assert values["mae_smooth"] is None


def test_bad_input_is_one_sentence(truth: Path, tmp_path: Path) -> None:
    picture = tmp_path / "depth.png"
    imageio.imwrite(picture, np.zeros((40, 50), np.uint8))
    assert "levels are not disparities" in said(run(picture, truth))
    assert "There is no disparity map" in said(run(tmp_path / "none.pfm", truth))
    np.save(tmp_path / "cut.npy", TRUTH[5:, 3:])
    assert "--offset" in said(run(tmp_path / "cut.npy", truth))
    assert "No pixel is left" in said(run(truth, truth, "--border", 20))
    imageio.imwrite(tmp_path / "mask.png", np.zeros((4, 5), np.uint8))
    assert "4 x 5 pixels" in said(run(truth, truth, "--mask", tmp_path / "mask.png"))
