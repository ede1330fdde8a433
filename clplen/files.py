"""Files that are either written whole or not at all."""

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
_ERRNO = re.compile(r"errno = (\d+)")  # as HDF5 says it, in the midst of other things
_TEMPORARY = re.compile(
    r"\.(?P<stem>(?!\.-).+)-[0-9a-f]{12}\.(?P<state>partial|replaced)(?P<suffix>(\.[^.]*)?)",
    re.DOTALL,
)
_REPLACED = "replaced"
_OCCUPIED = (errno.ENOTEMPTY, errno.EEXIST)
_THERE = "is there already and not empty: name a new folder."
_SYNCS = 8  # files that wait for the disk at a time
_MAX_NAME = 255  # bytes: NAME_MAX of Linux and macOS


def is_plain_name(name: object) -> bool:
    """Return whether a name that a file holds leads to nothing outside of its own folder."""
    if not isinstance(name, str) or name in ("", "..") or "\0" in name:
        return False
    try:
        return name == PureWindowsPath(name).name and len(os.fsencode(name)) <= _MAX_NAME
    except UnicodeEncodeError:
        return False


def check_writable(path: PathLike) -> Path:
    """Find out whether a file can be written, before anything is computed for it."""
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(f"{target} is a folder: name the file to write in it.")
    if target.exists() and not target.is_file():
        raise OSError(f"{target} is a device or a pipe: name an ordinary file.")
    _check_takes_files(target.parent, target)
    return target


def require_file(path: PathLike, what: str, *, folder: bool = False) -> Path:
    """Refuse to read what is no file: opening a pipe or a device may wait for ever."""
    path = Path(path)
    if path.is_file() or (folder and path.is_dir()):
        return path
    if not path.exists():
        raise FormatError(f"There is no {what} {path}.")
    kinds = "neither a file nor a folder" if folder else "not a file"
    raise FormatError(f"The {what} {path} is {kinds}: name a file.")


def check_folder(path: PathLike) -> Path:
    """Make an output folder if it is not there, and find out whether it takes files."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(
            f"{folder} is to be a folder, but there is a file of this name, or a link to nothing: "
            "remove it, or choose another."
        ) from error
    except OSError as error:
        raise type(error)(
            f"The folder {folder} cannot be made ({error.strerror}): choose another."
        ) from error
    _check_takes_files(folder, folder)
    return folder


@contextmanager
def output_folder(path: PathLike) -> Iterator[Path]:
    """Make an output folder as `check_folder` does; after an exception no empty one is left."""
    wanted = Path(path)
    new = [folder for folder in (wanted, *wanted.parents) if not folder.exists()]
    try:
        with ExitStack() as held:
            for folder in new:  # the innermost first
                held.enter_context(unfinished(folder, filled=False))
            yield check_folder(wanted)
    except BaseException:
        with suppress(OSError):  # it holds something, or was never made
            for folder in new:
                folder.rmdir()
        raise


@contextmanager
def naming(path: PathLike) -> Iterator[None]:
    """Put the name of a file before what is said about its values."""
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


def _beside(path: Path, state: str = "partial") -> Path:
    """Name a hidden file that nobody else uses, with the same suffix in the same folder.

    What will be written gets a name that a disk takes wherever it takes the final one; what was
    replaced keeps its whole name, for `clear_temporaries`.
    """
    stem, end = path.stem, f"-{secrets.token_hex(6)}.{state}{path.suffix}"
    if state != _REPLACED:
        room = _MAX_NAME - len(os.fsencode(f".{end}"))
        stem = os.fsencode(stem)[: max(1, room)].decode(errors="ignore") or "_"
    return path.with_name(f".{stem}{end}")


def clear_temporaries(folder: PathLike) -> list[Path]:
    """Remove what killed processes left in a folder, and mend an exchange that they did not end.

    A folder that `filling` had moved aside takes its own name again if nothing has it. Call this
    while nobody writes there: the files of a living process look the same.
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
    """Find out whether a disk has room for a file, before anything is computed for it."""
    target = Path(path)
    _check_takes_files(target.parent, target)
    free = shutil.disk_usage(target.parent).free
    if nbytes > free:
        raise OSError(
            f"{path} takes {nbytes:,} bytes, of which the disk has {free:,} free: make room on it "
            "or choose another folder."
        )


@contextmanager
def replacing(path: PathLike, durable: bool = False) -> Iterator[Path]:
    """Write a file under a temporary name; it takes its own name when the block ends well.

    After any exception, an interrupt included, neither the temporary file nor a part of the
    wanted one is left, and a file that was there before is untouched. What a killed process
    leaves, `clear_temporaries` removes.
    """
    target = check_writable(path)
    temporary = _beside(target)
    try:
        with said_of(target), unfinished(temporary):
            yield temporary
            if durable:
                _sync(temporary)
            os.replace(temporary, target)
            if durable:
                _sync(target.parent)
    finally:
        _remove(temporary)


@contextmanager
def said_of(target: Path) -> Iterator[None]:
    """Say in one sentence what a disk refused."""
    try:
        yield
    except FileExistsError:
        raise
    except OSError as error:
        raise type(error)(
            f"{target} cannot be written ({_reason(error)}): {_advice(error)}."
        ) from error


def _advice(error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return "its folder is gone; make it again, or choose another"
    if _number(error) == errno.ENAMETOOLONG:
        return "choose a shorter name"
    return "if the disk is full, make room on it or choose another folder"


def _reason(error: OSError) -> str:
    """What the system says, out of what a library made of it."""
    number = _number(error)
    return os.strerror(number) if number else str(error).partition("\n")[0]


def _number(error: OSError) -> int:
    """The errno of an error, from the words of HDF5 where it has none; 0 if nothing tells."""
    return error.errno or int(next(iter(_ERRNO.findall(str(error))), 0))


@contextmanager
def filling(path: PathLike, durable: bool = False, replace: bool = False) -> Iterator[Path]:
    """Fill a new folder under a temporary name, as `replacing` does with a file.

    With ``replace`` a folder of this name is exchanged as a whole: it is moved aside, the new one
    takes its name, and the old one is removed. A crash between the first two leaves the old folder
    under a temporary name only; `clear_temporaries` brings it back, or removes it where the new
    one has come. Of several writers of one folder the last one stays.
    """
    target = Path(path)
    _check_free(target, replace)
    _check_takes_files(target.parent, target)
    temporary = _beside(target)
    try:
        with said_of(target), unfinished(temporary):
            temporary.mkdir()
            yield temporary
            if durable:
                _sync_all(temporary)
            if replace:
                _exchange(temporary, target)
            elif not _moved(temporary, target):
                raise FileExistsError(f"{target} {_THERE}")
            if durable:
                _sync(target.parent)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _check_free(target: Path, replace: bool) -> None:
    """Refuse a name that a file has, or a folder that holds something and is to stay."""
    if target.is_file() or (not replace and target.is_dir() and any(target.iterdir())):
        raise FileExistsError(f"{target} {_THERE}")


def _exchange(new: Path, target: Path) -> None:
    """Give a folder its name, whoever else does the same with another one."""
    aside: list[Path] = []
    try:
        while not _moved(new, target):
            old = _beside(target, _REPLACED)
            with suppress(FileNotFoundError):  # another writer has just moved it
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
    """Give a folder its name, if no folder that holds something has it."""
    try:
        os.replace(new, target)
    except OSError as error:
        if error.errno in _OCCUPIED:
            return False
        raise
    return True


def _sync_all(folder: Path) -> None:
    """Wait until the disk has everything in a folder, several files at a time."""
    with ThreadPoolExecutor(_SYNCS) as pool:
        list(pool.map(_sync, (item for item in folder.rglob("*"))))
    _sync(folder)


def _sync(path: Path) -> None:
    """Wait until the disk has a file, or the names in a folder."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
