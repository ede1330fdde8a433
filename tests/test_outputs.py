"""What a command may write over: what clplen wrote; anything else by --force only."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from command_line import invoke as run
from lytro_files import content, contents_of

from clplen import (
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    RawImage,
    focal_stack,
    io,
    plot,
    refocus,
)
from clplen.compute.device import Device
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


def test_every_format_has_a_mark(tmp_path: Path, lf: LightField):
    for name in WRITERS:
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
    with pytest.raises(FileExistsError, match=r"a\.tif exists already, and clplen did not write"):
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
    with pytest.raises(FileExistsError, match=r"link\.tif exists already, a link to .*elsewhere"):
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
        with pytest.raises(FileExistsError, match="exists already and is not an OME-Zarr"):
            check_output(folder, force=force)
    (folder / ".zgroup").write_text('{"zarr_format": 2}')
    with pytest.raises(FileExistsError, match="clplen did not write it"):
        check_output(folder)
    check_output(folder, force=True)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are of POSIX")
def test_devices_and_pipes_are_no_outputs(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.tif")
    for path in (tmp_path / "pipe.tif", "/dev/stdout", "/dev/null", "/dev/new.tif", "/proc/x.tif"):
        with pytest.raises(OSError, match=r"Cannot write to|regular file"):
            check_output(path, force=True)
    with pytest.raises(OSError, match="regular file"):
        check_writable("/dev/null")
    assert not Path("/dev/null").is_file()


def test_numpy_files_are_read_by_numpy(tmp_path: Path):
    values = bytes_of(5, 7)[:, ::2]
    write_npy(tmp_path / "a.npy", values)
    found = np.load(tmp_path / "a.npy", mmap_mode="r", allow_pickle=False)
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
    with pytest.raises(FileExistsError, match=r"d\.csv exists already, and clplen did not"):
        fill(folder, d="5")
    assert (folder / "d.csv").read_text() == NOTES
    assert (folder / "b.csv").read_text() == "3"
    with pytest.raises(TypeError):
        fill(folder, a="half", b=3)
    assert (folder / "b.csv").read_text() == "3"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_list_of_others_removes_nothing_of_others(tmp_path: Path):
    """The line may be anybody's: it names files of clplen in its own folder, or none."""
    folder = tmp_path / "out"
    fill(folder, a="1")
    (folder / "inside").mkdir()
    kept = [tmp_path / "b.csv", folder / "notes.txt", folder / "inside" / "c.csv"]
    for path in kept:
        path.write_text(NOTES)
    names = ["report.md", "../b.csv", str(tmp_path / "b.csv"), "notes.txt", "inside/c.csv"]
    (folder / "report.md").write_text(f"{listed([*names, 'inside', '.', '..', '', 'a.csv'])}")
    fill(folder, d="4")
    assert [path.read_text() for path in kept] == [NOTES] * 3
    assert not (folder / "a.csv").exists()


def test_folders_of_others(tmp_path: Path):
    (tmp_path / "notes.txt").write_text(NOTES)
    with pytest.raises(FileExistsError, match="not empty, and clplen did not write it"):
        fill(tmp_path, a="1")
    fill(tmp_path, a="1", force=True)
    assert (tmp_path / "notes.txt").read_text() == NOTES
    assert (tmp_path / "a.csv").read_text() == "1"


# Commands


COMMANDS = {
    "stack": (["--disparities", "-1:1:3"], "out.tif"),
    "depth": (["--disparities", "-1:1:3"], "out.tif"),
    "refocus": (["--disparity", "0.5"], "out.png"),
    "render sweep": (["--sweep", "views"], "out.gif"),
    "stack zarr": (["--disparities", "-1:1:3"], "out.zarr"),
}


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(c, marks=pytest.mark.thorough if c in ("depth", "render sweep") else ())
        for c in COMMANDS
    ],
)
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


# What depth writes beside the map: its option, and the name of the file.
BESIDE = [
    ("", "flower.png"),
    ("--confidence", "sure.npy"),
    ("--confidence", "sure.tif"),
    ("--metric", "metres.pfm"),
    ("--ply", "points.ply"),
    ("--ply", "points.glb"),
]


@pytest.mark.parametrize("kind", ["views", "focused"])
def test_depth_replaces_no_file_of_others_beside_the_map(
    tmp_path: Path, lf: LightField, device: Device, monkeypatch, kind: str
):
    monkeypatch.chdir(tmp_path)
    if kind == "views":
        io.write_lightfield("in.h5", lf)
        monkeypatch.setattr("clplen.io.read_lightfield", lambda *_, **__: pytest.fail("computed"))
    else:
        io.write_raw("in.h5", focused_raw(device))
        monkeypatch.setattr("clplen.io.read_raw", lambda *_, **__: pytest.fail("computed"))
    lengths = ["--baseline-mm", 2, "--focal-length-mm", 50, "--pixel-um", 10]
    for option, name in BESIDE:
        Path(name).write_text(NOTES)
        words = ["depth", "in.h5", "-o", "flower.pfm", "--device", device.place]
        words += [option, name] if option else []
        words += lengths if option == "--metric" and kind == "views" else []
        result = run(*words)
        assert result.exit_code == 1, result.output
        said = " ".join(result.output.split())
        assert said == (
            f"Error: {name} exists already, and clplen did not write it: choose another output, "
            "or replace it with --force."
        )
        assert sorted(os.listdir()) == sorted(["in.h5", name])
        assert Path(name).read_text() == NOTES
        Path(name).unlink()


def focused_raw(device: Device) -> RawImage:
    camera = PlenopticCamera.type2(
        m=0.2,
        focal_length=30e-3,
        mla=MicrolensArray(150e-6, 10e-3, count=(3, 4), fill="full"),
        wavelength=532e-9,
        pixels_per_lenslet=6,
        device=device,
    )
    return camera.expose(PointSources((0, 0, 1e-3)), model="rays")


def test_saved_pictures_replace_no_files_of_others(tmp_path: Path):
    """Pictures of the maker bear no mark: what is there must be the same, or clplen's map."""
    pictures = [b"\xff\xd8\xff" + bytes([number] * 40) for number in range(2)]
    depth = np.arange(12, dtype="<f4").tobytes()
    sections = [content(data) for data in (*pictures, depth)]
    names = [name.decode() for _, name, _ in sections]
    images = [{"imageRef": name} for name in names[:2]]
    maps = {"depthMap": {"imageRef": names[2], "width": 4, "height": 3}}
    stack = {"type": "refocusStack", "vendorContent": {"imageArray": images, **maps}}
    table = json.dumps({"picture": {"accelerationArray": [stack]}}).encode()
    (tmp_path / "a-stk.lfp").write_bytes(contents_of([(b"M", content(table)[1], table), *sections]))
    folder = tmp_path / "pictures"
    words = ["info", tmp_path / "a-stk.lfp", "--save-pictures", folder]
    for _ in range(2):
        result = run(*words)
        assert result.exit_code == 0, result.output
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    maps = [name for name in files if name.endswith(".pfm")]
    assert len(files) == 3
    assert len(maps) == 1
    np.testing.assert_array_equal(io.read_pfm(folder / maps[0]).ravel(), np.arange(12))
    for name in files:
        for path in folder.iterdir():
            path.unlink()
        (folder / name).write_text(NOTES)
        result = run(*words)
        assert result.exit_code == 1, result.output
        assert f"{name} exists already, and clplen did not write it" in result.output
        assert "replace it with --force" in result.output
        assert {path.name: path.read_text() for path in folder.iterdir()} == {name: NOTES}
    assert run(*words, "--force").exit_code == 0
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == files


@pytest.mark.parametrize("words", [["simulate", "camera.toml", "-o"], ["demo", "-o"]])
def test_folders_with_files_of_others(tmp_path: Path, words: list[str], monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("camera.toml").write_text(run("simulate", "--example").output)
    Path("raw.tif").write_text(NOTES)
    result = run(*words, ".")
    assert result.exit_code == 1, result.output
    assert "raw.tif exists already, and clplen did not write it" in result.output
    assert Path("raw.tif").read_text() == NOTES
    assert sorted(os.listdir()) == ["camera.toml", "raw.tif"]


def test_save_grid(tmp_path: Path, device: Device, monkeypatch):
    monkeypatch.chdir(tmp_path)
    LATTICE.save("grid.json")
    io.write_picture("raw.tif", random(*LATTICE.shape))
    words = ["info", "raw.tif", "--grid", "grid.json", "--device", device.place, "--save-grid"]
    result = run(*words, "grid.json")
    assert result.exit_code == 2
    assert "one of the input files of raw.tif" in result.output
    Path("notes.json").write_text(NOTES)
    assert run(*words, "notes.json").exit_code == 1
    assert Path("notes.json").read_text() == NOTES
    for _ in range(2):
        assert run(*words, "new.json").exit_code == 0
