"""``clplen info``: tables and JSON of light fields, disparity maps and raw images."""

from __future__ import annotations

import json
import re
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from click.testing import Result
from command_line import invoke as run

from clplen.io import write_lightfield, write_pfm
from clplen.lightfield.model.light_field import LightField

SCENE = """[intrinsics]
focal_length_mm = 100
image_resolution_x_px = 56
image_resolution_y_px = 48
sensor_size_mm = 35
[extrinsics]
num_cams_x = 3
num_cams_y = 3
baseline_mm = 50
focus_distance_m = 8
[meta]
scene = waves
"""


def views(shape=(3, 5), d=1.0) -> np.ndarray:
    """A plane of disparity d, uint8."""
    random = np.random.default_rng(3)
    waves = [(random.uniform(-1.2, 1.2, 2), random.uniform(0, 6)) for _ in range(40)]
    y, x = np.mgrid[:48, :56]
    a = np.empty((*shape, 48, 56), np.uint8)
    for v, u in np.ndindex(*shape):
        at_y, at_x = (
            i + d * (k - (n - 1) / 2) for i, k, n in zip((y, x), (v, u), shape, strict=True)
        )
        value = sum(np.cos(ky * at_y + kx * at_x + phase) for (ky, kx), phase in waves)
        a[v, u] = np.clip(120 + 12 * value, 0, 255)
    return a


def folder_of(path: Path, a: np.ndarray, names: str) -> Path:
    path.mkdir(exist_ok=True)
    for v, u in np.ndindex(*a.shape[:2]):
        imageio.imwrite(path / names.format(v=v, u=u, i=a.shape[1] * v + u), a[v, u])
    return path


def table(result: Result) -> dict[str, str]:
    """Label to text; what follows without a label belongs to the last one."""
    assert result.exit_code == 0, result.output
    found: dict[str, str] = {}
    width = min(line.index(line.split("  ")[1].strip()) for line in result.stdout.splitlines()[:1])
    width = len("Constant views") + 2 if "Constant views" in result.stdout else width
    label = ""
    for line in result.stdout.splitlines():
        label = line[:width].strip() or label
        found[label] = f"{found.get(label, '')}\n{line[width:]}".strip("\n")
    return found


def test_a_folder_that_is_read_right(tmp_path, device):
    folder = folder_of(tmp_path / "views", views(), "a_{v}_{u}.png")
    found = table(run("info", folder, "--device", device.place))
    assert found["File"] == f"{folder}, a folder of views"
    assert "pattern 'a_{v}_{u}.png' (guessed from the names)" in found["Read"].replace("\n", " ")
    assert found["Views"] == "3 x 5 (V x U) of 48 x 56 pixels, 1 channels"
    assert found["Samples"].startswith("uint8, ")
    assert found["Dark views"] == found["Constant views"] == "none"
    assert found["Spacing"] == "not known"
    assert found["View axes"].startswith("The view axes fit as they are read")
    low, high = re.findall(r"[+-]\d\.\d\d", found["Disparities"])
    assert found["Disparities"] == f"99 % of the pixels from {low} to {high}"
    assert 0.8 < float(low) < 1 < float(high) < 1.2
    orders = found["Orders"].splitlines()
    assert len(orders) == 9
    assert sum(line.startswith("*") for line in orders) == 2
    assert "+1.00  (no option)  as read" in found["Orders"]


@pytest.mark.parametrize(
    ("given", "mended"),
    [
        (["--flip-u"], "--flip-v --flip-u (at -1.00), or no option (at +1.00)"),
        (["--pattern", "a_{u}_{v}.png"], "--swap-uv (at +1.00), or --swap-uv --flip-v --flip-u"),
        (["--pattern", "a_{u}_{v}.png", "--flip-v"], "--swap-uv (at +1.00), or --swap-uv --flip-v"),
    ],
)
def test_words_that_mend_take_the_given_ones_into_account(tmp_path, device, given, mended):
    folder = folder_of(tmp_path / "views", views(), "a_{v}_{u}.png")
    found = table(run("info", folder, *given, "--device", device.place))
    said = found["View axes"].replace("\n", " ")
    assert said.startswith("The view axes do not fit as they are read")
    assert mended in said or ", or ".join(reversed(mended.split(", or "))) in said
    assert "Disparities" not in found


def test_json(tmp_path, device):
    """Every number of the table, NaN as null, and what the reader said."""
    a = views((3, 3))
    a[0, 2], a[1, 0] = 0, 9
    folder = folder_of(tmp_path / "scene", a, "input_Cam{i:03d}.png")
    (folder / "parameters.cfg").write_text(SCENE)
    result = run("info", folder, "--json", "--flip-v", "--device", device.place)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert result.stderr == ""
    assert found["shape"] == [3, 3, 48, 56]
    assert found["verdict"] == "wrong"
    assert (found["dark"], found["constant"]) == ([[2, 2]], [[1, 0]])
    assert found["parameters"]["focus_distance_m"] == 8
    assert "fstop" not in found["parameters"]
    assert found["orders"][0]["words"] == ["--flip-v"]
    best = max(found["orders"], key=lambda order: order["sharpness"])
    assert best["words"] in ([], ["--flip-v", "--flip-u"])
    parameters = table(run("info", folder, "--device", device.place))["Parameters"]
    assert "focus_distance_m 8" in parameters.replace("\n", " ")


def test_one_view_is_no_evidence(tmp_path, device):
    lf = LightField.from_array(views((1, 1)), device=device, spacing=(-1e-3, -1e-3, 5e-6, 5e-6))
    write_lightfield(tmp_path / "one.h5", lf)
    found = table(run("info", tmp_path / "one.h5", "--device", device.place))
    assert found["View axes"] == "The view axes cannot be checked: there is only one view."
    assert found["Spacing"] == "dv -1000 um, du -1000 um, dy 5 um, dx 5 um"
    result = run("info", tmp_path / "one.h5", "--json", "--device", device.place)
    assert json.loads(result.stdout)["factor"] is None


@pytest.mark.parametrize("suffix", [".pfm", ".npy"])
def test_a_disparity_map(tmp_path, suffix):
    values = np.linspace(-1.5, 2, 35, dtype=np.float32).reshape(5, 7)
    values[1, 2] = np.nan
    path = tmp_path / f"map{suffix}"
    if suffix == ".pfm":
        write_pfm(path, values)
    else:
        np.save(path, values)
    result = run("info", path)
    assert result.exit_code == 0, result.output
    assert "5 x 7 pixels (y, x)" in result.stdout
    assert "-1.5 to 2, median" in result.stdout
    assert "1 of 35 pixels" in result.stdout
    found = json.loads(run("info", path, "--json").stdout)
    assert (found["shape"], found["unknown"], found["high"]) == ([5, 7], 1, 2.0)


def test_an_array_of_views_is_no_map(tmp_path, device):
    np.save(tmp_path / "views.npy", views())
    found = table(run("info", tmp_path / "views.npy", "--device", device.place))
    assert found["Views"].startswith("3 x 5 (V x U)")


@pytest.fixture
def raw_files(tmp_path: Path) -> tuple[Path, Path]:
    """A raw image and its white image, 16 bit: lenslets of 10 pixels, turned by no angle."""
    y, x = np.mgrid[:163, :171]
    spots = np.exp(
        -((np.abs((y - 81) % 10 - 5) - 5) ** 2 + (np.abs((x - 85) % 10 - 5) - 5) ** 2) / 9
    )
    scene = 1 + 0.5 * np.cos(y / 9) * np.cos(x / 7)
    for name, values in (("white", spots), ("raw", spots * scene)):
        tifffile.imwrite(tmp_path / f"{name}.tif", (2e4 * values + 100).astype(np.uint16))
    return tmp_path / "raw.tif", tmp_path / "white.tif"


@pytest.mark.parametrize("words", [[], pytest.param(["--flip-u"], marks=pytest.mark.thorough)])
def test_a_raw_image_with_its_white_image(tmp_path, raw_files, device, words):
    raw, white = raw_files
    grid = tmp_path / "grid.json"
    result = run(
        "info", raw, "--white", white, "--save-grid", grid, *words, "--device", device.place
    )
    found = table(result)
    assert found["Lenslets"].startswith("square, pitch 10.000")
    assert abs(float(found["Rotation"].split()[0])) < 0.01
    assert "trust high" in found["Residual"]
    assert found["Lattice"].startswith("Square lattice")
    lattice = json.loads(
        run("info", raw, "--grid", grid, "--json", "--device", device.place).stdout
    )
    y, x = lattice["lattice"]["origin"]
    assert (y % 10, x % 10) == (pytest.approx(1, abs=0.02), pytest.approx(5, abs=0.02))


def test_what_is_wrong_is_one_sentence(tmp_path, device):
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.pfm").write_bytes(b"Pf\n3")
    (tmp_path / "notes.txt").write_text("hello")
    for name in ("empty", "bad.pfm", "notes.txt", "not there"):
        result = run("info", tmp_path / name, "--device", device.place)
        assert result.exit_code == 1, name
        assert result.stderr.startswith("Error: ")
        assert result.stderr.count("\n") == 1
        assert result.stdout == ""
    folder = folder_of(tmp_path / "views", views(), "a_{v}_{u}.png")
    result = run("info", folder, "--save-grid", tmp_path / "g.json", "--device", device.place)
    assert result.exit_code == 2
    assert "--save-grid applies to raw images" in result.stderr


@pytest.mark.thorough
def test_brightness_of_views(tmp_path, device):
    """One line for views that differ, one for those that hold hardly any light."""
    a = views((3, 5))
    a[1, 1] = (0.7 * a[1, 1]).astype(np.uint8)
    folder = folder_of(tmp_path / "views", a, "a_{v}_{u}.png")
    found = table(run("info", folder, "--device", device.place))
    means = a.mean(axis=(2, 3)) / np.median(a.mean(axis=(2, 3)))
    low, high = means.min(), means.max()
    assert abs(100 * (1 - low / high) - 30) < 6
    assert found["Brightness"] == (
        f"of the views differs by {100 * (1 - low / high):.0f} %: their means are {low:.2f} to "
        f"{high:.2f} of the median"
    )
    assert "Nearly black" not in found
    a[0, 0] = a[2, 4] = 0
    a[0, 0, 5, 5] = a[2, 4, ::9] = 9  # no views that are black throughout
    found = table(run("info", folder_of(tmp_path / "dim", a, "a_{v}_{u}.png"), "--device",
                      device.place))  # fmt: skip
    assert found["Nearly black"].replace("\n", " ") == (
        "2 of 15, below 2 % of the median: (0, 0), (2, 4); exclude them with --aperture of depth, "
        "refocus and render"
    )
    assert found["Left out"].startswith("0 of 15")
    for command in (["depth", "-o", tmp_path / "d.npy"], ["refocus", "-o", tmp_path / "r.png"]):
        words = ["--disparity", 1] if command[0] == "refocus" else ["--disparities", "0:2:9"]
        words = [command[0], tmp_path / "dim", *command[1:], *words, "--device", device.place]
        result = run(*words)
        assert result.exit_code == 0, result.output
        said = (
            "Note: 2 of 15 views are nearly black (below 2 % of the median brightness) and are "
            "weighted like the others: --aperture "
        )
        line = next(line for line in result.stderr.splitlines() if line.startswith(said))
        across = line.removeprefix(said).removesuffix(" leaves them out.")
        again = run(*words, "--aperture", across)
        assert again.exit_code == 0, again.output
        assert "nearly black" not in again.stderr
