"""Fingerprints of files and folders: size, modification time, digest."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from clplen.io.store.digest import digest, size_of

Fingerprint = tuple[int, int]  # bytes, time of change in nanoseconds


def fingerprint(path: Path) -> Fingerprint:
    """Return size and latest modification of a file, or of all files in a folder."""
    if not path.is_dir():
        status = path.stat()
        return status.st_size, status.st_mtime_ns
    statuses = [file.stat() for file in path.rglob("*") if file.is_file()]
    return (
        sum(status.st_size for status in statuses),
        max((status.st_mtime_ns for status in statuses), default=path.stat().st_mtime_ns),
    )


def fingerprints(base: str, files: Iterable[str]) -> dict[str, Fingerprint]:
    """Return the fingerprint of each file, by its path relative to ``base``."""
    return {name: fingerprint(Path(base, name)) for name in files}


def is_unchanged(base: str, files: Iterable[str], records: dict[str, dict[str, Any]]) -> bool:
    """Return True if files equal their records, by size and modification time or by digest."""
    names = tuple(files)
    if set(names) != set(records):
        return False
    for name in names:
        path = Path(base, name)
        try:
            size, changed = fingerprint(path)
            record = records[name]
            if (size, changed) == (record["bytes"], record["changed"]):
                continue
            if size != record["bytes"] or digest(path) != record["sha256"]:
                return False
        except OSError:
            return False
    return True


def find_damage(folder: Path, outputs: dict[str, dict[str, Any]], *, thorough: bool = False) -> str:
    """Return the first damage of written files as text; empty if all files are intact."""
    for name, record in outputs.items():
        path, expected = folder / name, record["bytes"]
        try:
            size = size_of(path)
            is_other = thorough and size == expected and digest(path) != record["sha256"]
        except FileNotFoundError:
            return f"{name} is missing"
        except OSError as error:
            return f"{name} cannot be read ({error.strerror})"
        if size != expected:
            return f"{name} has {size:,} bytes, not {expected:,}"
        if is_other:
            return (
                f"the content of {name} changed, but not its size: remove the file and run the "
                "job again"
            )
    return ""
