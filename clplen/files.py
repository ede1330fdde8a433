"""Files that are either written whole or not at all."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clplen.errors import ShapeError

PathLike = str | os.PathLike[str]
_ERRNO = re.compile(r"errno = (\d+)")  # as HDF5 says it, in the midst of other things


def check_writable(path: PathLike) -> Path:
    """Find out whether a file can be written, before anything is computed for it.

    Parameters
    ----------
    path : path-like
        The file that will be written; it may exist and will then be replaced.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    OSError
        If ``path`` is a folder, or its folder does not exist or takes no files.
    """
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(f"{target} is a folder: name the file to write in it.")
    _check_takes_files(target.parent, target)
    return target


def check_folder(path: PathLike) -> Path:
    """Make an output folder if it is not there, and find out whether it takes files.

    Parameters
    ----------
    path : path-like
        The folder; its parents are made too.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    OSError
        If it cannot be made or takes no files.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(
            f"{folder} is to be a folder, but there is a file of this name: choose another."
        ) from error
    except OSError as error:
        raise type(error)(
            f"The folder {folder} cannot be made ({error.strerror}): choose another."
        ) from error
    _check_takes_files(folder, folder)
    return folder


@contextmanager
def output_folder(path: PathLike) -> Iterator[Path]:
    """Make an output folder as `check_folder` does; after an exception no empty one is left.

    Parameters
    ----------
    path : path-like

    Yields
    ------
    pathlib.Path
    """
    wanted = Path(path)
    new = [folder for folder in (wanted, *wanted.parents) if not folder.exists()]
    try:
        yield check_folder(wanted)
    except BaseException:
        with suppress(OSError):  # it holds something, or was never made
            for folder in new:
                folder.rmdir()
        raise


@contextmanager
def naming(path: PathLike) -> Iterator[None]:
    """Put the name of a file before what is said about its values.

    Parameters
    ----------
    path : path-like
    """
    try:
        yield
    except (ValueError, ShapeError) as error:
        raise type(error)(f"{path}: {error}") from error


def _check_takes_files(folder: Path, target: Path) -> None:
    """Make a file in a folder and remove it: permissions alone do not tell."""
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{target} cannot be written: there is no folder {folder}; make it, or choose another."
        )
    probe = _beside(folder / "probe")
    try:
        probe.touch()
    except OSError as error:
        raise type(error)(
            f"{target} cannot be written: the folder {folder} takes no files "
            f"({error.strerror}); choose another."
        ) from error
    finally:
        _remove(probe)


def _remove(file: Path) -> None:
    """Remove a file if it is there; a disk that refuses has refused before, in better words."""
    with suppress(OSError):
        file.unlink()


def _beside(path: Path) -> Path:
    """Name a hidden file that nobody else uses, with the same suffix in the same folder."""
    return path.with_name(f".{path.stem}-{secrets.token_hex(6)}{path.suffix}")


@contextmanager
def replacing(path: PathLike) -> Iterator[Path]:
    """Write a file under a temporary name; it takes its own name when the block ends well.

    After any exception, an interrupt included, neither the temporary file nor a part of the
    wanted one is left, and a file that was there before is untouched.

    Parameters
    ----------
    path : path-like
        The file to write.

    Yields
    ------
    pathlib.Path
        The name to write to.

    Raises
    ------
    OSError
        If the disk is full or refuses the file for another reason.
    """
    target = check_writable(path)
    temporary = _beside(target)
    try:
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        raise type(error)(
            f"{target} cannot be written ({_reason(error)}): if the disk is full, make room on it "
            "or choose another folder."
        ) from error
    finally:
        _remove(temporary)


def _reason(error: OSError) -> str:
    """What the system says, out of what a library made of it."""
    number = error.errno or next(iter(_ERRNO.findall(str(error))), 0)
    return os.strerror(int(number)) if number else str(error).partition("\n")[0]


@contextmanager
def filling(path: PathLike) -> Iterator[Path]:
    """Fill a new folder under a temporary name, as `replacing` does with a file.

    Parameters
    ----------
    path : path-like
        A folder that does not exist yet, or is empty.

    Yields
    ------
    pathlib.Path
        The folder to write into.

    Raises
    ------
    FileExistsError
        If there is a file, or a folder that holds something: old and new files would mix.
    """
    target = Path(path)
    if target.exists() and not (target.is_dir() and not any(target.iterdir())):
        raise FileExistsError(f"{target} is there already and not empty: name a new folder.")
    _check_takes_files(target.parent, target)
    temporary = _beside(target)
    temporary.mkdir()
    try:
        yield temporary
        if target.is_dir():
            target.rmdir()
        os.replace(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
