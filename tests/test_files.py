"""Files are written whole or not at all, and folders are tried before anything is computed."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from clplen import plot
from clplen.compute.device import Device
from clplen.files import (
    check_folder,
    check_space,
    check_writable,
    clear_temporaries,
    filling,
    is_plain_name,
    output_folder,
    replacing,
)
from clplen.io import write_lightfield, write_pfm, write_picture
from clplen.lightfield.model.light_field import LightField

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_nothing_is_left_after_an_exception(tmp_path: Path, error: type[BaseException]):
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write() -> None:
        with replacing(target) as temporary:
            temporary.write_text("half of the n")
            raise error

    with pytest.raises(error):
        write()
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"]
    assert target.read_text() == "old"


def test_names_as_long_as_a_disk_takes(tmp_path: Path):
    for name in ["x" * 251 + ".txt", "\u4e2d" * 83 + ".txt"]:
        with replacing(tmp_path / name) as temporary:
            assert temporary.suffix == ".txt"
            temporary.write_text("new")
        with filling(tmp_path / name[1:]) as temporary:
            (temporary / "a").touch()
        assert {name, name[1:]} <= {path.name for path in tmp_path.iterdir()}
        too_long = pytest.raises(OSError, match=r"File name too long\): choose a shorter name\.")
        with too_long, filling(tmp_path / name[1:], replace=True):
            pass  # the old folder would be moved aside under its whole name


def test_a_folder_is_filled_whole_or_not_at_all(tmp_path: Path):
    def write() -> None:
        with filling(tmp_path / "views") as folder:
            (folder / "one.png").write_text("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "views").mkdir()
    with filling(tmp_path / "views") as folder:
        (folder / "one.png").write_text("x")
    assert (tmp_path / "views" / "one.png").read_text() == "x"


def test_places_that_are_no_place_for_a_file(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(FileNotFoundError, match=r"folder .*nowhere does not exist; create it"):
        check_writable(tmp_path / "nowhere" / "a.tif")
    with pytest.raises(FileNotFoundError, match=r"folder .*file does not exist"):
        check_writable(tmp_path / "file" / "a.tif")
    with pytest.raises(NotADirectoryError, match="is a file or a broken link"):
        check_folder(tmp_path / "file")
    with pytest.raises(IsADirectoryError, match="is a folder: add the name"):
        check_writable(tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="needs a folder that nobody may write to")
def test_a_folder_that_takes_no_files():
    with pytest.raises(OSError, match=r"the folder /proc is not writable .*choose another"):
        check_writable("/proc/stack.tif")
    with pytest.raises(OSError, match=r"folder /proc/demo .*choose another"):
        check_folder("/proc/demo")


def test_a_disk_that_may_only_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "touch", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(OSError, match=r"is not writable \(Read-only file system\); choose another"):
        check_writable(tmp_path / "a.tif")


@contextmanager
def small_disk() -> Iterator[None]:
    """No file may hold more than 8 kB; left at once, because pytest's own log is a file too."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_is_said_in_one_sentence(tmp_path: Path):
    for name in ["a.tif", "a.png", "a.pfm"]:
        values = np.random.default_rng(1).integers(0, 255, (100, 300)).astype(np.uint8)
        write = write_pfm if name == "a.pfm" else write_picture
        said = rf"{name} \(.*\): if the disk is full, f"
        with pytest.raises(OSError, match=said), small_disk():
            write(tmp_path / name, values)
        assert list(tmp_path.iterdir()) == []


def test_a_full_disk_for_hdf5_and_figures(tmp_path: Path, device: Device):
    lf = LightField.from_array(np.random.default_rng(1).random((3, 3, 40, 50)), device=device)
    lf.to_numpy()
    figure = Figure()
    figure.add_subplot().imshow(np.random.default_rng(1).random((200, 200)))
    said = r"Cannot write .*a\.{} \(File too large\): if the disk"
    with pytest.raises(OSError, match=said.format("h5")), small_disk():
        write_lightfield(tmp_path / "a.h5", lf)
    with pytest.raises(OSError, match=said.format("png")), small_disk():
        plot.save(figure, tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


def test_an_output_folder_goes_when_the_work_fails(tmp_path: Path):
    def work(folder: Path, name: str = "") -> None:
        with output_folder(folder) as made:
            if name:
                (made / name).touch()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work(tmp_path / "new" / "folder")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "old").mkdir()
    with pytest.raises(KeyboardInterrupt):
        work(tmp_path / "old")
    with pytest.raises(KeyboardInterrupt):
        work(tmp_path / "new", "whole.tif")
    assert sorted(f.name for f in tmp_path.rglob("*")) == ["new", "old", "whole.tif"]


USERS = (".a-0123456789ab.tif", "a-0123456789ab.partial.tif", ".a-0123.partial.tif", "b.partial")


@pytest.mark.parametrize("name", ["a", "a.ome.zarr", ".hidden"])
def test_temporary_names_are_known(tmp_path: Path, name: str):
    with replacing(tmp_path / name) as temporary:
        assert temporary.name.startswith(".")
        assert temporary.suffix == (Path(name).suffix or ".partial")
        temporary.touch()
    folder = tmp_path / "folder"
    folder.mkdir()
    for other in (temporary.name, *USERS, name):
        (folder / other).touch()
    assert clear_temporaries(folder) == [folder / temporary.name]
    assert {file.name for file in folder.iterdir()} == {*USERS, name}


KILLED = """
import os, sys
from clplen.files import filling, replacing
how, target = sys.argv[1:]
with (filling(target, replace=True) if how == "folder" else replacing(target)) as temporary:
    (temporary / "new" if how == "folder" else temporary).write_text("half of the n")
    os._exit(9)
"""


@pytest.mark.parametrize("how", ["file", "folder"])
def test_what_a_killed_process_leaves(tmp_path: Path, how: str):
    target = tmp_path / "a.b.zarr"
    for name in USERS:
        (tmp_path / name).touch()
    if how == "folder":
        target.mkdir()
        (target / "old").touch()
    kept = sorted(tmp_path.rglob("*"))
    command = [sys.executable, "-c", KILLED, how, str(target)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    assert subprocess.run(command, env=environment, timeout=60, check=False).returncode == 9
    (left,) = (path for path in tmp_path.iterdir() if path.name not in (*USERS, target.name))
    assert clear_temporaries(tmp_path) == [left]
    assert sorted(tmp_path.rglob("*")) == kept
    assert clear_temporaries(tmp_path) == []


def fill(target: Path, name: str, **words: bool) -> None:
    with filling(target, **words) as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / name).write_text("x")


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


def test_a_folder_is_exchanged_as_a_whole(tmp_path: Path):
    target = tmp_path / "a.zarr"
    fill(target, "old", replace=True)
    fill(target, "new", replace=True)
    assert names_in(tmp_path) == ["new"]
    with pytest.raises(FileExistsError, match=r"a\.zarr exists already and is not empty"):
        fill(target, "third")
    (tmp_path / "file.zarr").touch()
    with pytest.raises(FileExistsError, match=r"file\.zarr exists already"):
        fill(tmp_path / "file.zarr", "third", replace=True)
    assert names_in(tmp_path) == ["file.zarr", "new"]
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("step", [1, 2, 3])
def test_an_exchange_that_breaks_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: int):
    """The old folder is back at once; after a crash, by clear_temporaries."""
    target = tmp_path / "a.b.zarr"
    fill(target, "old")
    rename, calls = os.replace, []

    def refuse(source: Path, new: Path) -> None:
        calls.append(source)
        if len(calls) == step:
            raise OSError(errno.EIO, "Input/output error")
        rename(source, new)

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match=r"Cannot write .*a\.b\.zarr \(Input/output error\)"):
        fill(target, "new", replace=True)
    assert names_in(tmp_path) == ["old"]
    assert list(tmp_path.iterdir()) == [target]
    monkeypatch.undo()
    aside = tmp_path / ".a.b-0123456789ab.replaced.zarr"
    os.replace(target, aside)
    fill(tmp_path / ".a.b-0123456789ac.partial.zarr", "new")
    clear_temporaries(tmp_path)
    assert names_in(target) == ["old"]
    fill(aside, "older")
    clear_temporaries(tmp_path)
    assert names_in(tmp_path) == ["old"]
    assert list(tmp_path.iterdir()) == [target]


def test_many_writers_of_one_name(tmp_path: Path):
    def write(number: int) -> None:
        for _ in range(20):
            fill(tmp_path / "a.zarr", f"{number}", replace=True)
            with replacing(tmp_path / "a.txt") as temporary:
                temporary.write_text(f"{number}" * 1000)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, range(4)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.txt", "a.zarr"]
    assert len(names_in(tmp_path / "a.zarr")) == 1
    text = (tmp_path / "a.txt").read_text()
    assert text == text[0] * 1000


def test_of_two_writers_of_a_new_folder_the_first_wins(tmp_path: Path):
    def second() -> None:
        with filling(tmp_path / "a") as folder:
            (folder / "second").touch()
            fill(tmp_path / "a", "first")

    with pytest.raises(FileExistsError, match="exists already"):
        second()
    assert names_in(tmp_path) == ["first"]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_durable_files_reach_the_disk_before_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    done, rename, sync = [], os.replace, os.fsync

    def note_sync(number: int) -> None:
        done.append(Path(os.readlink(f"/proc/self/fd/{number}")).name)
        sync(number)

    def note_rename(source: Path, new: Path) -> None:
        done.append("rename")
        rename(source, new)

    if not Path("/proc/self/fd").is_dir():
        pytest.skip("this system does not tell the names of open files")
    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(os, "replace", note_rename)
    with replacing(tmp_path / "a.txt", durable=True) as temporary:
        temporary.write_text("new")
    assert done == [temporary.name, "rename", tmp_path.name]
    done.clear()
    with filling(tmp_path / "a.zarr", durable=True) as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / "one").touch()
        (folder / "two").touch()
    assert sorted(done[:3]) == ["deep", "one", "two"]
    assert done[3:] == [folder.name, "rename", tmp_path.name]
    done.clear()
    fill(tmp_path / "b", "one")
    assert done == ["rename"]


def test_room_on_a_disk(tmp_path: Path):
    check_space(tmp_path / "a.tif", 1000)
    with pytest.raises(OSError, match=r"a\.tif needs 1(,000)+ bytes, but the disk has only .* fre"):
        check_space(tmp_path / "a.tif", 10**18)
    with pytest.raises(FileNotFoundError, match=r"folder .*nowhere does not exist"):
        check_space(tmp_path / "nowhere" / "a.tif", 1)


def test_names_in_their_own_folder():
    for name in ["stack.ome.tif", "a b", "..a", "-", "\N{GREEK SMALL LETTER MU}.h5"]:
        assert is_plain_name(name)


def test_names_that_lead_elsewhere():
    for name in [
        "",
        ".",
        "..",
        "../a",
        "a/b",
        "a/",
        "/a",
        "a\\b",
        "\\\\host\\a",
        "C:a",
        "a\0b",
        "\ud800",
        "a" * 256,
        "\N{EURO SIGN}" * 86,
        b"a",
        None,
        3,
    ]:
        assert not is_plain_name(name)


def test_temporary_names_of_nothing_are_left(tmp_path: Path):
    for stem in (".", ".."):
        (tmp_path / f".{stem}-0123456789ab.replaced").mkdir()
    clear_temporaries(tmp_path)
    assert tmp_path.is_dir()
