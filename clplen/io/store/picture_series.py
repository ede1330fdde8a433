"""Series of linear pictures in OME-TIFF or OME-Zarr, by the suffix, with what is said of them."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import check_finite, float64_array
from clplen.errors import FormatError
from clplen.files import PathLike, require_file
from clplen.io.formats import tiff
from clplen.io.formats.tiff import decode_tiff_stack
from clplen.io.formats.untrusted import require_bytes
from clplen.io.store import zarr_files
from clplen.io.store.ome_tiff import CHANNELS, write_ome
from clplen.io.store.ome_zarr import write_omezarr
from clplen.io.store.picture_blocks import Array, Block
from clplen.io.store.zarr_files import opened_store, storage

_INSTEAD = "write .tif"
_MICROMETRES = ("µm", "micrometer")


def is_series(path: PathLike) -> bool:
    """Whether a name is one of OME-TIFF or OME-Zarr, by its suffix."""
    return Path(path).suffix.lower() in (*tiff.SUFFIXES, zarr_files.SUFFIX)


def is_ome(path: PathLike) -> bool:
    """Whether a name is one of OME-Zarr, or of an OME-TIFF that says so (``.ome.tif``)."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    tiffs = ([".ome", suffix] for suffix in tiff.SUFFIXES)
    return suffixes[-1:] == [zarr_files.SUFFIX] or suffixes[-2:] in tiffs


def write_series(path: PathLike, blocks: Iterable[Block], *, replace: bool, **known: Any) -> None:
    """Write OME-TIFF or OME-Zarr, by the suffix."""
    spacing = float64_array(known.get("spacing") or ())
    check_finite(spacing=spacing[~np.isnan(spacing)])
    if Path(path).suffix.lower() == zarr_files.SUFFIX:
        write_omezarr(path, blocks, replace=replace, **known)
    else:
        write_ome(path, blocks, **known)


@dataclass(frozen=True)
class PictureSeries:
    """Pictures that a file holds, and what it says of them.

    Attributes
    ----------
    values : numpy.ndarray
        As stored, shape (n, y, x) or (n, y, x, c).
    about : dict
        The description that `write_series` was given; empty for files of other programs.
    pixel : tuple of float or None
        (dy, dx) in metres, where the file says them.
    axes : str
        A letter for each axis that an OME-Zarr names, in its own order; else empty.
    """

    values: Array
    about: dict[str, Any]
    pixel: tuple[float, float] | None = None
    axes: str = ""


def read_series(
    path: PathLike, *, what: str, kinds: str = ".tif and .zarr", max_bytes: int | None = None
) -> PictureSeries:
    """Read all pictures of an OME-TIFF, an OME-Zarr, or a TIFF whose pages are alike."""
    path = Path(path)
    noun, axes = what.partition(" ")[2], ""
    require_file(path, noun, folder=True)
    try:
        if path.suffix.lower() == zarr_files.SUFFIX:
            values, axes = _zarr_pictures(path, what, max_bytes)
        elif path.suffix.lower() in tiff.SUFFIXES:
            size = path.stat().st_size
            require_bytes(
                size, path=path, what=f"the {noun}", stored=size, ratio=1, max_bytes=max_bytes
            )
            with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as content:
                values = decode_tiff_stack(content, path, max_bytes=max_bytes)
        else:
            raise ValueError(f"{noun}s are {kinds}")
    except FormatError:
        raise
    except Exception as error:  # what parsers raise on damaged files
        raise FormatError(f"{path} is no {noun} that can be read ({str(error)[:200]}).") from error
    about = describe_series(path)
    if values.ndim == 3 and not axes and about.get(CHANNELS) == 1:
        values = values[..., None]
    if values.ndim not in (3, 4) or values.dtype.kind not in "uif" or values.size == 0:
        raise FormatError(f"{path} holds {values.dtype} of shape {values.shape}, no {noun}.")
    return PictureSeries(values, about, _pixel(path), axes)


def _zarr_pictures(path: Path, what: str, max_bytes: int | None) -> tuple[Array, str]:
    """The full size of an OME-Zarr as (n, y, x) or (n, y, x, c), and the letters of its axes."""
    with opened_store(path, _INSTEAD, max_bytes) as group:
        level = group["0"]
        stored, ratio = storage(level, path, what, max_bytes)
        nbytes = math.prod(level.shape) * np.dtype(level.dtype).itemsize
        require_bytes(nbytes, path=path, what=what, stored=stored, ratio=ratio, max_bytes=max_bytes)
        values, axes = np.asarray(level[...]), _axes_in(group)
    if values.ndim == 2:
        values = values[None]
    if values.ndim == 4 and axes.startswith("c"):
        values = np.moveaxis(values, 0, -1)
    return values, axes


def _axes_in(group: Any) -> str:
    """A letter for each axis of an OME-Zarr; empty where it names none."""
    try:
        names = [str(axis["name"]) for axis in group.attrs["multiscales"][0]["axes"]]
    except (KeyError, IndexError, TypeError):
        return ""
    return "".join(name[:1] for name in names)


def describe_series(path: PathLike) -> dict[str, Any]:
    """What `write_series` was given as description; empty if there is no such file."""
    path = Path(path)
    try:
        if path.suffix.lower() == zarr_files.SUFFIX:
            with opened_store(path, _INSTEAD) as group:
                about = group.attrs["clplen"] if "0" in group else {}
        else:
            root = _ome(path)
            about = json.loads(next(item.text or "" for item in root.iter() if _is_text(item)))
    except Exception:  # what other programs wrote, or nothing
        return {}
    return dict(about) if isinstance(about, dict) else {}


def _ome(path: Path) -> ET.Element:
    """The OME description of a TIFF."""
    with tiff.open_tiff(path) as file:
        text = file.pages.first.description or "<OME/>"
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # could claim any amount of memory
        raise ValueError("a description with entities")
    return ET.fromstring(text)


def _is_text(element: ET.Element) -> bool:
    return element.tag.endswith("Description")


def _pixel(path: Path) -> tuple[float, float] | None:
    """The size of a pixel in metres, where a file says it in micrometres."""
    try:
        if path.suffix.lower() == zarr_files.SUFFIX:
            with opened_store(path, _INSTEAD) as group:
                scales = multiscales(group)
                units = [axis.get("unit") for axis in scales["axes"][-2:]]
                (moves, *_) = (data["coordinateTransformations"] for data in scales["datasets"])
                sizes = moves[0]["scale"][-2:]
        else:
            (pixels, *_) = (item for item in _ome(path).iter() if item.tag.endswith("Pixels"))
            units = [pixels.get(f"PhysicalSize{axis}Unit") for axis in "YX"]
            sizes = [pixels.attrib[f"PhysicalSize{axis}"] for axis in "YX"]
        dy, dx = (1e-6 * float(size) for size in sizes)
    except Exception:  # what other programs wrote, or nothing
        return None
    known = all(unit in _MICROMETRES for unit in units) and 0 < min(dy, dx) < math.inf
    return (dy, dx) if known else None


def times_in(path: PathLike) -> int:
    """How many times the pictures of an OME-TIFF are of, one after the other; 1 if unknown."""
    try:
        pixels = next(item for item in _ome(Path(path)).iter() if item.tag.endswith("Pixels"))
        return max(1, int(pixels.get("SizeT", "1")))
    except Exception:  # what other programs wrote, or nothing
        return 1


def plane_step(path: PathLike) -> tuple[float, float] | None:
    """z of plane 0 and the distance of planes in metres, where a file says them in micrometres."""
    path = Path(path)
    try:
        if path.suffix.lower() == zarr_files.SUFFIX:
            with opened_store(path, _INSTEAD) as group:
                scales = multiscales(group)
                names = [str(axis["name"]) for axis in scales["axes"]]
                unit = scales["axes"][names.index("z")].get("unit")
                moves = scales["datasets"][0]["coordinateTransformations"]
                step = next(move["scale"] for move in moves if "scale" in move)[names.index("z")]
                shifts = [move["translation"] for move in moves if "translation" in move]
                first = float(shifts[0][names.index("z")]) if shifts else 0.0
        else:
            pixels = next(item for item in _ome(path).iter() if item.tag.endswith("Pixels"))
            unit, step = pixels.get("PhysicalSizeZUnit", "µm"), pixels.attrib["PhysicalSizeZ"]
            first = 0.0
        found = (1e-6 * first, 1e-6 * float(step))
    except Exception:  # what other programs wrote, or nothing
        return None
    known = unit in _MICROMETRES and 0 < found[1] < math.inf and math.isfinite(found[0])
    return found if known else None


def pixel_of(path: PathLike) -> tuple[float, float] | None:
    """The size (dy, dx) of a pixel in metres, where a file says it in micrometres."""
    return _pixel(Path(path))


def multiscales(group: Any) -> dict[str, Any]:
    """The first description of an OME-Zarr's pyramid, of OME-NGFF 0.4 or 0.5."""
    attributes = dict(group.attrs)
    return dict(attributes.get("ome", attributes)["multiscales"][0])
