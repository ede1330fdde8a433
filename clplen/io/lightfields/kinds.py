"""The kinds of light-field file: how each is recognised and which module reads it.

The module of a kind has ``read(path, *, device, layout, progress) -> (LightField, str)``; the text
says in one sentence what was taken for what. Where parts can be read alone (``parts``), it has
``open_parts(path, *, device, layout)`` too, a context of (StoredLightField, str).
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from clplen.errors import FormatError
from clplen.io.formats.picture import SUFFIXES

_HEAD = 64  # bytes that recognition looks at
_VIEWS = ("flip_v", "flip_u", "swap_uv", "positions", "max_bytes")
_NAMES = (*_VIEWS, "pattern", "views", "order", "allow_missing", "srgb")
_RAW = ("white", "dark", "grid", "views", "step", "lattice", "bayer", "demosaic", "devignette")


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes
    ----------
    name : str
        As messages call it.
    module : str
    words : tuple of str
        Words of layout that apply.
    recognises : callable
        (path, first bytes) -> bool; the bytes are empty for a folder.
    parts : bool
        Whether the samples of some rows and columns can be read alone.
    """

    name: str
    module: str
    words: tuple[str, ...]
    recognises: Callable[[Path, bytes], bool]
    parts: bool = False


def _is_zarr(path: Path, head: bytes) -> bool:
    marks = (".zgroup", ".zarray", "zarr.json")
    if path.is_dir():
        return any((path / mark).is_file() for mark in marks)
    if head[:4] != b"PK\3\4":
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return any(mark in archive.NameToInfo for mark in marks)
    except (OSError, ValueError, RuntimeError, zipfile.BadZipFile):
        return False  # an archive of views says what is wrong with it


def _is_described(path: Path, head: bytes) -> bool:
    return path.suffix.lower() in (".json", ".raw") or head.lstrip()[:1] == b"{"


KINDS = (
    Kind(
        "Zarr",
        "clplen.io.lightfields.zarr_lightfields",
        (*_VIEWS, "order", "dataset"),
        _is_zarr,
        parts=True,
    ),
    Kind(
        "a folder of views",
        "clplen.io.lightfields.view_folders",
        _NAMES,
        lambda path, _: path.is_dir(),
        parts=True,
    ),
    Kind(
        "an archive of views",
        "clplen.io.lightfields.view_archives",
        _NAMES,
        lambda _, head: head[:4] == b"PK\3\4",
        parts=True,
    ),
    Kind(
        "HDF5",
        "clplen.io.lightfields.hdf5_lightfields",
        (*_VIEWS, "order", "dataset"),
        lambda path, head: head[:8] == b"\x89HDF\r\n\x1a\n" or _hdf5_after_user_block(path),
        parts=True,
    ),
    Kind(
        "a MATLAB file",
        "clplen.io.lightfields.matlab",
        (*_VIEWS, "order", "dataset"),
        lambda path, head: head[:6] == b"MATLAB" and path.suffix.lower() == ".mat",
    ),
    Kind(
        "a NumPy array",
        "clplen.io.lightfields.array_files",
        (*_VIEWS, "order", "srgb"),
        lambda _, head: head[:6] == b"\x93NUMPY",
        parts=True,
    ),
    Kind(
        "a Lytro container",
        "clplen.io.lightfields.lytro",
        (*_VIEWS, *_RAW),
        lambda _, head: head[:8] == b"\x89LFP\r\n\x1a\n",
    ),
    Kind(
        "a raw image described by JSON",
        "clplen.io.lightfields.lytro",
        (*_VIEWS, *_RAW),
        _is_described,
    ),
    Kind(
        "a Raytrix calibration",
        "clplen.io.raw.raytrix",
        (),
        lambda path, head: path.suffix.lower() in (".xml", ".ray") or b"<RayCalibData" in head,
    ),
    Kind(
        "a picture",
        "clplen.io.lightfields.mosaic",
        (*_VIEWS, *_RAW, "order", "srgb"),
        lambda path, _: path.suffix.lower() in SUFFIXES,
    ),
)


def _hdf5_after_user_block(path: Path) -> bool:
    """MATLAB 7.3 puts 512 bytes before the HDF5 signature."""
    if path.is_dir():
        return False
    with path.open("rb") as file:
        file.seek(512)
        return file.read(8) == b"\x89HDF\r\n\x1a\n"


def _beginning(head: bytes) -> str:
    """The first bytes of a file in words."""
    if not head:
        return "it is a folder"
    text = head.decode("ascii", errors="replace")
    if all(character.isprintable() or character.isspace() for character in text) and head.isascii():
        start = " ".join(text.split())[:24]
        return f"it is text: {start!r}" if start else "it is text"
    return f"it begins with the bytes {head[:8].hex(' ')}"


def kind_of(path: Path) -> Kind:
    """What a file or folder is.

    Parameters
    ----------
    path : pathlib.Path

    Returns
    -------
    Kind

    Raises
    ------
    FormatError
        If there is none, or it is of no kind that is known.
    """
    if not path.exists():
        raise FormatError(f"There is no file or folder {path}.")
    if not path.is_file() and not path.is_dir():
        raise FormatError(f"{path} is neither a file nor a folder.")
    head = b""
    if path.is_file():
        with path.open("rb") as file:
            head = file.read(_HEAD)
        if not head:
            raise FormatError(f"{path} is empty.")
    if head and path.suffix.lower() == ".npz":
        raise FormatError(
            f"{path} is an archive of NumPy arrays (.npz), which clplen does not read: save the "
            "light field alone as .npy with numpy.save."
        )
    for kind in KINDS:
        if kind.recognises(path, head):
            return kind
    raise FormatError(
        f"{path} is no light field that clplen reads ({_beginning(head)}): "
        f"give {', '.join(kind.name for kind in KINDS[:-1])} or {KINDS[-1].name}."
    )
