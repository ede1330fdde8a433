"""Lytro containers (LFP, LFR), and the raw image with its JSON that other tools take out of them.

A container begins with 12 bytes of magic and a length of 0. Sections follow: 8 bytes of type (a
table of contents or content), 4 of version, the length (big endian), and, unless that is 0, 80
bytes with the name ``sha1-...``, the data and zeros up to the next section. The table of contents
is JSON and refers to the other sections by name (LFToolbox, Dansereau 2013-2020: LFReadLFP.m).
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
_HEAD = 16  # bytes of type, version and length
_NAME = 80  # bytes of the name with its zeros
_BLOCK = 1 << 16
_PADDING = 1 << 20  # zero bytes between sections; cameras pad to 16
_MOST = 4096  # sections
_JSON = 1 << 21  # bytes: a table with thousands of entries
_LISTED = 12  # sections that a message names
# Where the two generations keep what belongs to a frame.
_FRAMES = (("frames",), ("picture", "frameArray"), ("master", "picture", "frameArray"))
_BESIDE = (".json", ".JSON", ".txt", ".TXT")
_RAW = (".raw", ".RAW")
_METADATA, _PRIVATE = "_metadata", "_private_metadata"  # of other tools, before .json


@dataclass(frozen=True)
class Section:
    """A section of a container."""

    table: bool  # whether it is the table of contents
    name: str  # sha1-...; empty for a section without data
    start: int  # where its data lie, in bytes
    length: int  # where its data lie, in bytes


def read_container(
    path: PathLike, *, max_bytes: int | None = None
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], str | None]:
    """The raw image of a container, or of a raw file with its JSON."""
    return read_lytro_frame(path, max_bytes=max_bytes)[:2]


def read_lytro_frame(
    path: PathLike, *, max_bytes: int | None = None
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], str | None, LytroMetadata]:
    """The raw image and colour filters as `read_container` gives them, and the metadata."""
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    with path.open("rb") as file:
        if file.read(8) == LYTRO:
            return _read_container(path, file, max_bytes)
    raw, parts = _pair(path)
    with raw.open("rb") as file:
        whole = Section(table=False, name=raw.name, start=0, length=raw.stat().st_size)
        packing = packing_of(parts[0], raw, whole.length)
        return *_read_image(raw, file, whole, packing, max_bytes), lytro_metadata(*parts)


def _read_container(
    path: Path, file: BufferedReader, max_bytes: int | None
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], str | None, LytroMetadata]:
    sections = list(_sections(path, file))
    table = _table(path, file, sections)
    frame = _frame(table)
    image = None
    if not _is_processed(table) or frame.get("imageRef") in {s.name for s in sections}:
        image = _referred("imageRef", frame, path, sections)
    if image is None:
        raise FormatError(
            f"{path} holds no raw image, only {_listing(_titles(sections, table))}: take the "
            f"file that the camera wrote, before it was processed{_offer(path, table)}."
        )
    parts: list[dict[str, Any]] = []
    for key, what in (("metadataRef", "metadata"), ("privateMetadataRef", "private metadata")):
        inside = frame.get(key.removesuffix("Ref"))
        part = inside if isinstance(inside, dict) else {}
        if key == "metadataRef" or frame.get(key) in {section.name for section in sections}:
            described = _referred(key, frame, path, sections)
            if described is not None and described.length:
                part = _json(path, file, described, f"the {what} of the frame")
        parts.append(part)
    packing = packing_of(parts[0], path, image.length)
    return *_read_image(path, file, image, packing, max_bytes), lytro_metadata(*parts, table)


def open_sections(path: PathLike) -> tuple[dict[str, Any], list[Section]]:
    """The table of contents of a container and its sections."""
    path = Path(path)
    with path.open("rb") as file:
        sections = list(_sections(path, file))
        return _table(path, file, sections), sections


def processed_contents(path: PathLike) -> list[tuple[str, int]] | None:
    """Titles and bytes of the sections of a container without a raw image; None of other files."""
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
    """Name, first byte and length of the files that a volume of a calibration holds."""
    table, sections = open_sections(path)
    places = {section.name: section for section in sections}
    files = table.get("files")
    found = []
    for file in files if isinstance(files, list) else []:
        name, of = (file.get("name"), file.get("dataRef")) if isinstance(file, dict) else ("", "")
        if isinstance(name, str) and of in places:
            base = name.replace("\\", "/").rsplit("/", 1)[-1]
            found.append((base, places[of].start, places[of].length))
    return found


def _is_processed(table: dict[str, Any]) -> bool:
    """Whether a table of contents lists what the maker's program computed."""
    return bool(_at_picture(table).get("accelerationArray"))


def _at_picture(table: dict[str, Any]) -> dict[str, Any]:
    picture = table.get("picture")
    return picture if isinstance(picture, dict) else {}


def _offer(path: Path, table: dict[str, Any]) -> str:
    """Where the raw image may be, and how to get the pictures that are there."""
    raw = path.with_name(re.sub(r"-(stk|dm)$", "", path.stem) + path.suffix)
    beside = f" ({raw.name} lies beside it)" if raw != path and raw.is_file() else ""
    if not _is_processed(table):
        return beside
    return f"{beside}; 'clplen info {path} --save-pictures FOLDER' saves what is in this one"


def _read_image(
    path: Path, file: BufferedReader, section: Section, packing: Packing, max_bytes: int | None
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], str | None]:
    needed = packing.stored
    if section.length != needed:
        raise FormatError(
            f"{path}: a raw image of {packing.width} x {packing.height} pixels in {packing.bits} "
            f"bits takes {needed:,} bytes, but {section.length:,} are there: the image is cut "
            "off, or the metadata belong to another one."
        )
    Bound(path, section.length, 2, max_bytes).require(
        2 * packing.width * packing.height, "the raw image"
    )
    stored = np.memmap(file, np.uint8, "r", section.start, (section.length,))
    return unpack(stored, packing), packing.bayer


def _sections(path: Path, file: BufferedReader) -> Iterator[Section]:
    """The sections of a container, by their heads."""
    size = path.stat().st_size
    file.seek(0)
    if file.read(_HEAD) != _MAGIC + bytes(4):
        raise FormatError(f"{path} does not begin as a Lytro container of version 1.")
    place = _next_section(path, file, _HEAD)
    for number in range(_MOST):
        if place >= size:
            return
        section = _section(path, file, place, size, number)
        yield section
        place = _next_section(path, file, section.start + section.length)
    raise FormatError(f"{path} has more than {_MOST} sections: it is damaged.")


def _section(path: Path, file: BufferedReader, place: int, size: int, number: int) -> Section:
    file.seek(place)
    head = file.read(_HEAD)
    where = f"{path}: section {number} at byte {place:,}"
    if len(head) < _HEAD or head[:8] not in (_TABLE, _CONTENT):
        raise FormatError(f"{where} begins with none of the types LFM and LFC: it is damaged.")
    length = int.from_bytes(head[12:], "big")
    if length == 0:
        return Section(head[:8] == _TABLE, "", place + _HEAD, 0)
    start = place + _HEAD + _NAME
    if start + length > size:
        raise FormatError(
            f"{where} declares {length:,} bytes, {max(size - start, 0):,} are there: the file is "
            "truncated or damaged."
        )
    name = file.read(_NAME).rstrip(b"\0").decode("ascii", "replace")
    return Section(head[:8] == _TABLE, name, start, length)


def _next_section(path: Path, file: BufferedReader, place: int) -> int:
    """The first byte from ``place`` on that is not 0, or the end of the file."""
    end = place + _PADDING
    file.seek(place)
    while block := file.read(_BLOCK):
        rest = block.lstrip(b"\0")
        if rest:
            return place + len(block) - len(rest)
        place += len(block)
        if place > end:
            start = end - _PADDING
            raise FormatError(f"{path} is empty from byte {start:,} on: copy it again.")
    return place


def _table(path: Path, file: BufferedReader, sections: list[Section]) -> dict[str, Any]:
    for section in sections:
        if section.table and section.length:
            return _json(path, file, section, "the table of contents")
    raise FormatError(f"{path} has no table of contents among its {len(sections)} sections.")


def _json(path: Path, file: BufferedReader, section: Section, what: str) -> dict[str, Any]:
    file.seek(section.start)
    return parse_json(file.read(min(section.length, _JSON + 1)), path, what)


def parse_json(data: bytes, path: Path, what: str) -> dict[str, Any]:
    """The object of a JSON text."""
    if len(data) > _JSON:
        raise FormatError(f"{path}: {what} is longer than {_JSON:,} bytes: it is damaged.")
    try:
        found = json.loads(data.rstrip(b"\0"))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: {what} is no JSON ({error}).") from error
    if not isinstance(found, dict):
        raise FormatError(f"{path}: {what} is no JSON object.")
    return found


def _frame(table: dict[str, Any]) -> dict[str, Any]:
    """What a table says of its first frame; empty where it has none."""
    for keys in _FRAMES:
        found: Any = table
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        if isinstance(found, list) and found and isinstance(found[0], dict):
            frame = found[0].get("frame")
            if isinstance(frame, dict):
                return frame
    return {}


def _referred(
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
    called = []
    for section in sections:
        title = "the table of contents" if section.table else names.get(section.name, section.name)
        called.append((title or "an empty section", section.length))
    return called


def _references(table: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """(name of a section, where the table refers to it), for every reference."""
    left: list[tuple[str, Any]] = [("", table)]
    while left:
        place, value = left.pop()
        if isinstance(value, dict):
            left.extend((f"{place}.{key}".lstrip("."), item) for key, item in value.items())
        elif isinstance(value, list):
            left.extend((f"{place}[{i}]", item) for i, item in enumerate(value))
        elif isinstance(value, str) and re.match("sha1-", value):
            yield value, place


def _listing(titles: list[tuple[str, int]]) -> str:
    said = [f"{title} ({length:,} bytes)" for title, length in titles[:_LISTED]]
    more = len(titles) - _LISTED
    return ", ".join(said) + (f" and {more} more sections" if more > 0 else "")


def _pair(path: Path) -> tuple[Path, list[dict[str, Any]]]:
    """A raw file, its metadata and private metadata, from any of them; {} where there are none."""
    described = path.suffix.lower() in (".json", ".txt")
    stem = path.stem.removesuffix(_PRIVATE).removesuffix(_METADATA) if described else path.stem
    beside = [path.with_name(stem + suffix) for suffix in _RAW]
    raw = path if not described else next((file for file in beside if file.is_file()), None)
    if raw is None:
        raise FormatError(
            f"{path} is to describe a raw image, but there is no {beside[0].name} beside it."
        )
    names = [stem + suffix for suffix in (*_BESIDE, _METADATA + ".json")]
    texts = [path] if described and _PRIVATE not in path.stem else map(path.with_name, names)
    text = next((file for file in texts if file.is_file()), None)
    private = path.with_name(stem + _PRIVATE + ".json")
    return raw, [_described(file) for file in (text, private)]


def _described(text: Path | None) -> dict[str, Any]:
    if text is None or not text.is_file():
        return {}
    with text.open("rb") as file:
        return parse_json(file.read(_JSON + 1), text, "the description of the raw image")
