"""What a file or folder holds, as one number, and how large it is."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from clplen.files import PathLike

_BLOCK = 4 << 20  # bytes that are read at once


def digest(path: PathLike, *, algorithm: str = "sha256") -> str:
    """Return the digest of a file, or of all files in a folder with their names.

    That of a folder is taken over ``NAME\\0DIGEST\\n`` of each file in it, however deep, by the
    bytes of NAME, which is relative with slashes. Empty folders, times and permissions do not
    count.

    Parameters
    ----------
    path : path-like
        A file or folder; read in blocks of 4 MiB.
    algorithm : str
        Any of a fixed length in `hashlib.algorithms_guaranteed`.

    Returns
    -------
    str
        Hexadecimal digits, 64 of SHA-256.

    Raises
    ------
    ValueError, FileNotFoundError
        If there is no such algorithm; if there is nothing of this name.
    """
    if algorithm not in hashlib.algorithms_guaranteed or algorithm.startswith("shake"):
        raise ValueError(f"There is no digest {algorithm!r}: take 'sha256'.")
    path = Path(path)
    if not path.is_dir():
        return _of_file(path, algorithm)
    total = hashlib.new(algorithm)
    for file in _files(path):
        name = os.fsencode(file.relative_to(path).as_posix())
        total.update(name + b"\0" + _of_file(file, algorithm).encode() + b"\n")
    return total.hexdigest()


def size_of(path: PathLike) -> int:
    """Return the bytes of a file, or of all files in a folder together."""
    path = Path(path)
    files = _files(path) if path.is_dir() else [path]
    return sum(_there(file).stat().st_size for file in files)


def _files(folder: Path) -> list[Path]:
    files = (item for item in folder.rglob("*") if item.is_file())
    return sorted(files, key=lambda file: os.fsencode(file.relative_to(folder).as_posix()))


def _of_file(path: Path, algorithm: str) -> str:
    total = hashlib.new(algorithm)
    with _there(path).open("rb") as file:
        while block := file.read(_BLOCK):
            total.update(block)
    return total.hexdigest()


def _there(path: Path) -> Path:
    if not path.is_file():
        raise FileNotFoundError(f"There is no file or folder {path}.")
    return path
