"""Pictures, maps and films in Lytro containers processed by the maker's program.

Such files (``-stk.lfp``, ``-dm.lfp``) have no raw image. They contain a focal stack of JPEG
pictures, a film of viewpoints (H.264), and float32 maps of depth (unit lambda) and confidence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.io.formats.pfm import write_pfm
from clplen.io.raw.lytro_container import Section, open_sections
from clplen.outputs import check_output

Map = np.ndarray[Any, np.dtype[np.float32]]

_JPEG = b"\xff\xd8\xff"
_H264 = b"\0\0\0\1"
_MAPS = {"depthMap": "depth", "confidenceMap": "confidence", "depthLut": "depth_table"}
_MAX_SIDE = 1 << 14  # pixels of a map


@dataclass(frozen=True)
class _Part:
    """Section and its entry in the table of contents."""

    section: Section
    key: str
    entry: dict[str, Any]


def save_lytro_pictures(path: PathLike, folder: PathLike, *, force: bool = False) -> list[Path]:
    """Save the pictures, films and maps of a processed Lytro container.

    JPEG pictures and H.264 films are copied; maps of depth and confidence are saved as PFM.

    Parameters
    ----------
    path : path-like
        Container, such as ``IMG_0001-stk.lfp``.
    folder : path-like
        Output folder, created if missing.
    force : bool
        True to replace files of equal name and different content.

    Returns
    -------
    list of pathlib.Path
        Paths of the files, in the order of the table of contents.

    Raises
    ------
    FormatError, OSError
        If the container is damaged or has no pictures; if a file cannot be written or would
        replace a file of different content; then no file is written.
    """
    path, folder = Path(path), Path(folder)
    contents = list(_contents(path, *open_sections(path)))
    if not contents:
        raise FormatError(f"{path} has neither pictures nor maps.")
    for name, content in contents:
        _check_free(folder / name, content, force)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents:
        if isinstance(content, bytes):
            with replacing(folder / name) as temporary:
                temporary.write_bytes(content)
        else:
            write_pfm(folder / name, content)
    return [folder / name for name, _ in contents]


def _contents(
    path: Path, table: dict[str, Any], sections: list[Section]
) -> Iterator[tuple[str, bytes | Map]]:
    """Yield the names and contents of the output files."""
    counts: dict[str, int] = {}
    for part in _parts(table, sections):
        with path.open("rb") as file:
            file.seek(part.section.start)
            data = file.read(part.section.length)
        name, suffix, values = _file_type(part, data)
        if name:
            number = counts[name] = counts.get(name, -1) + 1
            yield f"{name}_{number:02d}{suffix}", data if values is None else values


def _check_free(target: Path, content: bytes | Map, force: bool) -> None:
    """Refuse to replace foreign files of different content; pictures carry no mark."""
    if not target.parent.is_dir():
        return
    is_equal = isinstance(content, bytes) and target.is_file() and target.read_bytes() == content
    check_output(target, force=force or (is_equal and not target.is_symlink()))


def _file_type(part: _Part, data: bytes) -> tuple[str, str, Map | None]:
    """Return name, suffix and map values of a section; empty strings for other data."""
    if data.startswith(_JPEG):
        return "picture", ".jpg", None
    if data.startswith(_H264):
        return "film", ".h264", None
    width, height = (part.entry.get(name) for name in ("width", "height"))
    if not (isinstance(width, int) and isinstance(height, int)):
        return "", "", None
    fits = 0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE and len(data) == 4 * width * height
    if not fits or part.key not in _MAPS:
        return "", "", None
    return _MAPS[part.key], ".pfm", np.frombuffer(data, "<f4").reshape(height, width)


def _parts(table: dict[str, Any], sections: list[Section]) -> Iterator[_Part]:
    """Yield each section referenced in a table once, with the enclosing object."""
    by_name = {section.name: section for section in sections}
    stack: list[tuple[str, dict[str, Any], Any]] = [("", {}, table)]
    while stack:
        key, entry, value = stack.pop()
        if isinstance(value, dict):
            # the size of a map is in the object itself or in the enclosing one
            inside = entry | {n: v for n, v in value.items() if n in ("width", "height")}
            stack.extend(
                (name if isinstance(item, dict | list) else key, inside, item)
                for name, item in reversed(value.items())
            )
        elif isinstance(value, list):
            stack.extend((key, entry, item) for item in reversed(value))
        elif isinstance(value, str) and value in by_name:
            yield _Part(by_name.pop(value), key, entry)
