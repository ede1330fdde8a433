"""``clplen analyse``: a pair of small cameras, and what it says of bad input."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from command_line import said

from clplen import cli
from clplen.compute.device import Device
from clplen.config.camera_file import read_camera_file

EXAMPLES = Path(__file__).parents[1] / "examples" / "cameras"
SMALL = """
[camera]
{kind}
focal_length_mm = 15
object_distance_mm = 60
wavelength_nm = 532
aperture_diameter_mm = 0.8
pixels_per_lenslet = 30
[camera.microlenses]
pitch_um = 150
focal_length_mm = 3
count = 9
fill = "full"
[scene]
points_mm = [[0.1, 0.0, 0.0]]
"""
STANDARD, FOCUSED = 'kind = "plenoptic1"', 'kind = "plenoptic2"\nm = 0.2'
Run = Callable[..., Result]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """The command on camera files of these kinds, into the folder ``out``."""

    def call(*words: object, **kinds: str) -> Result:
        files = []
        for name, kind in kinds.items():
            files.append(tmp_path / f"{name}.toml")
            files[-1].write_text(SMALL.format(kind=kind))
        typed = ["analyse", *files, "-o", tmp_path / "out", *words]
        return CliRunner().invoke(cli.main, [str(word) for word in typed])

    return call


@pytest.mark.thorough
def test_a_pair_is_compared(run: Run, tmp_path: Path, device: Device) -> None:
    result = run("--quick", "--depths-mm", "-4:0:2", "--device", device.place,
                 standard=STANDARD, focused=FOCUSED)  # fmt: skip
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    figures = {"sampling", "psf", "mtf", "two-points", "energy", "transfer", "depth", "pictures"}
    assert {file.stem for file in out.glob("*.png")} == figures
    text = (out / "report.md").read_text()
    assert "| `standard` | `focused` |" in text
    assert "**usable MTF50**: `focused` wins" in text
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 6
    assert "<strong>usable MTF50</strong>: <code>focused</code> wins" in page
    shown, mark, files = text.partition("<!-- Written by clplen: ")
    assert shown.strip() in result.output
    assert mark
    assert set(files.removesuffix(" -->\n").split(" | ")) == set(os.listdir(out))
    assert (out / "depth.csv").read_text().startswith("camera,dz_m,place,error_m,note\nstandard,")
    assert {file.stem for file in out.glob("*.csv")} == (figures - {"pictures"}) | {
        "summary",
        "transfer-mtf50",
    }


def test_only_some_of_one_camera(run: Run, tmp_path: Path, device: Device) -> None:
    name = os.fsdecode(b"_$5_$9^\n\xff|")
    result = run("--only", "crosstalk, sampling", "--device", device.place, **{name: FOCUSED})
    assert result.exit_code == 0, result.output
    assert "| | `_$5_$9^\\n\\udcff\\|` | unit |" in result.stdout
    names = {file.name for file in (tmp_path / "out").iterdir()}
    assert names == {"report.html", "report.md", "summary.csv", "sampling.csv", "sampling.png"}
    assert "What limits it" in result.output
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<code>_$5_$9^\\n\\udcff|</code>" in page


def test_depths_that_nothing_uses_are_told(run: Run) -> None:
    result = run("--only", "sampling", "--depths-mm", "-4:0:2", one=FOCUSED)
    assert result.exit_code == 0, result.output
    assert "--depths-mm is ignored: only transfer and depth use depths." in result.stderr


def test_the_example_is_a_pair(tmp_path: Path) -> None:
    for name, kind in (("standard", "plenoptic1"), ("focused", "plenoptic2")):
        shown = CliRunner().invoke(cli.main, ["analyse", "--example", name])
        assert shown.exit_code == 0
        assert shown.output == (EXAMPLES / f"{name}.toml").read_text()
        file = read_camera_file(EXAMPLES / f"{name}.toml")
        assert file.camera.kind == kind
    assert "microlenses" in shown.output


def test_bad_names_and_folders_are_told(run: Run, tmp_path: Path) -> None:
    assert "no analysis 'mft'" in said(run("--only", "psf,mft", one=STANDARD))
    assert "Did you mean 'mtf'?" in said(run("--only", "mft", one=STANDARD))
    assert "Name at least one analysis" in said(run("--only", ",", one=STANDARD))
    twice = ["analyse", "a/one.toml", "b/one.toml", "-o", str(tmp_path / "out")]
    (tmp_path / "b").mkdir()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "one.toml").write_text(SMALL.format(kind=STANDARD))
    twice[1:3] = [str(tmp_path / folder / "one.toml") for folder in ("a", "b")]
    assert "Two camera files are named one:" in said(CliRunner().invoke(cli.main, twice), 2)
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").touch()
    assert "exists already" in said(run("--only", "sampling", one=STANDARD))
    (tmp_path / "file").touch()
    into = ["analyse", str(tmp_path / "one.toml"), "-o", str(tmp_path / "file" / "out")]
    assert "file" in said(CliRunner().invoke(cli.main, into))


def test_bad_cameras_are_told(run: Run, tmp_path: Path) -> None:
    for kind, words in (
        ('kind = "plenoptic3"', "camera.kind"),
        ('kind = "plenoptic2"\nm = 0.0', "Error: one: m = b/a must be > 0"),
        ('kind = "plenoptic2"\nm = 0.2\na_mm = 18.0', "needs either m or a_mm"),
        ('kind = "plenoptic2"\nm = -1.5', "m must be > -1"),
        ('kind = "plenoptic1"\nm = 0.2', "has m, which applies to kind = 'plenoptic2'"),
        ("kinds = 1", "kinds"),
    ):
        assert words in said(run("--only", "sampling", one=kind))
        assert not (tmp_path / "out").exists()
        assert not list(tmp_path.glob(".*"))  # nothing half-made


def test_too_few_views_for_depth_are_told_in_the_tables(
    run: Run, tmp_path: Path, device: Device
) -> None:
    wide = 'kind = "plenoptic2"\nm = 0.6'
    result = run(
        "--only", "depth,transfer", "--depths-mm", "-20:-20:1", "--device", device.place, one=wide
    )
    assert result.exit_code == 0, result.output
    rows = (tmp_path / "out" / "depth.csv").read_text().splitlines()
    assert rows[1].endswith("too few views: at m = 1.2 a point is seen by 0.83 lenslets a row")
    assert rows[1].startswith("one,-0.02,0,,")
    assert "no camera has one" in result.output
