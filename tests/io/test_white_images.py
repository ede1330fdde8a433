"""White images that are none, or of another camera: refused in Python, jobs and every command."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from reference_lattice import lattice, white
from scipy.ndimage import gaussian_filter

from clplen import read_lightfield
from clplen.cli import main
from clplen.compute.device import Device
from clplen.errors import FormatError, SamplingWarning
from clplen.io import read_raw
from clplen.microscopy.frames.prepare import preparation

SHAPE = (132, 141)
PITCH = 11.2
def random(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def drawn(pitch: float = PITCH, kind: str = "square", degrees: float = 1.5) -> np.ndarray:
    """White image, 0 to 1."""
    true = lattice(kind, pitch, degrees=degrees, origin=(66.2, 70.4))
    return white(SHAPE, true, vignetting=0.2)


def scene() -> np.ndarray:
    """A raw frame of a smooth scene, whose gaps between the lenslets show."""
    y, x = np.indices(SHAPE)
    return drawn() * (1 + 0.4 * np.cos(0.05 * y) * np.cos(0.07 * x))


def photograph() -> np.ndarray:
    y, x = np.indices(SHAPE)
    cloud = gaussian_filter(random().standard_normal(SHAPE), 4)
    return cloud - cloud.min() + 0.3 * (np.hypot(y - 60, x - 90) < 40)


NONE: dict[str, Callable[[], np.ndarray]] = {
    "constant": lambda: np.full(SHAPE, 700.0),
    "noise": lambda: random().normal(1000, 50, SHAPE),
    "photograph": lambda: 1e4 * photograph(),
    "half covered": lambda: np.where(np.indices(SHAPE)[1] < 70, 0, 3e4 * drawn()),
    "drowned in noise": lambda: 2e4 + 1e4 * drawn() + random().normal(0, 1.2e4, SHAPE),
}
GOOD: dict[str, Callable[[], np.ndarray]] = {
    "noise": lambda: 2e4 * (0.5 + drawn()) + random().normal(0, 0.3 * 2e4, SHAPE),
    "overexposed": lambda: 2e5 * drawn(),
    "vignetted": lambda: 6e4 * drawn() * np.exp(-np.indices(SHAPE)[0] / 90),
}


def write(path: Path, values: np.ndarray) -> None:
    tifffile.imwrite(path, np.clip(np.round(values), 0, 65535).astype(np.uint16))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write(tmp_path / "raw.tif", 3e4 * scene())
    return tmp_path


def test_what_is_no_white_image_is_refused(folder: Path, device: Device):
    for name in NONE:
        write(folder / "white.tif", NONE[name]())
        given = {"device": device, "white": folder / "white.tif"}
        with pytest.raises(FormatError, match=r"white\.tif is not a (\w+ )?white image") as caught:
            read_lightfield(folder / "raw.tif", **given)
        assert "10 px" not in str(caught.value)
        with pytest.raises(FormatError, match=r"white\.tif is not a (reliable )?white image"):
            read_raw(folder / "raw.tif", **given)


def test_white_images_pass(folder: Path, device: Device):
    for name in GOOD:
        write(folder / "white.tif", GOOD[name]())
        found = read_raw(folder / "raw.tif", device=device, white=folder / "white.tif")
        assert found.lattice.pitch == pytest.approx((PITCH, PITCH), rel=0.01)
        assert read_lightfield(folder / "raw.tif", device=device, white=folder / "white.tif")


def test_a_white_image_of_another_camera_is_refused(folder: Path, device: Device):
    for other in [(9.3, "square"), (11.2, "hexagonal")]:
        write(folder / "white.tif", 3e4 * drawn(*other))
        for read in (read_lightfield, read_raw):
            with pytest.raises(FormatError, match=r"white\.tif is of another camera.*11\.2 px"):
                read(folder / "raw.tif", device=device, white=folder / "white.tif")
            assert read(folder / "raw.tif", device=device, white=folder / "white.tif", force=True)


def test_force_goes_on_where_something_repeats(folder: Path, device: Device):
    write(folder / "white.tif", NONE["half covered"]())
    for read in (read_lightfield, read_raw):
        with pytest.warns(SamplingWarning, match=r"white\.tif: .*low trust"):
            read(folder / "raw.tif", device=device, white=folder / "white.tif", force=True)
        write(folder / "dark.tif", NONE["noise"]())
        with pytest.raises(FormatError, match=r"dark\.tif is not .*no repeated pattern"):
            read(folder / "raw.tif", device=device, white=folder / "dark.tif", force=True)


@pytest.mark.filterwarnings("default::clplen.errors.SamplingWarning")
def test_a_command_refuses(folder: Path, device: Device, monkeypatch):
    monkeypatch.chdir(folder)
    words = ["refocus", "raw.tif", "-o", "out.png", "--disparity", "0.5", "--white", "white.tif"]
    words += ["--device", device.place]
    for name, sentence in (
        ("constant", "no repeated pattern"),
        ("half covered", "or --force to go on"),
    ):
        write(folder / "white.tif", NONE[name]())
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 1, result.output
        assert sentence in " ".join(result.output.split())
        assert not list(folder.glob("out.*"))
    result = CliRunner().invoke(main, [*words, "--force"])
    assert result.exit_code == 0, result.output
    assert "low trust" in result.stderr


def test_white_frames_of_a_microscope(device: Device):
    for name in NONE:
        values = np.clip(np.round(NONE[name]()), 0, 60000).astype(np.uint16)
        with pytest.raises(ValueError, match=r"white frame|exchanged"):
            preparation(11, device=device, white=values)
        if name == "half covered":
            with pytest.warns(SamplingWarning, match="The white frame: .*low trust"):
                preparation(11, device=device, white=values, force=True)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("frame", "flat"),
    [
        ("lfm_guv/Lightfield_GUVExperim1.tif", "lfm_guv/Radiometry_GUVExperim1.tif"),
        ("lfm_beads/img_beads.tif", "lfm_beads/img_bg.tif"),
    ],
)
def test_real_pairs_and_exchanged_ones(data_folder: Path, device: Device, frame: str, flat: str):
    frame, flat = (data_folder / name for name in (frame, flat))
    assert read_raw(frame, device=device, white=flat).lattice.trust == "high"
    with pytest.raises(FormatError, match="is not a reliable white image"):
        read_raw(flat, device=device, white=frame)


def test_a_white_image_of_another_microscope(data_folder: Path, tmp_path: Path, device: Device):
    frame = data_folder / "lfm_guv" / "Lightfield_GUVExperim1.tif"
    flat = tifffile.imread(data_folder / "lfm_beads" / "img_bg.tif")[300:736, 500:936]
    write(tmp_path / "white.tif", flat)
    with pytest.raises(FormatError, match=r"another camera: .* 19\.21 px .* 15\.\d+ px"):
        read_raw(frame, device=device, white=tmp_path / "white.tif")


def test_a_lattice_in_doubt_is_taken_by_command(tmp_path: Path):
    """A frame that shows its lenslets, though a scene makes them unequal."""
    values = np.random.default_rng(2).random((14, 14)).repeat(10, 0).repeat(10, 1)[:132, :]
    frame = drawn() * (0.2 + values[:, [*range(140), 139]])
    tifffile.imwrite(tmp_path / "a.tif", np.rint(20000 * frame).astype(np.uint16))
    words = ["info", str(tmp_path / "a.tif"), "--lattice", "square"]
    refused = CliRunner().invoke(main, words)
    assert refused.exit_code == 1
    assert "--trust-lattice" in refused.stderr
    words += ["--trust-lattice", "--save-grid", str(tmp_path / "grid.json")]
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        taken = CliRunner().invoke(main, words)
    assert taken.exit_code == 0, taken.output
    assert "low trust" in taken.stderr
    assert (tmp_path / "grid.json").is_file()
