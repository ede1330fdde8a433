"""Lytro containers (LFP, LFR), and raw images with JSON that other tools extract from them.

A container begins with 12 bytes of magic and a length of 0. Sections follow: 8 bytes of type (a
table of contents or content), 4 of version and the length (big endian). Sections of nonzero length
continue with 80 bytes of name ``sha1-...``, the data and padding of zeros. The table of contents is
JSON and refers to the other sections by name (LFToolbox, Dansereau 2013-2020: LFReadLFP.m).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats.packing import Packing, packing_of, unpack
from clplen.io.formats.untrusted import LYTRO, Bound
from clplen.io.raw.lytro_metadata import LytroMetadata, lytro_metadata

_MAGIC = LYTRO + b"\0\0\0\1"
_TABLE, _CONTENT = b"\x89LFM\r\n\x1a\n", b"\x89LFC\r\n\x1a\n"
_HEADER_BYTES = 16  # of type, version and length
_NAME_BYTES = 80  # of the name with its zeros
_BLOCK_BYTES = 1 << 16  # read at a time
_MAX_PADDING = 1 << 20  # zero bytes between sections; cameras pad to 16
_MAX_SECTIONS = 4096
_MAX_JSON_BYTES = 1 << 21  # a table with thousands of entries
_MAX_LISTED = 12  # sections named in a message
# Keys of the frames in the tables of contents of both generations.
_FRAMES = (("frames",), ("picture", "frameArray"), ("master", "picture", "frameArray"))
_JSON_SUFFIXES = (".json", ".JSON", ".txt", ".TXT")
_RAW = (".raw", ".RAW")
_METADATA, _PRIVATE = "_metadata", "_private_metadata"  # suffixes of other tools before .json


@dataclass(frozen=True)
class Section:
    """Section of a container."""

    table: bool  # True for the table of contents
    name: str  # sha1-...; empty for a section without data
    start: int  # byte offset of its data
    length: int  # size of its data in bytes


def read_container(
    path: PathLike, *, max_bytes: int | None = None
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], str | None]:
    """Return the raw image and colour filters of a container, or of a raw file with JSON."""
    return read_lytro_frame(path, max_bytes=max_bytes)[:2]


def read_lytro_frame(
    path: PathLike, *, max_bytes: int | None = None
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], str | None, LytroMetadata]:
    """Return the raw image, the colour filters and the metadata of a frame."""
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    with path.open("rb") as file:
        if file.read(8) == LYTRO:
            return _read_container(path, file, max_bytes)
    raw, parts = _pair(path)
    with raw.open("rb") as file:
        section = Section(table=False, name=raw.name, start=0, length=raw.stat().st_size)
        packing = packing_of(parts[0], raw, section.length)
        return *_read_image(raw, file, section, packing, max_bytes), lytro_metadata(*parts)


def _read_container(
    path: Path, file: BufferedReader, max_bytes: int | None
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], str | None, LytroMetadata]:
    sections = list(_sections(path, file))
    table = _table(path, file, sections)
    frame = _frame(table)
    image = None
    if not _is_processed(table) or frame.get("imageRef") in {s.name for s in sections}:
        image = _referenced_section("imageRef", frame, path, sections)
    if image is None:
        raise FormatError(
            f"{path} has no raw image, only {_listing(_titles(sections, table))}: use the original "
            f"file of the camera{_raw_image_advice(path, table)}."
        )
    parts: list[dict[str, Any]] = []
    for key, what in (("metadataRef", "metadata"), ("privateMetadataRef", "private metadata")):
        inside = frame.get(key.removesuffix("Ref"))
        part = inside if isinstance(inside, dict) else {}
        if key == "metadataRef" or frame.get(key) in {section.name for section in sections}:
            metadata = _referenced_section(key, frame, path, sections)
            if metadata is not None and metadata.length:
                part = _json(path, file, metadata, f"the {what} of the frame")
        parts.append(part)
    packing = packing_of(parts[0], path, image.length)
    return *_read_image(path, file, image, packing, max_bytes), lytro_metadata(*parts, table)


def open_sections(path: PathLike) -> tuple[dict[str, Any], list[Section]]:
    """Return the table of contents of a container and its sections."""
    path = Path(path)
    with path.open("rb") as file:
        sections = list(_sections(path, file))
        return _table(path, file, sections), sections


def processed_contents(path: PathLike) -> list[tuple[str, int]] | None:
    """Return titles and sizes of the sections of a processed container; None for other files."""
    path = Path(path)
    if not path.is_file():
        return None
    with path.open("rb") as file:
        if file.read(8) != LYTRO:
            return None
    table, sections = open_sections(path)
    names = {section.name for section in sections}
    if not _is_processed(table) or _frame(table).get("imageRef") in names:
        return None
    return _titles(sections, table)


def listed_files(path: PathLike) -> list[tuple[str, int, int]]:
    """Return name, first byte and length of the files in a volume of a calibration."""
    table, sections = open_sections(path)
    by_name = {section.name: section for section in sections}
    files = table.get("files")
    listing = []
    for file in files if isinstance(files, list) else []:
        name, reference = (
            (file.get("name"), file.get("dataRef")) if isinstance(file, dict) else ("", "")
        )
        if isinstance(name, str) and reference in by_name:
            base = name.replace("\\", "/").rsplit("/", 1)[-1]
            listing.append((base, by_name[reference].start, by_name[reference].length))
    return listing


def _is_processed(table: dict[str, Any]) -> bool:
    """Return True if a table of contents lists results of the maker's program."""
    return bool(_picture_entry(table).get("accelerationArray"))


def _picture_entry(table: dict[str, Any]) -> dict[str, Any]:
    picture = table.get("picture")
    return picture if isinstance(picture, dict) else {}


def _raw_image_advice(path: Path, table: dict[str, Any]) -> str:
    """Return advice for finding the raw image and for saving the pictures of the container."""
    raw = path.with_name(re.sub(r"-(stk|dm)$", "", path.stem) + path.suffix)
    hint = f" ({raw.name} is in the same folder)" if raw != path and raw.is_file() else ""
    if not _is_processed(table):
        return hint
    command = f"'clplen info {path} --save-pictures FOLDER'"
    return f"{hint}; to save the pictures in this file, run {command}"


def _read_image(
    path: Path, file: BufferedReader, section: Section, packing: Packing, max_bytes: int | None
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], str | None]:
    expected = packing.stored
    if section.length != expected:
        raise FormatError(
            f"{path}: a raw image of {packing.width} x {packing.height} pixels in {packing.bits} "
            f"bits must have {expected:,} bytes, got {section.length:,}: the image is truncated, "
            "or the metadata belong to another image."
        )
    Bound(path, section.length, 2, max_bytes).require(
        2 * packing.width * packing.height, "the raw image"
    )
    stored = np.memmap(file, np.uint8, "r", section.start, (section.length,))
    return unpack(stored, packing), packing.bayer


def _sections(path: Path, file: BufferedReader) -> Iterator[Section]:
    """Yield the sections of a container by their headers."""
    size = path.stat().st_size
    file.seek(0)
    if file.read(_HEADER_BYTES) != _MAGIC + bytes(4):
        raise FormatError(f"{path} does not begin as a Lytro container of version 1.")
    position = _next_section(path, file, _HEADER_BYTES)
    for number in range(_MAX_SECTIONS):
        if position >= size:
            return
        section = _section(path, file, position, size, number)
        yield section
        position = _next_section(path, file, section.start + section.length)
    raise FormatError(f"{path} has more than {_MAX_SECTIONS} sections: the file is damaged.")


def _section(path: Path, file: BufferedReader, position: int, size: int, number: int) -> Section:
    file.seek(position)
    head = file.read(_HEADER_BYTES)
    where = f"{path}: section {number} at byte {position:,}"
    if len(head) < _HEADER_BYTES or head[:8] not in (_TABLE, _CONTENT):
        raise FormatError(f"{where} must begin with the type LFM or LFC: the file is damaged.")
    length = int.from_bytes(head[12:], "big")
    if length == 0:
        return Section(head[:8] == _TABLE, "", position + _HEADER_BYTES, 0)
    start = position + _HEADER_BYTES + _NAME_BYTES
    if start + length > size:
        raise FormatError(
            f"{where} declares {length:,} bytes, but {max(size - start, 0):,} remain: the file is "
            "truncated or damaged."
        )
    name = file.read(_NAME_BYTES).rstrip(b"\0").decode("ascii", "replace")
    return Section(head[:8] == _TABLE, name, start, length)


def _next_section(path: Path, file: BufferedReader, position: int) -> int:
    """Return the offset of the next nonzero byte, or the end of the file."""
    end = position + _MAX_PADDING
    file.seek(position)
    while block := file.read(_BLOCK_BYTES):
        rest = block.lstrip(b"\0")
        if rest:
            return position + len(block) - len(rest)
        position += len(block)
        if position > end:
            start = end - _MAX_PADDING
            raise FormatError(f"{path} has only zeros after byte {start:,}: copy it again.")
    return position


def _table(path: Path, file: BufferedReader, sections: list[Section]) -> dict[str, Any]:
    for section in sections:
        if section.table and section.length:
            return _json(path, file, section, "the table of contents")
    raise FormatError(f"{path} has no table of contents among its {len(sections)} sections.")


def _json(path: Path, file: BufferedReader, section: Section, what: str) -> dict[str, Any]:
    file.seek(section.start)
    return parse_json(file.read(min(section.length, _MAX_JSON_BYTES + 1)), path, what)


def parse_json(data: bytes, path: Path, what: str) -> dict[str, Any]:
    """Return the object of a JSON text."""
    if len(data) > _MAX_JSON_BYTES:
        raise FormatError(
            f"{path}: {what} is longer than {_MAX_JSON_BYTES:,} bytes: the file is damaged."
        )
    try:
        content = json.loads(data.rstrip(b"\0"))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: {what} is not valid JSON ({error}).") from error
    if not isinstance(content, dict):
        raise FormatError(f"{path}: {what} is not a JSON object.")
    return content


def _frame(table: dict[str, Any]) -> dict[str, Any]:
    """Return the entry of the first frame of a table of contents; empty if missing."""
    for keys in _FRAMES:
        entry: Any = table
        for key in keys:
            entry = entry.get(key) if isinstance(entry, dict) else None
        if isinstance(entry, list) and entry and isinstance(entry[0], dict):
            frame = entry[0].get("frame")
            if isinstance(frame, dict):
                return frame
    return {}


def _referenced_section(
    key: str, frame: dict[str, Any], path: Path, sections: list[Section]
) -> Section | None:
    name = frame.get(key)
    if name is None:
        return None
    for section in sections:
        if section.name == name:
            return section
    raise FormatError(
        f"{path}: the table of contents refers to {key} {str(name)[:60]!r}, but no section has "
        "this name: the file is truncated or damaged."
    )


def _titles(sections: list[Section], table: dict[str, Any]) -> list[tuple[str, int]]:
    names = dict(_references(table))
    titles = []
    for section in sections:
        title = "the table of contents" if section.table else names.get(section.name, section.name)
        titles.append((title or "an empty section", section.length))
    return titles


def _references(table: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (name of a section, path of the reference in the table) for every reference."""
    stack: list[tuple[str, Any]] = [("", table)]
    while stack:
        key_path, value = stack.pop()
        if isinstance(value, dict):
            stack.extend((f"{key_path}.{key}".lstrip("."), item) for key, item in value.items())
        elif isinstance(value, list):
            stack.extend((f"{key_path}[{i}]", item) for i, item in enumerate(value))
        elif isinstance(value, str) and re.match("sha1-", value):
            yield value, key_path


def _listing(titles: list[tuple[str, int]]) -> str:
    items = [f"{title} ({length:,} bytes)" for title, length in titles[:_MAX_LISTED]]
    more = len(titles) - _MAX_LISTED
    return ", ".join(items) + (f" and {more} more sections" if more > 0 else "")


def _pair(path: Path) -> tuple[Path, list[dict[str, Any]]]:
    """Return a raw file and the objects of its metadata files; empty objects if missing."""
    is_text = path.suffix.lower() in (".json", ".txt")
    stem = path.stem.removesuffix(_PRIVATE).removesuffix(_METADATA) if is_text else path.stem
    candidates = [path.with_name(stem + suffix) for suffix in _RAW]
    raw = path if not is_text else next((file for file in candidates if file.is_file()), None)
    if raw is None:
        raise FormatError(
            f"{path} describes a raw image, but {candidates[0].name} is not in its folder."
        )
    names = [stem + suffix for suffix in (*_JSON_SUFFIXES, _METADATA + ".json")]
    texts = [path] if is_text and _PRIVATE not in path.stem else map(path.with_name, names)
    text = next((file for file in texts if file.is_file()), None)
    private = path.with_name(stem + _PRIVATE + ".json")
    return raw, [_read_json(file) for file in (text, private)]


def _read_json(text: Path | None) -> dict[str, Any]:
    if text is None or not text.is_file():
        return {}
    with text.open("rb") as file:
        return parse_json(file.read(_MAX_JSON_BYTES + 1), text, "the description of the raw image")
