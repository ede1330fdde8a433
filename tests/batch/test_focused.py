"""Raw images of focused cameras in a job: what is made of them, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import tifffile
from batchworks import run

from clplen.compute.device import Device
from clplen.io import read_raw
from clplen.lightfield.focused.focused_depth import focused_depth, focused_maps
from clplen.lightfield.focused.focused_rendering import focused_stack, render_focused

CAMERA = """
[camera]
kind = "plenoptic2"
m = 0.2
focal_length_mm = 30.0
wavelength_nm = 532
pixels_per_lenslet = 16
[camera.microlenses]
pitch_um = 150
focal_length_mm = 10
count = [11, 12]
fill = "full"
"""
JOB = """
output = "out"
[[scenes]]
kind = "plane"
seeds = 8
camera = "camera.toml"
"""


def test_stack_depth_and_a_sharp_picture(tmp_path: Path, device: Device) -> None:
    (tmp_path / "camera.toml").write_text(CAMERA)
    job = tmp_path / "job.toml"
    job.write_text(JOB + "[stack]\nalphas = [0.95, 1.05]\n[depth]\n[all_in_focus]\n")
    summary, _ = run(job, device)
    assert summary.failed == {}
    (folder,) = (path for path in (tmp_path / "out").iterdir() if (path / "raw.h5").is_file())
    raw = read_raw(folder / "raw.h5", device=device)
    np.testing.assert_array_equal(raw.to_numpy(), tifffile.imread(folder / "raw.tif"))
    assert not (folder / "lightfield.h5").exists()
    assert (folder / "truth.h5").is_file()
    alphas = np.array([0.95, 1.05])
    stack = focused_stack(raw, ms=0.012 / (0.12 - 0.06 / alphas))
    np.testing.assert_allclose(stack.alphas, alphas)
    np.testing.assert_array_equal(tifffile.imread(folder / "stack.ome.tif"), stack.to_numpy())
    depth = focused_depth(raw)
    maps = focused_maps(raw, depth)
    expected = np.array((maps.m, 1 / maps.m, maps.z, maps.confidence), np.float32)
    np.testing.assert_array_equal(tifffile.imread(folder / "depth.ome.tif"), expected)
    picture = render_focused(raw, method="depth", depth=depth).to_numpy()
    np.testing.assert_array_equal(tifffile.imread(folder / "all_in_focus.ome.tif"), picture)
    with tifffile.TiffFile(folder / "stack.ome.tif") as file:
        assert json.dumps("dz_m") in file.ome_metadata.replace("&quot;", '"')


def test_tables_that_make_no_sense_fail_in_a_sentence(tmp_path: Path, device: Device) -> None:
    (tmp_path / "camera.toml").write_text(CAMERA)
    for table, said in (
        ("[views]\n", "A focused camera does not record views: leave [views] out."),
        ("[stack]\ndisparities = [0, 1]\n", "must be given as alphas = F/F': set alphas in"),
    ):
        (tmp_path / "job.toml").write_text(JOB + table)
        summary, _ = run(tmp_path / "job.toml", device, force=True)
        assert [said in sentence for sentence in summary.failed.values()] == [True]
