"""What a command may write over: the files that clplen wrote, others only by force.

Every writer of this package puts `MARK` into the file's own metadata: the Software tag of TIFF, a
text chunk of PNG, a comment of GIF, MP4 and PLY, an attribute of HDF5 and Zarr, an entry of JSON,
the last line of a text. PFM and NumPy have no place for words, but freedom in how their headers are
spelt, which every reader of them takes: the scale of a PFM is written with 20 decimals, and the
header of a NumPy file is padded to 1024 bytes, and the names of the columns in a table of points,
regions, tracks or traces are quoted. Other CSV has no place at all: the report beside it lists it.
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
_ENDS = 1 << 16  # bytes at the beginning and at the end of a file in which the mark is looked for
PFM_SCALE = f"{-1:.20f}"  # little endian, values as they are
NPY_HEADER = 1024  # bytes with the padding; other programs pad to the next multiple of 64
_HEADERS = (
    re.compile(rb"P[Ff]\n\d+ \d+\n" + PFM_SCALE.encode() + rb"\n"),
    re.compile(
        rb'"(?:point|region|track)",(?:"frame",)?"(?:z_m|z_voxel|mean)"(?:,"[a-z][a-z0-9_]*")+\r\n'
    ),
    re.compile(rb"\x93NUMPY\x01\0" + re.escape((NPY_HEADER - 10).to_bytes(2, "little"))),
)
_ZARR = (".zattrs", "zarr.json")  # where the attributes of a Zarr's root stand
_SYSTEM = (("/", "dev"), ("/", "proc"), ("/", "sys"))  # these hold no ordinary files
_SHARED_MEMORY = ("/", "dev", "shm")



def is_ours(path: PathLike) -> bool:
    """Whether clplen wrote a file or a Zarr folder, as far as it tells."""
    path = Path(path)
    if path.is_symlink():
        return False
    files = [path / name for name in _ZARR] if path.is_dir() else [path]
    return any(_is_marked(file) for file in files if file.is_file())


def _is_marked(file: Path) -> bool:
    mark = MARK.encode()
    try:
        with file.open("rb") as stream:
            head = stream.read(_ENDS)
            if mark in head or any(header.match(head) for header in _HEADERS):
                return True
            stream.seek(max(file.stat().st_size - _ENDS, 0))
            return mark in stream.read(_ENDS)
    except OSError:
        return False


def check_output(path: PathLike, *, force: bool = False) -> Path:
    """Find out whether a command may write a file, before anything is computed for it."""
    target = Path(path)
    if _is_system(target):
        raise OSError(f"{target} is no place for a file: name one in a folder of yours.")
    is_zarr = target.suffix.lower() == ".zarr" and target.is_dir()
    if not is_zarr:
        check_writable(target)
    if not os.path.lexists(target) or (is_zarr and not any(target.iterdir())) or is_ours(target):
        return target
    if is_zarr and not any((target / name).is_file() for name in (*_ZARR, ".zgroup", ".zarray")):
        raise FileExistsError(f"{target} is there already and no OME-Zarr: choose another name.")
    if target.suffix.lower() == ".zarr" and target.is_symlink():
        raise FileExistsError(f"{target} is {_reason(target)}: name the folder itself.")
    if not force:
        raise FileExistsError(
            f"{target} is there already, {_reason(target)}: name another output, or "
            f"{argument('force', True)} replaces it."
        )
    return target


def _reason(target: Path) -> str:
    """Why what is there is not known to be clplen's."""
    if target.is_symlink():
        return f"a link to {os.readlink(target)}"
    return "and clplen did not write it"


def _is_system(target: Path) -> bool:
    """Whether a name, or what it is linked to, is a device or another thing of the system."""
    if target.exists() and not (target.is_file() or target.is_dir()):
        return True
    parts = Path(os.path.realpath(target.parent)).parts
    return parts[:2] in _SYSTEM and parts[:3] != _SHARED_MEMORY


def check_outputs(folder: PathLike, names: Iterable[str], *, force: bool = False) -> None:
    """`check_output` of several files of a folder, where it is there already."""
    inside = Path(folder)
    if inside.is_dir():
        for name in names:
            check_output(inside / name, force=force)


def listed(names: Iterable[str]) -> str:
    """A last line of Markdown, not shown, that tells which files of a folder clplen wrote."""
    return f"<!-- {MARK}: {' | '.join(names)} -->\n"


@contextmanager
def updating(folder: PathLike, contents: str, *, force: bool = False) -> Iterator[Path]:
    """Fill a folder, new or of an earlier run, whose file ``contents`` ends in `listed`.

    What the earlier run wrote goes, other files stay. The new files are written elsewhere first;
    after an exception the folder is as it was.
    """
    target = Path(os.path.realpath(folder))
    if not target.is_dir() or not any(target.iterdir()):
        with filling(target) as fresh:
            yield fresh
        return
    earlier = _listed_in(target / contents)
    if not earlier and not force:
        raise FileExistsError(
            f"{folder} is there already and not empty, and clplen did not write it: name a new "
            f"folder, or {argument('force', True)} writes into it."
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
    """Return the names in the last line of a file of `listed` that clplen may replace.

    Others may have written the line: it leads to no other folder, and to no file that could have
    the mark and has none.
    """
    if not is_ours(file):
        return set()
    last = file.read_text(encoding="utf-8", errors="replace").rstrip().rpartition("\n")[2]
    found = re.fullmatch(rf"<!-- {MARK}: (.*) -->", last)
    names = filter(is_plain_name, found[1].split(" | ") if found else ())
    paths = (file.with_name(name) for name in names)
    return {path.name for path in paths if path.is_file() and (_is_csv(path) or is_ours(path))}


def _is_csv(path: Path) -> bool:
    return path.suffix == ".csv" and not path.is_symlink()
