"""What a command may write over: what clplen wrote; anything else by --force only."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner, Result

from clplen import LightField, focal_stack, io, plot, refocus
from clplen.cli import main
from clplen.compute.device import Device
from clplen.demo import FILES
from clplen.files import check_writable
from clplen.io.formats.animation import write_animation
from clplen.io.formats.npy import write_npy
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.outputs import check_output, is_ours, listed, updating

LATTICE = Lattice("square", (40.2, 41.1), (11, 0), (0, 11), (81, 83))
NOTES = "notes of the user\n"


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(2).random(shape, np.float32)


def bytes_of(*shape: int) -> np.ndarray:
    return (255 * random(*shape)).astype(np.uint8)


@pytest.fixture
def lf(device: Device) -> LightField:
    return LightField.from_array(random(3, 3, 90, 110), device=device)


WRITERS: dict[str, Callable[[Path, LightField], None]] = {
    "stack.ome.tif": lambda path, lf: io.write_stack(path, focal_stack(lf, disparities=[0, 1])),
    "stack.zarr": lambda path, lf: io.write_stack(path, focal_stack(lf, disparities=[0, 1])),
    "light.h5": lambda path, lf: io.write_lightfield(path, lf),
    "light.zarr": lambda path, lf: io.write_lightfield(path, lf),
    "picture.tif": lambda path, lf: io.write_picture(path, random(300, 400)),
    "picture.png": lambda path, lf: io.write_picture(path, bytes_of(400, 500, 3)),
    "figure.png": lambda path, lf: plot.save(plot.picture(refocus(lf, disparity=0)), path),
    "sweep.gif": lambda path, lf: write_animation(path, [bytes_of(200, 300, 3)] * 2),
    "sweep.mp4": lambda path, lf: write_animation(path, [bytes_of(200, 300, 3)] * 2),
    "points.ply": lambda path, lf: io.write_ply(path, random(30000, 3)),
    "grid.json": lambda path, lf: LATTICE.save(path),
    "map.pfm": lambda path, lf: io.write_pfm(path, random(300, 400)),
    "colours.pfm": lambda path, lf: io.write_pfm(path, random(30, 40, 3)),
    "map.npy": lambda path, lf: write_npy(path, random(300, 400)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_has_a_mark(tmp_path: Path, lf: LightField, name: str):
    path = tmp_path / name
    WRITERS[name](path, lf)
    assert is_ours(path)
    assert check_output(path) == path


def test_files_of_others_are_not_ours(tmp_path: Path):
    tifffile.imwrite(tmp_path / "a.tif", random(300, 300))
    (tmp_path / "a.txt").write_text(NOTES)
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    (tmp_path / "a.pfm").write_bytes(b"Pf\n2 1\n-1.000000\n" + bytes(8))
    np.save(tmp_path / "a.npy", random(3, 4))
    for path in [*tmp_path.iterdir(), tmp_path / "none"]:
        assert not is_ours(path), path
    with pytest.raises(FileExistsError, match=r"a\.tif is there already, and clplen did not write"):
        check_output(tmp_path / "a.tif")
    assert check_output(tmp_path / "a.tif", force=True).exists()
    with pytest.raises(IsADirectoryError, match="is a folder"):
        check_output(tmp_path / "folder", force=True)


def test_links_are_not_followed(tmp_path: Path, lf: LightField):
    target = tmp_path / "elsewhere.tif"
    WRITERS["picture.tif"](target, lf)
    before = target.read_bytes()
    link = tmp_path / "link.tif"
    link.symlink_to(target)
    with pytest.raises(FileExistsError, match=r"link\.tif is there already, a link to .*elsewhere"):
        check_output(link)
    check_output(link, force=True)
    io.write_picture(link, random(3, 4))
    assert not link.is_symlink()
    assert target.read_bytes() == before
    (tmp_path / "dangling.tif").symlink_to(tmp_path / "none")
    with pytest.raises(FileExistsError, match="a link to"):
        check_output(tmp_path / "dangling.tif")
    (tmp_path / "far.zarr").symlink_to(tmp_path)
    with pytest.raises(FileExistsError, match=r"far\.zarr"):
        check_output(tmp_path / "far.zarr", force=True)


def test_a_zarr_of_others(tmp_path: Path):
    folder = tmp_path / "photos.zarr"
    folder.mkdir()
    check_output(folder)  # empty
    (folder / "dear.png").write_bytes(b"png")
    for force in (False, True):
        with pytest.raises(FileExistsError, match="is there already and no OME-Zarr"):
            check_output(folder, force=force)
    (folder / ".zgroup").write_text('{"zarr_format": 2}')
    with pytest.raises(FileExistsError, match="clplen did not write it"):
        check_output(folder)
    check_output(folder, force=True)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are of POSIX")
def test_devices_and_pipes_are_no_outputs(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.tif")
    for path in (tmp_path / "pipe.tif", "/dev/stdout", "/dev/null", "/dev/new.tif", "/proc/x.tif"):
        with pytest.raises(OSError, match=r"no place for a file|ordinary file"):
            check_output(path, force=True)
    with pytest.raises(OSError, match="ordinary file"):
        check_writable("/dev/null")
    assert not Path("/dev/null").is_file()


@pytest.mark.parametrize("dtype", [np.float32, np.uint8, np.float64])
def test_numpy_files_are_read_by_numpy(tmp_path: Path, dtype: type):
    values = (100 * random(5, 7)).astype(dtype)[:, ::2]
    write_npy(tmp_path / "a.npy", values)
    for mode in (None, "r"):
        found = np.load(tmp_path / "a.npy", mmap_mode=mode, allow_pickle=False)
        np.testing.assert_array_equal(found, values)
        assert found.dtype == values.dtype


def fill(folder: Path, force: bool = False, **files: str) -> None:
    with updating(folder, "report.md", force=force) as inside:
        for name, text in files.items():
            (inside / f"{name}.csv").write_text(text)
        names = ["report.md", *(f"{name}.csv" for name in files)]
        (inside / "report.md").write_text(f"# A report\n\n{listed(names)}")


def test_folders_of_an_earlier_run(tmp_path: Path):
    folder = tmp_path / "out"
    fill(folder, a="1", b="2")
    (folder / "notes.txt").write_text(NOTES)
    fill(folder, b="3", c="4")
    found = {path.name: path.read_text() for path in folder.iterdir()}
    assert found.pop("report.md")
    assert found == {"b.csv": "3", "c.csv": "4", "notes.txt": NOTES}
    (folder / "d.csv").write_text(NOTES)
    with pytest.raises(FileExistsError, match=r"d\.csv is there already, and clplen did not"):
        fill(folder, d="5")
    assert (folder / "d.csv").read_text() == NOTES
    assert (folder / "b.csv").read_text() == "3"
    with pytest.raises(TypeError):
        fill(folder, a="half", b=3)
    assert (folder / "b.csv").read_text() == "3"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_folders_of_others(tmp_path: Path):
    (tmp_path / "notes.txt").write_text(NOTES)
    with pytest.raises(FileExistsError, match="not empty, and clplen did not write it"):
        fill(tmp_path, a="1")
    fill(tmp_path, a="1", force=True)
    assert (tmp_path / "notes.txt").read_text() == NOTES
    assert (tmp_path / "a.csv").read_text() == "1"


# Commands


def run(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


COMMANDS = {
    "stack": (["--disparities", "-1:1:3"], "out.tif"),
    "depth": (["--disparities", "-1:1:3"], "out.tif"),
    "refocus": (["--disparity", "0.5"], "out.png"),
    "render": ([], "out.png"),
    "render sweep": (["--sweep", "views"], "out.gif"),
    "epi": (["--y", "5", "--v", "1"], "out.png"),
    "stack zarr": (["--disparities", "-1:1:3"], "out.zarr"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_replace_their_own_files_only(
    tmp_path: Path, lf: LightField, device: Device, command: str
):
    words, name = COMMANDS[command]
    source, output = tmp_path / "light.h5", tmp_path / name
    io.write_lightfield(source, lf)
    words = [command.split()[0], source, *words, "-o", output, "--device", device.place]
    for _ in range(2):
        result = run(*words)
        assert result.exit_code == 0, result.output
    if output.is_dir():
        return
    output.write_text(NOTES)
    result = run(*words)
    assert result.exit_code == 1, result.output
    assert "clplen did not write it" in result.output
    assert "--force" in result.output
    assert "Traceback" not in result.output
    assert output.read_text() == NOTES
    result = run(*words, "--force")
    assert result.exit_code == 0, result.output
    assert is_ours(output)


def test_the_picture_beside_a_depth_map(tmp_path: Path, lf: LightField, device: Device):
    """-o flower.pfm writes flower.png too, which may be a photograph of the flower."""
    io.write_lightfield(tmp_path / "light.h5", lf)
    (tmp_path / "flower.png").write_text(NOTES)
    words = ["depth", tmp_path / "light.h5", "-o", tmp_path / "flower.pfm", "--disparities"]
    result = run(*words, "-1:1:3", "--device", device.place)
    assert result.exit_code == 1, result.output
    assert "flower.png is there already" in result.output
    assert (tmp_path / "flower.png").read_text() == NOTES
    assert not (tmp_path / "flower.pfm").exists()


@pytest.mark.parametrize("words", [["simulate", "camera.toml", "-o"], ["demo", "-o"]])
def test_folders_with_files_of_others(tmp_path: Path, words: list[str], monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("camera.toml").write_text(run("simulate", "--example").output)
    Path("raw.tif").write_text(NOTES)
    result = run(*words, ".")
    assert result.exit_code == 1, result.output
    assert "raw.tif is there already, and clplen did not write it" in result.output
    assert Path("raw.tif").read_text() == NOTES
    assert sorted(os.listdir()) == ["camera.toml", "raw.tif"]


def test_save_grid(tmp_path: Path, device: Device, monkeypatch):
    monkeypatch.chdir(tmp_path)
    LATTICE.save("grid.json")
    io.write_picture("raw.tif", random(*LATTICE.shape))
    words = ["info", "raw.tif", "--grid", "grid.json", "--device", device.place, "--save-grid"]
    result = run(*words, "grid.json")
    assert result.exit_code == 2
    assert "one of the files of raw.tif that are read" in result.output
    Path("notes.json").write_text(NOTES)
    assert run(*words, "notes.json").exit_code == 1
    assert Path("notes.json").read_text() == NOTES
    for _ in range(2):
        assert run(*words, "new.json").exit_code == 0


def test_the_demo_names_all_its_files():
    written = Path(__file__).parents[1] / "clplen" / "demo.py"
    text = written.read_text()
    assert all(text.count(f'"{name}"') == 2 for name in FILES)
    assert text.count('folder / "') == len(FILES)
