"""Views as separate pictures in a folder or in a zip archive, which is not unpacked."""

from __future__ import annotations

import posixpath
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from mmap import mmap
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.compute.device import Device
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike, filling
from clplen.io.formats import picture
from clplen.io.formats.picture import (
    CHANNEL_AXIS,
    decode_picture,
    read_view,
    require_pixels,
    with_channel_axis,
    without_alpha,
    write_picture,
)
from clplen.io.formats.untrusted import DEFLATE, UNREADABLE, Bound
from clplen.io.lightfields.layout import Layout, View
from clplen.io.lightfields.view_names import DEFAULT_PATTERN, Pattern, assign_views, views_only
from clplen.io.lightfields.view_set import ViewSet
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield

_PATTERNS = {"hci": "input_Cam{i:03d}", "stanford": "out_{v:02d}_{u:02d}_{y:.6f}_{x:.6f}_"}
_MAX_RATIO = {zipfile.ZIP_STORED: 1.0, zipfile.ZIP_DEFLATED: DEFLATE}
_ENCRYPTED = 1  # flag bit
_BLOCK_BYTES = 1 << 20  # of a member read at a time
_DRIVE = re.compile(r"[A-Za-z]:")


@contextmanager
def open_folder(path: Path, *, device: Device, layout: Layout) -> Iterator[ViewSet]:
    """Open a folder of views."""
    pattern, shape, files = find_views(path, layout)
    picture_of = partial(read_view, max_bytes=layout.max_bytes)
    yield ViewSet(path, pattern, shape, files, picture_of, device, layout)


def find_views(folder: Path, layout: Layout) -> tuple[Pattern, View, dict[View, str]]:
    """Assign the files of a folder to views by their names.

    Files named as masks, depths or object ids are skipped.
    """
    deep = layout.pattern is not None and "/" in layout.pattern
    try:
        files = [
            file for file in (folder.rglob("*") if deep else folder.iterdir()) if file.is_file()
        ]
    except OSError as error:
        raise FormatError(f"Cannot read the folder {folder} ({error.strerror}).") from error
    relative_names = sorted(f.relative_to(folder).as_posix() for f in files)
    names = views_only(relative_names, pattern=layout.pattern)
    pictures = [name for name in names if name.lower().endswith(picture.SUFFIXES)]
    return assign_views(names, pictures, layout, str(folder))


def write_views(
    path: PathLike, lf: LightField | ArrayLike, *, pattern: str = DEFAULT_PATTERN
) -> None:
    """Write a light field as a new folder of pictures.

    uint8 becomes PNG; uint16, float16 and float32 become TIFF. float16 is read back as float32.
    Pictures cannot store spacing, weights and camera; use HDF5 for them.

    Parameters
    ----------
    path : path-like
        Folder that does not exist yet or is empty.
    lf : LightField or array_like
        Views (v, u, y, x), or (v, u, y, x, c) with 1 or 3 channels.
    pattern : str
        Names without suffix, with ``{v}`` and ``{u}`` or ``{i}`` row by row, in Python's format
        syntax: ``view_{v:02d}_{u:02d}``. "hci" is ``input_Cam{i:03d}`` of the HCI 4D benchmark.
        "stanford" is ``out_{v:02d}_{u:02d}_{y}_{x}_`` of the Stanford archive, with y upwards and x
        to the right in view steps, from the positions of the views or their rows and columns.

    Raises
    ------
    FileExistsError, ShapeError, ValueError
        If the folder is not empty; if the views do not have 1 or 3 channels; if the pattern is
        invalid, or contains ``{n}``, ``*`` or a folder.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.zeros((3, 3, 16, 16), np.uint8))
    >>> clplen.io.write_views("scene", lf, pattern="hci")
    >>> from pathlib import Path
    >>> sorted(file.name for file in Path("scene").iterdir())[-1]
    'input_Cam008.png'
    >>> clplen.read_lightfield("scene").shape
    (3, 3, 16, 16)
    """
    lf = as_lightfield(lf)
    values, description = as_pictures(lf)
    name = _namer(pattern, lf)
    suffix = ".png" if lf.dtype == np.uint8 else ".tif"
    with filling(path) as folder:
        for v, u in np.ndindex(*values.shape[:2]):
            file = folder / (name(v, u) + suffix)
            write_picture(file, values[v, u], description=description)


def as_pictures(lf: LightField) -> tuple[np.ndarray[Any, Any], str]:
    """Return the samples of a light field as pictures, and their description."""
    if len(lf.shape) == 5 and lf.shape[4] not in (1, 3):
        raise ShapeError(
            f"Pictures must have 1 or 3 channels, got {lf.shape[4]}: write .h5 instead."
        )
    values = lf.to_numpy()
    return (values[..., 0], CHANNEL_AXIS) if values.shape[4:] == (1,) else (values, "")


def _namer(pattern: str, lf: LightField) -> Any:
    """Return a function from (v, u) to a name without suffix."""
    if pattern != "stanford":
        text = _PATTERNS.get(pattern, pattern)
        Pattern(text)
        if "*" in text or "{n" in text or "/" in text:
            raise ValueError(f"pattern must not contain {{n}}, * or / for writing, got {text!r}.")
        return lambda v, u: text.format_map({"v": v, "u": u, "i": v * lf.shape[1] + u})
    return partial(_stanford_name, lf)


def _stanford_name(lf: LightField, v: int, u: int) -> str:
    y, x = v - (lf.shape[0] - 1) / 2, u - (lf.shape[1] - 1) / 2
    if lf.positions is not None:
        y, x = lf.positions[v, u]
    return _PATTERNS["stanford"].format(v=v, u=u, y=-y, x=x)


@contextmanager
def open_archive(path: Path, *, device: Device, layout: Layout) -> Iterator[ViewSet]:
    """Open a zip archive with a picture per view."""
    try:
        archive = zipfile.ZipFile(path)
    except UNREADABLE as error:
        raise FormatError(f"{path} is not a readable zip archive ({error}).") from error
    with archive:
        yield _archive_views(archive, path, device, layout)


def _archive_views(archive: zipfile.ZipFile, path: Path, device: Device, layout: Layout) -> ViewSet:
    members = _members(archive, path)
    size = path.stat().st_size
    candidates = views_only(members, pattern=layout.pattern)
    pictures = [name for name in candidates if name.lower().endswith(picture.SUFFIXES)]
    inside = posixpath.commonpath([posixpath.dirname(name) for name in pictures] or [""])
    root = f"{inside}/" if inside else ""
    skip = len(root)
    names = [name[skip:] for name in candidates if name.startswith(root)]
    assignment = assign_views(names, [name[skip:] for name in pictures], layout, str(path))

    def picture_of(where: Path) -> np.ndarray[Any, Any]:
        info = members[where.relative_to(path).as_posix()]
        content = _content(archive, info, where, size, layout.max_bytes)
        values = decode_picture(content, where, max_bytes=layout.max_bytes)
        return with_channel_axis(without_alpha(values, where), content)

    return ViewSet(path / inside, *assignment, picture_of, device, layout)


def _members(archive: zipfile.ZipFile, path: Path) -> dict[str, zipfile.ZipInfo]:
    """Return the files of an archive by name."""
    members = {}
    for info in archive.infolist():
        name = info.filename.replace("\\", "/")
        if name.startswith("/") or _DRIVE.match(name) or ".." in name.split("/"):
            raise FormatError(
                f"{path}: the member {info.filename[:200]!r} is outside the archive: create a new "
                "archive of the pictures only."
            )
        if name.endswith("/"):
            continue
        if (name := posixpath.normpath(name)) in members:
            raise FormatError(f"{path}: the member {name[:200]!r} occurs twice.")
        members[name] = info
    return members


def _content(
    archive: zipfile.ZipFile,
    info: zipfile.ZipInfo,
    where: Path,
    size: int,
    max_bytes: int | None,
) -> bytes | mmap:
    """Return the bytes of a member, at most as many as declared; ``size`` is the archive's."""
    if info.flag_bits & _ENCRYPTED:
        raise FormatError(
            f"The picture {where} is encrypted: create an archive without a password."
        )
    if info.compress_type not in _MAX_RATIO:
        raise FormatError(
            f"The picture {where} is compressed with method {info.compress_type}: write the "
            "archive with deflate."
        )
    Bound(where, min(info.compress_size, size), _MAX_RATIO[info.compress_type], max_bytes).require(
        info.file_size, "the picture"
    )
    try:
        with archive.open(info) as member:
            require_pixels(member, info.file_size, where)
            member.seek(0)
            is_tiff = member.read(4) in picture.TIFF
            member.seek(0)
            if is_tiff and info.file_size > picture.LARGE:
                return _without_zeros(member, info.file_size)
            content = member.read(info.file_size + 1)
    except UNREADABLE as error:
        raise FormatError(f"The picture {where} is unreadable ({error}).") from error
    if len(content) != info.file_size:
        raise FormatError(f"The picture {where} has a different size than its archive declares.")
    return content


def _without_zeros(member: IO[bytes], size: int) -> mmap:
    """Return the bytes of a large member; blocks of zeros, such as holes, use no memory."""
    content = mmap(-1, size)
    for start in range(0, size, _BLOCK_BYTES):
        block = member.read(min(_BLOCK_BYTES, size - start))
        if any(block):
            content[start : start + len(block)] = block
    return content
