"""Read, open, list and write light-field files of any kind."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from clplen.checks import check_keywords
from clplen.compute.device import DeviceLike, as_device
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats import npy, picture
from clplen.io.formats.untrusted import (
    LYTRO,
    LYTRO_SUFFIXES,
    MATLAB,
    MATLAB_SUFFIXES,
    RAYTRIX,
    RAYTRIX_SUFFIXES,
    ZIP,
)
from clplen.io.lightfields import view_folders
from clplen.io.lightfields.layout import (
    ARRAY_OPTIONS,
    NAME_OPTIONS,
    RAW_OPTIONS,
    VIEW_OPTIONS,
    Kind,
    Layout,
    LightFieldSource,
    UndividedSource,
)
from clplen.io.lightfields.view_positions import NAMES
from clplen.io.store import hdf5_files, zarr_files
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField, as_lightfield

logger = logging.getLogger("clplen.io")

Opened = AbstractContextManager[LightFieldSource]
_HEADER_BYTES = 64  # used to detect the kind of a file
_USER_BLOCK = 512  # bytes of MATLAB 7.3 before the signature of HDF5
_LYTRO_OPTIONS = (*VIEW_OPTIONS, *RAW_OPTIONS, "calibration")


def _is_hdf5(path: Path, head: bytes) -> bool:
    if head.startswith(hdf5_files.MAGIC) or path.is_dir():
        return bool(head)
    with path.open("rb") as file:
        file.seek(_USER_BLOCK)
        return file.read(len(hdf5_files.MAGIC)) == hdf5_files.MAGIC


def _is_lytro_json(path: Path, head: bytes) -> bool:
    return path.suffix.lower() in LYTRO_SUFFIXES or head.lstrip()[:1] == b"{"


def _is_raytrix(path: Path, head: bytes) -> bool:
    return path.suffix.lower() in RAYTRIX_SUFFIXES or RAYTRIX in head


# Functions that open a kind of files and import its module on demand.


def _open_zarr(path: Path, **options: Any) -> Opened:
    from clplen.io.lightfields.container_lightfields import open_zarr

    return open_zarr(path, **options)


def _open_hdf5(path: Path, **options: Any) -> Opened:
    from clplen.io.lightfields.container_lightfields import open_hdf5

    return open_hdf5(path, **options)


def _open_matlab(path: Path, **options: Any) -> Opened:
    from clplen.io.lightfields.array_files import open_matlab

    return open_matlab(path, **options)


def _open_npy(path: Path, **options: Any) -> Opened:
    from clplen.io.lightfields.array_files import open_npy

    return open_npy(path, **options)


def _open_lytro(path: Path, **options: Any) -> Opened:
    from clplen.io.lightfields.lytro_files import read_lytro

    return nullcontext(UndividedSource(partial(read_lytro, path, **options)))


def _open_mosaic(path: Path, **options: Any) -> Opened:
    from clplen.io.lightfields.mosaic import read_mosaic

    return nullcontext(UndividedSource(partial(read_mosaic, path, **options)))


def _refuse_raytrix(path: Path, **_: Any) -> Opened:
    from clplen.io.raw.raytrix import read_raytrix

    read_raytrix(path)
    raise FormatError(
        f"{path} is the calibration of a focused (plenoptic 2.0) raw image, which cannot be sliced "
        "into views: read it with clplen.io.read_raw(path) and render it."
    )


KINDS = {
    "zarr": Kind("Zarr", ARRAY_OPTIONS, _open_zarr, marks=zarr_files.MARKS),
    "folder": Kind("a folder of views", NAME_OPTIONS, view_folders.open_folder, folder=True),
    "archive": Kind("an archive of views", NAME_OPTIONS, view_folders.open_archive, magic=ZIP),
    "hdf5": Kind("HDF5", ARRAY_OPTIONS, _open_hdf5, recognises=_is_hdf5),
    "matlab": Kind(
        "a MATLAB file", ARRAY_OPTIONS, _open_matlab, magic=MATLAB, suffixes=MATLAB_SUFFIXES
    ),
    "numpy": Kind("a NumPy array", (*VIEW_OPTIONS, "order", "srgb"), _open_npy, magic=npy.MAGIC),
    "lytro": Kind("a Lytro container", _LYTRO_OPTIONS, _open_lytro, magic=LYTRO),
    "described": Kind(
        "a raw image described by JSON", _LYTRO_OPTIONS, _open_lytro, recognises=_is_lytro_json
    ),
    "raytrix": Kind("a Raytrix calibration", (), _refuse_raytrix, recognises=_is_raytrix),
    "picture": Kind(
        "a picture",
        (*VIEW_OPTIONS, *RAW_OPTIONS, "order", "srgb"),
        _open_mosaic,
        suffixes=picture.SUFFIXES,
    ),
}


def read_lightfield(
    path: PathLike,
    *,
    device: DeviceLike | None = None,
    pattern: str | None = None,
    views: tuple[int, int] | None = None,
    flip_v: bool = False,
    flip_u: bool = False,
    swap_uv: bool = False,
    order: str | None = None,
    white: PathLike | None = None,
    dark: PathLike | None = None,
    grid: PathLike | None = None,
    calibration: PathLike | None = None,
    allow_missing: bool = False,
    positions: PathLike | None = None,
    srgb: bool = False,
    step: float | None = None,
    lattice: str | None = None,
    bayer: str | None = None,
    demosaic: str | None = None,
    devignette: bool | None = None,
    dataset: str | None = None,
    max_bytes: int | None = None,
    trust_lattice: bool = False,
    intrinsics: PathLike | None = None,
    force: bool = False,
    progress: bool = False,
) -> LightField:
    """Read a light field from files of any kind, detected by their content.

    The logger ``clplen.io`` reports at level INFO how the file was interpreted. Layout options that
    do not apply to the kind of file raise an error.

    Parameters
    ----------
    path : path-like
        Folder or zip archive with a picture per view, mosaic, raw lenslet image, HDF5, Zarr,
        MATLAB, NumPy or Lytro container.
    device : Device or str, optional
        Compute device; default ``Device.open()``.
    pattern : str, optional
        Names of the views in a folder: ``{v}`` and ``{u}`` for row and column of the view, or
        ``{i}`` row by row; ``{n}`` for an ignored counter; ``*`` for any text. The numbers are
        ranked, so neither the first nor the step matters. None guesses the pattern.
    views : tuple of int, optional
        Number of views (V, U), in rows and columns as the names count them; number of views of a
        mosaic; pixels used under each lenslet of a raw image (default: pitch, rounded).
    flip_v, flip_u, swap_uv : bool
        Flags that change the view axes: True to swap the axes, then to reverse the resulting axes.
    order : str, optional
        Axes of an array, such as "uvyxc"; of a mosaic "yvxu" (lenslet images) or "vyux" (views side
        by side); "lawnmower" for names that count every other row backwards.
    white, dark : path-like, optional
        White image and dark frame of a raw image.
    grid : path-like, optional
        Lenslet lattice of a raw image: JSON of `clplen.lightfield.calibration`, or Raytrix XML.
    calibration : path-like, optional
        Folder or tar archive with the white images of a Lytro camera, from which the matching one
        is chosen; default ``$CLPLEN_LYTRO``, or the last calibration of this camera.
    allow_missing : bool
        True to allow missing views, which get weight 0.
    positions : path-like, optional
        Positions of the views in the aperture, in view steps: a CSV file with the columns v, u, y,
        x, or "names" for file names of the Stanford archive. Default: row and column.
    srgb : bool
        True to decode sRGB to linear light from 0 to 1 (float32).
    step : float, optional
        Pixels per view step of a raw image (default: pitch over the number of views).
    lattice : {"square", "hexagonal"}, optional
        Lattice type of the lenslets of a raw image; None detects it.
    bayer : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
        Colour filters of a raw image.
    demosaic : {"within", "after", "before"}, optional
        Colour interpolation: "within" fits colours to the pixels under each lenslet (default),
        "after" interpolates after slicing without mixing directions, "before" interpolates the raw
        image.
    devignette : bool, optional
        True to divide a raw image by its white image, if given (default).
    dataset : str, optional
        Name of an array in a file with several arrays.
    max_bytes : int, optional
        Largest allocation that a file may cause; default half of the free memory.
    trust_lattice : bool
        True to use a measured but unreliable lattice, also without a white image, with a
        `SamplingWarning`.
    intrinsics : path-like, optional
        Intrinsics of the camera, a file of `write_intrinsics`; the views are rectified
        (`clplen.lightfield.rectify_views`).
    force : bool
        True to continue with a `SamplingWarning` if the lattice of the white image is unreliable or
        differs from that of the raw image.
    progress : bool
        True to show a progress bar on standard error.

    Returns
    -------
    LightField
        Samples of uint8, uint16, float16 or float32 as stored (other types become float32).

    Raises
    ------
    FormatError, ValueError, ShapeError
        If the file or folder is missing, damaged, incomplete or of an unknown kind; if a value is
        invalid (such as a NaN sample or a spacing of 0); if a layout option does not apply to this
        kind of file.

    Examples
    --------
    >>> np.save("views.npy", np.ones((5, 7, 32, 48), np.uint8))
    >>> clplen.read_lightfield("views.npy")
    <LightField (5, 7, 32, 48) uint8, ...>
    >>> clplen.read_lightfield("views.npy", order="uvyx").shape
    (7, 5, 32, 48)
    """
    arguments = locals()
    layout = Layout(**{field.name: arguments[field.name] for field in fields(Layout)})
    with _open_source(Path(path), device, layout) as source:
        lf, summary = source.load(progress=progress)
    logger.info("read %s", summary)
    return lf


@contextmanager
def _open_source(
    path: Path, device: DeviceLike | None, layout: Layout
) -> Iterator[LightFieldSource]:
    """Open a file of any kind after all checks of paths and layout options."""
    kind = kind_of(path)
    intrinsics, layout = layout.intrinsics, replace(layout, intrinsics=None)
    camera = None
    if intrinsics is not None:  # read first
        from clplen.io.formats.intrinsics_files import read_intrinsics

        camera = read_intrinsics(intrinsics)
    layout.require(kind.options, kind.name)
    with kind.open(path, device=as_device(device), layout=layout) as source:
        if camera is None:
            yield source
            return

        def read_rectified(progress: bool) -> tuple[LightField, str]:
            from clplen.lightfield.metric.rectification import rectify_views

            lf, summary = source.load(progress=progress)
            return rectify_views(lf, camera), summary

        yield UndividedSource(read_rectified)


@contextmanager
def open_lightfield(
    path: PathLike, *, device: DeviceLike | None = None, **layout: Any
) -> Iterator[StoredLightField]:
    """Open a light field of any kind, to be read in tiles.

    Arrays (HDF5, Zarr, NumPy, MATLAB 7.3), folders and archives of views are read in parts while
    the file is open. Raw pictures, MATLAB up to 7.2, and light fields rectified by ``intrinsics``
    are read at once.

    Parameters
    ----------
    path : path-like
        File or folder, as for `read_lightfield`.
    device : Device or str, optional
        Compute device for data read at once; default ``Device.open()``.
    **layout
        Layout options as for `read_lightfield`; ``max_bytes`` limits a single decoded part.

    Yields
    ------
    StoredLightField
        Light field, valid inside the ``with`` block.

    Raises
    ------
    FormatError, ValueError, ShapeError
        Errors of `read_lightfield`; damaged or NaN samples raise an error when they are read.

    Examples
    --------
    >>> np.save("views.npy", np.ones((5, 5, 32, 48), np.uint8))
    >>> with clplen.open_lightfield("views.npy") as stored:
    ...     stored.shape, stored.read(np.s_[2:3, 0:5, 0:16, 0:48]).shape
    ((5, 5, 32, 48), (1, 5, 16, 48))
    """
    with _open_source(Path(path), device, _layout_of(layout, "open_lightfield")) as source:
        stored, summary = source.stored()
        logger.info("opened %s", summary)
        yield stored


def _layout_of(layout: dict[str, Any], what: str) -> Layout:
    """Return the layout options passed by ``**``."""
    check_keywords(layout, [field.name for field in fields(Layout)], what)
    return Layout(**layout)


def files_of(path: PathLike, **layout: Any) -> list[Path]:
    """Return the files that `read_lightfield` would read, including those in layout options."""
    path = Path(path)
    options = _layout_of(layout, "files_of")
    candidates = (options.white, options.dark, options.grid, options.calibration, options.positions)
    option_files = [file for file in (*candidates, options.intrinsics) if file is not None]
    companions = [Path(file) for file in option_files if str(file) != NAMES]
    if not path.is_dir() or kind_of(path) is not KINDS["folder"]:
        return [path, *companions]
    return [
        *(path / name for name in view_folders.find_views(path, options)[2].values()),
        *companions,
    ]


def write_lightfield(path: PathLike, lf: LightField | ArrayLike) -> None:
    """Write a light field for `read_lightfield`.

    Parameters
    ----------
    path : path-like
        ``.h5``, ``.hdf5`` or ``.zarr`` (a new folder) for all properties; a name without suffix for
        a new folder of pictures with the samples only.
    lf : LightField or array_like
        Light field of shape (v, u, y, x[, c]).

    Raises
    ------
    ValueError, FormatError, OSError
        If the suffix is unknown; if ``.zarr`` is given without the package zarr; if the file cannot
        be written, or the folder is not empty.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.ones((5, 5, 32, 48), np.float32))
    >>> clplen.write_lightfield("views.h5", lf)
    >>> clplen.read_lightfield("views.h5")
    <LightField (5, 5, 32, 48) float32, ...>
    """
    lf = as_lightfield(lf)
    suffix = Path(path).suffix.lower()
    if suffix in (*hdf5_files.SUFFIXES, zarr_files.SUFFIX):
        from clplen.io.lightfields.container_lightfields import write_container

        write_container(path, lf)
    elif suffix == "" or Path(path).is_dir():
        view_folders.write_views(path, lf)
    else:
        raise ValueError(
            "path must end in .h5 or .zarr, or be a new folder, for a light field, got "
            f"{Path(path).name}."
        )


def _beginning(head: bytes) -> str:
    """Describe the first bytes of a file."""
    if not head:
        return "it is a folder"
    text = head.decode("ascii", errors="replace")
    if all(character.isprintable() or character.isspace() for character in text) and head.isascii():
        start = " ".join(text.split())[:24]
        return f"it is text: {start!r}" if start else "it is text"
    return f"it begins with the bytes {head[:8].hex(' ')}"


def kind_of(path: Path) -> Kind:
    """Return the kind of a file or folder."""
    if not path.exists():
        raise FormatError(f"There is no file or folder {path}.")
    if not path.is_file() and not path.is_dir():
        raise FormatError(f"{path} must be a file or a folder.")
    head = b""
    if path.is_file():
        with path.open("rb") as file:
            head = file.read(_HEADER_BYTES)
        if not head:
            raise FormatError(f"{path} is empty.")
    if head and path.suffix.lower() == ".npz":
        raise FormatError(
            f"{path} is an archive of NumPy arrays (.npz), an unsupported format: save the light "
            "field as .npy with numpy.save."
        )
    for kind in KINDS.values():
        if kind.fits(path, head):
            return kind
    *names, last = (kind.name for kind in KINDS.values())
    raise FormatError(
        f"{path} is not a supported light field ({_beginning(head)}): give {', '.join(names)} or "
        f"{last}."
    )
