"""Digests and sizes of files and folders."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from clplen.files import PathLike

_BLOCK_BYTES = 4 << 20  # bytes read at a time


def digest(path: PathLike, *, algorithm: str = "sha256") -> str:
    """Return the digest of a file, or of all files in a folder with their names.

    The digest of a folder is taken over ``NAME\\0DIGEST\\n`` of each file in it and its subfolders,
    sorted by the bytes of NAME. NAME is the relative path with slashes. Empty folders, times and
    permissions have no influence.

    Parameters
    ----------
    path : path-like
        A file or folder; read in blocks of 4 MiB.
    algorithm : str
        Name in `hashlib.algorithms_guaranteed`, of fixed length.

    Returns
    -------
    str
        Hexadecimal digits, 64 of SHA-256.

    Raises
    ------
    ValueError, FileNotFoundError
        If the algorithm is unknown; if the path does not exist.
    """
    if algorithm not in hashlib.algorithms_guaranteed or algorithm.startswith("shake"):
        raise ValueError(
            f"algorithm must be a digest of fixed length, got {algorithm!r}: use 'sha256'."
        )
    path = Path(path)
    if not path.is_dir():
        return _file_digest(path, algorithm)
    total = hashlib.new(algorithm)
    for file in _files(path):
        name = os.fsencode(file.relative_to(path).as_posix())
        total.update(name + b"\0" + _file_digest(file, algorithm).encode() + b"\n")
    return total.hexdigest()


def size_of(path: PathLike) -> int:
    """Return the size in bytes of a file, or of all files in a folder."""
    path = Path(path)
    files = _files(path) if path.is_dir() else [path]
    return sum(_existing(file).stat().st_size for file in files)


def _files(folder: Path) -> list[Path]:
    files = (item for item in folder.rglob("*") if item.is_file())
    return sorted(files, key=lambda file: os.fsencode(file.relative_to(folder).as_posix()))


def _file_digest(path: Path, algorithm: str) -> str:
    total = hashlib.new(algorithm)
    with _existing(path).open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            total.update(block)
    return total.hexdigest()


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise FileNotFoundError(f"There is no file or folder {path}.")
    return path
