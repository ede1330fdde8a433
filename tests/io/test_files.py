"""Files are written whole or not at all, and folders are tried before anything is computed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from clplen.io.files import check_folder, check_writable, filling, replacing


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


def test_trying_leaves_nothing(tmp_path: Path):
    check_writable(tmp_path / "a.tif")
    check_folder(tmp_path / "new" / "folder")
    assert [file.name for file in tmp_path.rglob("*")] == ["new", "folder"]
