"""Atomic output: a file or folder is written completely or not at all."""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PureWindowsPath

from clplen.errors import FormatError, ShapeError
from clplen.interrupts import unfinished

PathLike = str | os.PathLike[str]
_ERRNO = re.compile(r"errno = (\d+)")  # format of HDF5's messages
_TEMPORARY = re.compile(
    r"\.(?P<stem>(?!\.-).+)-[0-9a-f]{12}\.(?P<state>partial|replaced)(?P<suffix>(\.[^.]*)?)",
    re.DOTALL,
)
_REPLACED = "replaced"
_OCCUPIED = (errno.ENOTEMPTY, errno.EEXIST)
_FOLDER_EXISTS = "exists already and is not empty: choose a new folder."
_SYNC_THREADS = 8  # files synchronised at a time
_MAX_NAME_BYTES = 255  # NAME_MAX of Linux and macOS


def is_plain_name(name: object) -> bool:
    """Return True if a name read from a file cannot point outside its folder."""
    if not isinstance(name, str) or name in ("", "..") or "\0" in name:
        return False
    try:
        return name == PureWindowsPath(name).name and len(os.fsencode(name)) <= _MAX_NAME_BYTES
    except UnicodeEncodeError:
        return False


def check_writable(path: PathLike) -> Path:
    """Raise OSError if a file cannot be written; called before any computation."""
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(f"{target} is a folder: add the name of a file.")
    if target.exists() and not target.is_file():
        raise OSError(f"{target} is a device or a pipe: choose a regular file.")
    _check_takes_files(target.parent, target)
    return target


def require_file(path: PathLike, what: str, *, folder: bool = False) -> Path:
    """Raise FormatError for anything but a file: a pipe or device may block for ever."""
    path = Path(path)
    if path.is_file() or (folder and path.is_dir()):
        return path
    if not path.exists():
        raise FormatError(f"There is no {what} {path}.")
    kinds = "neither a file nor a folder" if folder else "not a file"
    raise FormatError(f"The {what} {path} is {kinds}: choose a file.")


def check_folder(path: PathLike) -> Path:
    """Create an output folder if it is missing, and check that files can be written to it."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(
            f"The output folder {folder} is a file or a broken link: remove it, or choose another "
            "folder."
        ) from error
    except OSError as error:
        raise type(error)(
            f"Cannot create the folder {folder} ({error.strerror}): choose another."
        ) from error
    _check_takes_files(folder, folder)
    return folder


@contextmanager
def output_folder(path: PathLike) -> Iterator[Path]:
    """Create an output folder as `check_folder` does; remove it after an exception if empty."""
    target = Path(path)
    new = [folder for folder in (target, *target.parents) if not folder.exists()]
    try:
        with ExitStack() as stack:
            for folder in new:  # innermost first
                stack.enter_context(unfinished(folder, filled=False))
            yield check_folder(target)
    except BaseException:
        with suppress(OSError):  # not empty, or never created
            for folder in new:
                folder.rmdir()
        raise


@contextmanager
def naming(path: PathLike) -> Iterator[None]:
    """Put the path of a file in front of the messages of ValueError and ShapeError."""
    try:
        yield
    except (ValueError, ShapeError) as error:
        raise type(error)(f"{path}: {error}") from error


def _check_takes_files(folder: Path, target: Path) -> None:
    """Create a file in a folder and remove it: permissions alone are not reliable."""
    if not folder.is_dir():
        raise FileNotFoundError(
            f"Cannot write {target}: the folder {folder} does not exist; create it, or choose "
            "another."
        )
    probe = _temporary_name(folder / "probe")
    try:
        probe.touch()
    except OSError as error:
        raise type(error)(
            f"Cannot write {target}: the folder {folder} is not writable "
            f"({error.strerror}); choose another."
        ) from error
    finally:
        _remove(probe)


def _remove(file: Path) -> None:
    """Remove a file if it exists; ignore errors, because the write has already reported them."""
    with suppress(OSError):
        file.unlink()


def _temporary_name(path: Path, state: str = "partial") -> Path:
    """Return an unused hidden name in the folder of a file, with its suffix.

    Partial files get a name no longer than the file system allows; replaced ones keep the stem.
    """
    stem, end = path.stem, f"-{secrets.token_hex(6)}.{state}{path.suffix}"
    if state != _REPLACED:
        room = _MAX_NAME_BYTES - len(os.fsencode(f".{end}"))
        stem = os.fsencode(stem)[: max(1, room)].decode(errors="ignore") or "_"
    return path.with_name(f".{stem}{end}")


def clear_temporaries(folder: PathLike) -> list[Path]:
    """Remove temporary files of killed processes, and complete an interrupted exchange.

    A folder that `filling` had moved aside gets its name back if the name is free. Call this only
    while no process writes to the folder: files of running processes look alike.
    """
    cleared = []
    for path in sorted(Path(folder).iterdir()):
        match = _TEMPORARY.fullmatch(path.name)
        if match is None:
            continue
        target = path.with_name(match["stem"] + match["suffix"])
        if match["state"] == _REPLACED and not target.exists():
            os.replace(path, target)
        elif path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
        cleared.append(path)
    return cleared


def check_space(path: PathLike, nbytes: int) -> None:
    """Raise OSError if the disk has no room for a file; called before any computation."""
    target = Path(path)
    _check_takes_files(target.parent, target)
    free = shutil.disk_usage(target.parent).free
    if nbytes > free:
        raise OSError(
            f"{path} needs {nbytes:,} bytes, but the disk has only {free:,} free: free "
            "some space, or choose another folder."
        )


@contextmanager
def replacing(path: PathLike, durable: bool = False) -> Iterator[Path]:
    """Write a file under a temporary name; rename it when the block succeeds.

    After any exception, including an interrupt, no temporary file remains and an existing file is
    unchanged. `clear_temporaries` removes the files of killed processes.
    """
    target = check_writable(path)
    temporary = _temporary_name(target)
    try:
        with write_errors(target), unfinished(temporary):
            yield temporary
            if durable:
                _sync(temporary)
            os.replace(temporary, target)
            if durable:
                _sync(target.parent)
    finally:
        _remove(temporary)


@contextmanager
def write_errors(target: Path) -> Iterator[None]:
    """Turn OSError into a message that names the file, the reason and a remedy."""
    try:
        yield
    except FileExistsError:
        raise
    except OSError as error:
        raise type(error)(f"Cannot write {target} ({_reason(error)}): {_advice(error)}.") from error


def _advice(error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return "its folder was removed; create it again, or choose another"
    if _number(error) == errno.ENAMETOOLONG:
        return "choose a shorter name"
    return "if the disk is full, free some space or choose another folder"


def _reason(error: OSError) -> str:
    """Return the system's message for an error that a library has reworded."""
    number = _number(error)
    return os.strerror(number) if number else str(error).partition("\n")[0]


def _number(error: OSError) -> int:
    """Return the errno of an error, parsed from HDF5's message if necessary; otherwise 0."""
    return error.errno or int(next(iter(_ERRNO.findall(str(error))), 0))


@contextmanager
def filling(path: PathLike, durable: bool = False, replace: bool = False) -> Iterator[Path]:
    """Fill a new folder under a temporary name, as `replacing` does for a file.

    With ``replace``, an existing folder is moved aside, the new one is renamed and the old one is
    removed. After a crash between these steps `clear_temporaries` restores or removes the old
    folder. If several processes write a folder, the last one wins.
    """
    target = Path(path)
    _check_free(target, replace)
    _check_takes_files(target.parent, target)
    temporary = _temporary_name(target)
    try:
        with write_errors(target), unfinished(temporary):
            temporary.mkdir()
            yield temporary
            if durable:
                _sync_all(temporary)
            if replace:
                _exchange(temporary, target)
            elif not _moved(temporary, target):
                raise FileExistsError(f"{target} {_FOLDER_EXISTS}")
            if durable:
                _sync(target.parent)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _check_free(target: Path, replace: bool) -> None:
    """Raise FileExistsError for a file, or for a non-empty folder unless ``replace`` is set."""
    if target.is_file() or (not replace and target.is_dir() and any(target.iterdir())):
        raise FileExistsError(f"{target} {_FOLDER_EXISTS}")


def _exchange(new: Path, target: Path) -> None:
    """Rename a folder to its final name, moving aside any folder that other processes put there."""
    aside: list[Path] = []
    try:
        while not _moved(new, target):
            old = _temporary_name(target, _REPLACED)
            with suppress(FileNotFoundError):  # another process has just moved it
                os.replace(target, old)
                aside.append(old)
    except BaseException:
        if aside and not target.exists():
            os.replace(aside.pop(), target)
        raise
    finally:
        for old in aside:
            shutil.rmtree(old, ignore_errors=True)


def _moved(new: Path, target: Path) -> bool:
    """Rename a folder; return False if a non-empty folder has the name."""
    try:
        os.replace(new, target)
    except OSError as error:
        if error.errno in _OCCUPIED:
            return False
        raise
    return True


def _sync_all(folder: Path) -> None:
    """Flush everything in a folder to disk, several files at a time."""
    with ThreadPoolExecutor(_SYNC_THREADS) as pool:
        list(pool.map(_sync, (item for item in folder.rglob("*"))))
    _sync(folder)


def _sync(path: Path) -> None:
    """Flush a file, or the directory entries of a folder, to disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
