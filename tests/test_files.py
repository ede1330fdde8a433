"""Files are written whole or not at all, and folders are tried before anything is computed."""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from clplen import plot
from clplen.compute.device import Device
from clplen.files import check_folder, check_writable, filling, output_folder, replacing
from clplen.io import write_lightfield, write_pfm, write_picture
from clplen.lightfield.lightfield import LightField


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
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


def test_the_new_file_replaces_the_old(tmp_path: Path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with replacing(target) as temporary:
        assert temporary.suffix == ".txt"
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


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


def test_no_folder(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"no folder .*nowhere; make it"):
        check_writable(tmp_path / "nowhere" / "a.tif")


def test_a_file_in_place_of_the_folder(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(FileNotFoundError, match=r"no folder .*file"):
        check_writable(tmp_path / "file" / "a.tif")
    with pytest.raises(NotADirectoryError, match="there is a file of this name"):
        check_folder(tmp_path / "file")


def test_a_folder_in_place_of_the_file(tmp_path: Path):
    with pytest.raises(IsADirectoryError, match="is a folder: name the file"):
        check_writable(tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="needs a folder that nobody may write to")
def test_a_folder_that_takes_no_files():
    with pytest.raises(OSError, match=r"the folder /proc takes no files .*choose another"):
        check_writable("/proc/stack.tif")
    with pytest.raises(OSError, match=r"folder /proc/demo cannot be made .*choose another"):
        check_folder("/proc/demo")


def test_a_disk_that_may_only_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "touch", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(OSError, match=r"takes no files \(Read-only file system\); choose another"):
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


@pytest.mark.parametrize("name", ["a.tif", "a.png", "a.pfm"])
def test_a_full_disk_is_said_in_one_sentence(tmp_path: Path, name: str):
    values = np.random.default_rng(1).integers(0, 255, (100, 300)).astype(np.uint8)
    write = write_pfm if name == "a.pfm" else write_picture
    said = rf"{name} cannot be written \(.*\): if the disk is full, m"
    with pytest.raises(OSError, match=said), small_disk():
        write(tmp_path / name, values)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_for_hdf5_and_figures(tmp_path: Path, device: Device):
    lf = LightField.from_array(np.random.default_rng(1).random((3, 3, 40, 50)), device=device)
    lf.to_numpy()
    figure = Figure()
    figure.add_subplot().imshow(np.random.default_rng(1).random((200, 200)))
    said = r"a\.{} cannot be written \(File too large\): if the disk"
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


def test_trying_leaves_nothing(tmp_path: Path):
    check_writable(tmp_path / "a.tif")
    check_folder(tmp_path / "new" / "folder")
    assert [file.name for file in tmp_path.rglob("*")] == ["new", "folder"]
