"""Decide which files a command may overwrite: clplen's own, others only by force.

Every writer of this package puts `MARK` into the file's own metadata: the Software tag of TIFF, a
text chunk of PNG, a comment of GIF, MP4 and PLY, an attribute of HDF5 and Zarr, an entry of JSON,
the last line of a text. PFM, NumPy and CSV have no metadata; the spelling of their headers is the
mark: the scale of a PFM has 20 decimals, the header of a NumPy file is padded to 1024 bytes, and
the column names in a table of points, regions, tracks or traces are quoted. Other CSV files are
listed in the report beside them.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from clplen.errors import argument
from clplen.files import PathLike, check_folder, check_writable, filling, is_plain_name
from clplen.interrupts import unfinished

MARK = "Written by clplen"
_SEARCH_BYTES = 1 << 16  # searched for the mark at both ends of a file
PFM_SCALE = f"{-1:.20f}"  # little endian, values not scaled
NPY_HEADER = 1024  # bytes with padding; other programs pad to a multiple of 64
_HEADERS = (
    re.compile(rb"P[Ff]\n\d+ \d+\n" + PFM_SCALE.encode() + rb"\n"),
    re.compile(
        rb'"(?:point|region|track)",(?:"frame",)?"(?:z_m|z_voxel|mean)"(?:,"[a-z][a-z0-9_]*")+\r\n'
    ),
    re.compile(rb"\x93NUMPY\x01\0" + re.escape((NPY_HEADER - 10).to_bytes(2, "little"))),
)
_ZARR = (".zattrs", "zarr.json")  # files with the attributes of a Zarr root
_SYSTEM = (("/", "dev"), ("/", "proc"), ("/", "sys"))  # folders without regular files
_SHARED_MEMORY = ("/", "dev", "shm")


def is_ours(path: PathLike) -> bool:
    """Return True if a file or Zarr folder carries the mark of clplen."""
    path = Path(path)
    if path.is_symlink():
        return False
    files = [path / name for name in _ZARR] if path.is_dir() else [path]
    return any(_is_marked(file) for file in files if file.is_file())


def _is_marked(file: Path) -> bool:
    mark = MARK.encode()
    try:
        with file.open("rb") as stream:
            head = stream.read(_SEARCH_BYTES)
            if mark in head or any(header.match(head) for header in _HEADERS):
                return True
            stream.seek(max(file.stat().st_size - _SEARCH_BYTES, 0))
            return mark in stream.read(_SEARCH_BYTES)
    except OSError:
        return False


def check_output(path: PathLike, *, force: bool = False) -> Path:
    """Raise OSError if a command must not write a file; called before any computation."""
    target = Path(path)
    if _is_system(target):
        raise OSError(f"Cannot write to {target}; choose a path in a writable directory.")
    is_zarr = target.suffix.lower() == ".zarr" and target.is_dir()
    if not is_zarr:
        check_writable(target)
    if not os.path.lexists(target) or (is_zarr and not any(target.iterdir())) or is_ours(target):
        return target
    if is_zarr and not any((target / name).is_file() for name in (*_ZARR, ".zgroup", ".zarray")):
        raise FileExistsError(
            f"{target} exists already and is not an OME-Zarr: choose another name."
        )
    if target.suffix.lower() == ".zarr" and target.is_symlink():
        raise FileExistsError(f"{target} is {_reason(target)}: give the folder itself.")
    if not force:
        raise FileExistsError(
            f"{target} exists already, {_reason(target)}: choose another output, or replace it "
            f"with {argument('force', True)}."
        )
    return target


def _reason(target: Path) -> str:
    """Return the reason why an existing file is not recognised as clplen's."""
    if target.is_symlink():
        return f"a link to {os.readlink(target)}"
    return "and clplen did not write it"


def _is_system(target: Path) -> bool:
    """Return True if a path, or the target of a link, is a device or a system file."""
    if target.exists() and not (target.is_file() or target.is_dir()):
        return True
    parts = Path(os.path.realpath(target.parent)).parts
    return parts[:2] in _SYSTEM and parts[:3] != _SHARED_MEMORY


def check_outputs(folder: PathLike, names: Iterable[str], *, force: bool = False) -> None:
    """Apply `check_output` to several files of an existing folder."""
    inside = Path(folder)
    if inside.is_dir():
        for name in names:
            check_output(inside / name, force=force)


def listed(names: Iterable[str]) -> str:
    """Return a Markdown comment that lists the files of a folder that clplen wrote."""
    return f"<!-- {MARK}: {' | '.join(names)} -->\n"


@contextmanager
def updating(folder: PathLike, contents: str, *, force: bool = False) -> Iterator[Path]:
    """Fill a new or earlier output folder whose file ``contents`` ends with `listed`.

    Files of the earlier run are replaced and other files are kept. New files are first written
    elsewhere; after an exception the folder is unchanged.
    """
    target = Path(os.path.realpath(folder))
    if not target.is_dir() or not any(target.iterdir()):
        with filling(target) as fresh:
            yield fresh
        return
    earlier = _listed_in(target / contents)
    if not earlier and not force:
        raise FileExistsError(
            f"{folder} exists already, is not empty, and clplen did not write it: choose a new "
            f"folder, or write into it with {argument('force', True)}."
        )
    check_folder(target)
    with (
        tempfile.TemporaryDirectory(dir=target.parent, prefix=".clplen-") as staged,
        unfinished(Path(staged)),
    ):
        yield Path(staged)
        names = sorted(path.name for path in Path(staged).iterdir())
        for name in names:
            check_output(target / name, force=force or name in earlier)
        for name in earlier - set(names):
            (target / name).unlink(missing_ok=True)
        for name in names:
            os.replace(Path(staged, name), target / name)


def _listed_in(file: Path) -> set[str]:
    """Return the names in the line of `listed` in a file that clplen may replace.

    The line is untrusted: names with a path and files without the mark are left out.
    """
    if not is_ours(file):
        return set()
    last = file.read_text(encoding="utf-8", errors="replace").rstrip().rpartition("\n")[2]
    match = re.fullmatch(rf"<!-- {MARK}: (.*) -->", last)
    names = filter(is_plain_name, match[1].split(" | ") if match else ())
    paths = (file.with_name(name) for name in names)
    return {path.name for path in paths if path.is_file() and (_is_csv(path) or is_ours(path))}


def _is_csv(path: Path) -> bool:
    return path.suffix == ".csv" and not path.is_symlink()
