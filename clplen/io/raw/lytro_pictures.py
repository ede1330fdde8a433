"""Pictures, maps and films that the maker's program put into processed Lytro containers.

Such files (``-stk.lfp``, ``-dm.lfp``) hold no raw image: a focal stack of JPEG pictures, a film of
viewpoints (H.264), and raw float32 maps of depth, in the maker's unit lambda, and of confidence.
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
_MOST = 1 << 14  # pixels a side of a map


@dataclass(frozen=True)
class _Part:
    """A section with what the table of contents says of it."""

    section: Section
    key: str
    described: dict[str, Any]


def save_lytro_pictures(path: PathLike, folder: PathLike, *, force: bool = False) -> list[Path]:
    """Save what a processed Lytro container holds.

    JPEG pictures and H.264 films are saved as they are; maps of depth and confidence as PFM.

    Parameters
    ----------
    path : path-like
        A container, such as ``IMG_0001-stk.lfp``.
    folder : path-like
        Made where it is missing.
    force : bool
        Whether to replace files of the same names that hold something else.

    Returns
    -------
    list of pathlib.Path
        The files, in the order of the table of contents.

    Raises
    ------
    FormatError, OSError
        If the container is damaged, or holds nothing of the kind; if a file cannot be written, or
        one of its name is there that holds something else; then none is written.
    """
    path, folder = Path(path), Path(folder)
    found = list(_contents(path, *open_sections(path)))
    if not found:
        raise FormatError(f"{path} holds neither pictures nor maps.")
    for name, content in found:
        _check_free(folder / name, content, force)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in found:
        if isinstance(content, bytes):
            with replacing(folder / name) as temporary:
                temporary.write_bytes(content)
        else:
            write_pfm(folder / name, content)
    return [folder / name for name, _ in found]


def _contents(
    path: Path, table: dict[str, Any], sections: list[Section]
) -> Iterator[tuple[str, bytes | Map]]:
    """Names of files with what they will hold."""
    counts: dict[str, int] = {}
    for part in _parts(table, sections):
        with path.open("rb") as file:
            file.seek(part.section.start)
            data = file.read(part.section.length)
        name, suffix, values = _recognised(part, data)
        if name:
            number = counts[name] = counts.get(name, -1) + 1
            yield f"{name}_{number:02d}{suffix}", data if values is None else values


def _check_free(target: Path, content: bytes | Map, force: bool) -> None:
    """Refuse to replace what is neither clplen's nor the same; pictures bear no mark."""
    if not target.parent.is_dir():
        return
    same = isinstance(content, bytes) and target.is_file() and target.read_bytes() == content
    check_output(target, force=force or (same and not target.is_symlink()))


def _recognised(part: _Part, data: bytes) -> tuple[str, str, Map | None]:
    """Name, suffix and, of a map, values of a section; no name for what is none of them."""
    if data.startswith(_JPEG):
        return "picture", ".jpg", None
    if data.startswith(_H264):
        return "film", ".h264", None
    width, height = (part.described.get(name) for name in ("width", "height"))
    if not (isinstance(width, int) and isinstance(height, int)):
        return "", "", None
    fits = 0 < width <= _MOST and 0 < height <= _MOST and len(data) == 4 * width * height
    if not fits or part.key not in _MAPS:
        return "", "", None
    return _MAPS[part.key], ".pfm", np.frombuffer(data, "<f4").reshape(height, width)


def _parts(table: dict[str, Any], sections: list[Section]) -> Iterator[_Part]:
    """Sections to which a table refers, each once, with the object around the reference."""
    places = {section.name: section for section in sections}
    left: list[tuple[str, dict[str, Any], Any]] = [("", {}, table)]
    while left:
        key, around, value = left.pop()
        if isinstance(value, dict):
            # a map tells its size itself, or beside it
            inside = around | {n: v for n, v in value.items() if n in ("width", "height")}
            left.extend(
                (name if isinstance(item, dict | list) else key, inside, item)
                for name, item in reversed(value.items())
            )
        elif isinstance(value, list):
            left.extend((key, around, item) for item in reversed(value))
        elif isinstance(value, str) and value in places:
            yield _Part(places.pop(value), key, around)
