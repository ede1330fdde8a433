"""Fingerprints of files and folders: size, time of change, digest."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from clplen.io.store.digest import digest, size_of

Fingerprint = tuple[int, int]  # bytes, time of change in nanoseconds


def fingerprint(path: Path) -> Fingerprint:
    """Size and latest change; of a folder, of all files in it."""
    if not path.is_dir():
        found = path.stat()
        return found.st_size, found.st_mtime_ns
    inside = [file.stat() for file in path.rglob("*") if file.is_file()]
    return (
        sum(one.st_size for one in inside),
        max((one.st_mtime_ns for one in inside), default=path.stat().st_mtime_ns),
    )


def fingerprints(base: str, files: Iterable[str]) -> dict[str, Fingerprint]:
    """The stamp of each file, by its name as seen from ``base``."""
    return {name: fingerprint(Path(base, name)) for name in files}


def is_unchanged(base: str, files: Iterable[str], known: dict[str, dict[str, Any]]) -> bool:
    """Whether files are those that were read: by size and time of change, else by digest."""
    names = tuple(files)
    if set(names) != set(known):
        return False
    for name in names:
        path = Path(base, name)
        try:
            size, changed = fingerprint(path)
            then = known[name]
            if (size, changed) == (then["bytes"], then["changed"]):
                continue
            if size != then["bytes"] or digest(path) != then["sha256"]:
                return False
        except OSError:
            return False
    return True


def find_damage(folder: Path, outputs: dict[str, dict[str, Any]], *, thorough: bool = False) -> str:
    """What is wrong with written files, in words; empty if nothing is."""
    for name, known in outputs.items():
        path, size = folder / name, known["bytes"]
        try:
            found = size_of(path)
            is_other = thorough and found == size and digest(path) != known["sha256"]
        except FileNotFoundError:
            return f"{name} is missing"
        except OSError as error:
            return f"{name} cannot be read ({error.strerror})"
        if found != size:
            return f"{name} has {found:,} bytes, not {size:,}"
        if is_other:
            return (
                f"{name} is not what was written (its digest differs, its size does not): remove "
                "it and run again"
            )
    return ""
