"""Views as pictures, one a view: in a folder, or in a zip archive that is read from memory."""

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
from clplen.io.lightfields.view_names import DEFAULT_PATTERN, Pattern, arranged, views_only
from clplen.io.lightfields.view_set import ViewSet
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield

_PATTERNS = {"hci": "input_Cam{i:03d}", "stanford": "out_{v:02d}_{u:02d}_{y:.6f}_{x:.6f}_"}
_RATIO = {zipfile.ZIP_STORED: 1.0, zipfile.ZIP_DEFLATED: DEFLATE}
_ENCRYPTED = 1  # bit of the flags
_BLOCK = 1 << 20  # bytes of a member read at a time
_DRIVE = re.compile(r"[A-Za-z]:")


@contextmanager
def open_folder(path: Path, *, device: Device, layout: Layout) -> Iterator[ViewSet]:
    """Open a folder of views."""
    pattern, shape, files = find_views(path, layout)
    picture_of = partial(read_view, max_bytes=layout.max_bytes)
    yield ViewSet(path, pattern, shape, files, picture_of, device, layout)


def find_views(folder: Path, layout: Layout) -> tuple[Pattern, View, dict[View, str]]:
    """Which file of a folder is which view, from the names alone.

    Masks, depths and object ids, as their names call them, are no views.
    """
    deep = layout.pattern is not None and "/" in layout.pattern
    try:
        files = [
            file for file in (folder.rglob("*") if deep else folder.iterdir()) if file.is_file()
        ]
    except OSError as error:
        raise FormatError(f"The folder {folder} cannot be read ({error.strerror}).") from error
    every = sorted(f.relative_to(folder).as_posix() for f in files)
    names = views_only(every, pattern=layout.pattern)
    pictures = [name for name in names if name.lower().endswith(picture.SUFFIXES)]
    return arranged(names, pictures, layout, str(folder))


def write_views(
    path: PathLike, lf: LightField | ArrayLike, *, pattern: str = DEFAULT_PATTERN
) -> None:
    """Write a light field as a new folder of pictures.

    uint8 becomes PNG; uint16, float16 and float32 become TIFF, which keeps them; float16 is read
    back as float32. Spacing, weights and camera have no place in pictures: HDF5 keeps them.

    Parameters
    ----------
    path : path-like
        A folder that does not exist yet, or is empty.
    lf : LightField or array_like
        Views (v, u, y, x), or (v, u, y, x, c) of 1 or 3 channels.
    pattern : str
        Names without suffix, by ``{v}`` and ``{u}`` or by ``{i}`` row by row, formatted as Python
        does: ``view_{v:02d}_{u:02d}``. "hci" is ``input_Cam{i:03d}`` of the HCI 4D benchmark;
        "stanford" is ``out_{v:02d}_{u:02d}_{y}_{x}_`` of the Stanford archive, y upwards and x to
        the right in view steps, from the positions of the views or their rows and columns.

    Raises
    ------
    FileExistsError, ShapeError, ValueError
        If the folder holds something; if the views have other than 1 or 3 channels; if the pattern
        is none, or holds ``{n}``, ``*`` or a folder.

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
    values, description = pictured(lf)
    name = _namer(pattern, lf)
    suffix = ".png" if lf.dtype == np.uint8 else ".tif"
    with filling(path) as folder:
        for v, u in np.ndindex(*values.shape[:2]):
            file = folder / (name(v, u) + suffix)
            write_picture(file, values[v, u], description=description)


def pictured(lf: LightField) -> tuple[np.ndarray[Any, Any], str]:
    """The samples of a light field as pictures hold them, and the description of each."""
    if len(lf.shape) == 5 and lf.shape[4] not in (1, 3):
        raise ShapeError(
            f"Pictures have 1 or 3 channels, this light field {lf.shape[4]}: write .h5 instead."
        )
    values = lf.to_numpy()
    return (values[..., 0], CHANNEL_AXIS) if values.shape[4:] == (1,) else (values, "")


def _namer(pattern: str, lf: LightField) -> Any:
    """(v, u) -> name without suffix."""
    if pattern != "stanford":
        text = _PATTERNS.get(pattern, pattern)
        Pattern(text)
        if "*" in text or "{n" in text or "/" in text:
            raise ValueError(f"The pattern {text!r} writes no names: it holds {{n}}, * or /.")
        return lambda v, u: text.format_map({"v": v, "u": u, "i": v * lf.shape[1] + u})
    return partial(_stanford, lf)


def _stanford(lf: LightField, v: int, u: int) -> str:
    y, x = v - (lf.shape[0] - 1) / 2, u - (lf.shape[1] - 1) / 2
    if lf.positions is not None:
        y, x = lf.positions[v, u]
    return _PATTERNS["stanford"].format(v=v, u=u, y=-y, x=x)


@contextmanager
def open_archive(path: Path, *, device: Device, layout: Layout) -> Iterator[ViewSet]:
    """Open a zip archive with one picture a view."""
    try:
        archive = zipfile.ZipFile(path)
    except UNREADABLE as error:
        raise FormatError(f"{path} is no zip archive that can be read ({error}).") from error
    with archive:
        yield _archive_views(archive, path, device, layout)


def _archive_views(archive: zipfile.ZipFile, path: Path, device: Device, layout: Layout) -> ViewSet:
    members = _members(archive, path)
    size = path.stat().st_size
    shown = views_only(members, pattern=layout.pattern)
    pictures = [name for name in shown if name.lower().endswith(picture.SUFFIXES)]
    inside = posixpath.commonpath([posixpath.dirname(name) for name in pictures] or [""])
    root = f"{inside}/" if inside else ""
    cut = len(root)
    names = [name[cut:] for name in shown if name.startswith(root)]
    found = arranged(names, [name[cut:] for name in pictures], layout, str(path))

    def picture_of(where: Path) -> np.ndarray[Any, Any]:
        info = members[where.relative_to(path).as_posix()]
        content = _content(archive, info, where, size, layout.max_bytes)
        values = decode_picture(content, where, max_bytes=layout.max_bytes)
        return with_channel_axis(without_alpha(values, where), content)

    return ViewSet(path / inside, *found, picture_of, device, layout)


def _members(archive: zipfile.ZipFile, path: Path) -> dict[str, zipfile.ZipInfo]:
    """The files of an archive by name."""
    members = {}
    for info in archive.infolist():
        name = info.filename.replace("\\", "/")
        if name.startswith("/") or _DRIVE.match(name) or ".." in name.split("/"):
            raise FormatError(
                f"{path}: the member {info.filename[:200]!r} lies outside of the archive: make a "
                "new one of the pictures only."
            )
        if name.endswith("/"):
            continue
        if (name := posixpath.normpath(name)) in members:
            raise FormatError(f"{path}: the member {name[:200]!r} is there twice.")
        members[name] = info
    return members


def _content(
    archive: zipfile.ZipFile,
    info: zipfile.ZipInfo,
    where: Path,
    size: int,
    max_bytes: int | None,
) -> bytes | mmap:
    """The bytes of a member, never more than it declares; ``size`` is that of the archive."""
    if info.flag_bits & _ENCRYPTED:
        raise FormatError(f"The picture {where} is encrypted: make an archive without a password.")
    if info.compress_type not in _RATIO:
        raise FormatError(
            f"The picture {where} is compressed by method {info.compress_type}: write the archive "
            "with deflate."
        )
    Bound(where, min(info.compress_size, size), _RATIO[info.compress_type], max_bytes).require(
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
        raise FormatError(f"The picture {where} cannot be read ({error}).") from error
    if len(content) != info.file_size:
        raise FormatError(f"The picture {where} has another size than its archive declares.")
    return content


def _without_zeros(member: IO[bytes], size: int) -> mmap:
    """The bytes of a large member; blocks of zeros, such as holes, take no memory."""
    content = mmap(-1, size)
    for start in range(0, size, _BLOCK):
        block = member.read(min(_BLOCK, size - start))
        if any(block):
            content[start : start + len(block)] = block
    return content
