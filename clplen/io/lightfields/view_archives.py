"""Zip archives of views, decoded from memory: nothing is extracted to disk."""

from __future__ import annotations

import posixpath
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats.picture import SUFFIXES, decode_picture, without_alpha
from clplen.io.formats.untrusted import DEFLATE, UNREADABLE, require_bytes
from clplen.io.lightfields.layout import Layout
from clplen.io.lightfields.view_names import views_only
from clplen.io.lightfields.view_set import ViewSet, arranged, assemble, stored_views
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.stored import StoredLightField

_RATIO = {zipfile.ZIP_STORED: 1.0, zipfile.ZIP_DEFLATED: DEFLATE}
_ENCRYPTED = 1  # bit of the flags
_DRIVE = re.compile(r"[A-Za-z]:")


def read(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read a zip archive with one picture a view.

    The names follow the rules of a folder, from the deepest folder on that holds all pictures.

    Parameters
    ----------
    path : path-like
    device : Device
    layout : Layout
    progress : bool
        Whether to show a bar on standard error.

    Returns
    -------
    LightField, str
        The light field, and what was taken for what, in one sentence.

    Raises
    ------
    FormatError
        If the archive is damaged or encrypted, a member lies outside of it or declares more than it
        can hold; else as for a folder of views.
    ValueError
        If a sample is NaN or infinite.
    """
    path = Path(path)
    with _opened(path) as archive:
        views = _views(archive, path, layout)
        return assemble(views, device=device, layout=layout, progress=progress)


@contextmanager
def open_parts(
    path: PathLike, *, device: Device, layout: Layout
) -> Iterator[tuple[StoredLightField, str]]:
    """What `read` reads, view by view while the archive is open.

    Parameters
    ----------
    path : path-like
    device : Device
        Not used.
    layout : Layout

    Yields
    ------
    StoredLightField, str

    Raises
    ------
    FormatError, ValueError
        As `read` and `stored_views`.
    """
    path = Path(path)
    with _opened(path) as archive:
        yield stored_views(_views(archive, path, layout), layout=layout)


def _opened(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except UNREADABLE as error:
        raise FormatError(f"{path} is no zip archive that can be read ({error}).") from error


def _views(archive: zipfile.ZipFile, path: Path, layout: Layout) -> ViewSet:
    members = _members(archive, path)
    size = path.stat().st_size
    shown = views_only(members, pattern=layout.pattern)
    pictures = [name for name in shown if name.lower().endswith(SUFFIXES)]
    inside = posixpath.commonpath([posixpath.dirname(name) for name in pictures] or [""])
    root = f"{inside}/" if inside else ""
    cut = len(root)
    names = [name[cut:] for name in shown if name.startswith(root)]
    found = arranged(names, [name[cut:] for name in pictures], layout, str(path))

    def load(name: str) -> np.ndarray[Any, Any]:
        info, where = members[posixpath.join(inside, name)], path / inside / name
        content = _content(archive, info, where, size, layout.max_bytes)
        picture = decode_picture(content, where, max_bytes=layout.max_bytes)
        return without_alpha(picture, where)

    return ViewSet(path / inside, *found, load)


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
) -> bytes:
    """The bytes of a member, never more than it declares; ``size`` is that of the archive."""
    if info.flag_bits & _ENCRYPTED:
        raise FormatError(f"The picture {where} is encrypted: make an archive without a password.")
    if info.compress_type not in _RATIO:
        raise FormatError(
            f"The picture {where} is compressed by method {info.compress_type}: write the archive "
            "with deflate."
        )
    require_bytes(
        info.file_size,
        path=where,
        what="the picture",
        stored=min(info.compress_size, size),
        ratio=_RATIO[info.compress_type],
        max_bytes=max_bytes,
    )
    try:
        with archive.open(info) as member:
            content = member.read(info.file_size + 1)
    except UNREADABLE as error:
        raise FormatError(f"The picture {where} cannot be read ({error}).") from error
    if len(content) != info.file_size:
        raise FormatError(f"The picture {where} has another size than its archive declares.")
    return content
