"""Light fields from files of any kind: read, opened part by part, listed and written."""

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
    LYTRO_DESCRIBED,
    MATLAB,
    MATLAB_SUFFIXES,
    RAYTRIX,
    RAYTRIX_SUFFIXES,
    ZIP,
)
from clplen.io.lightfields import view_folders
from clplen.io.lightfields.layout import (
    ARRAY_WORDS,
    NAME_WORDS,
    RAW_WORDS,
    VIEW_WORDS,
    Kind,
    Layout,
    LightFieldSource,
    Whole,
)
from clplen.io.lightfields.view_positions import NAMES
from clplen.io.store import hdf5_files, zarr_files
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField, as_lightfield

logger = logging.getLogger("clplen.io")

Opened = AbstractContextManager[LightFieldSource]
_HEAD = 64  # bytes that recognition looks at
_USER_BLOCK = 512  # bytes that MATLAB 7.3 puts before the signature of HDF5
_LYTRO_WORDS = (*VIEW_WORDS, *RAW_WORDS, "calibration")


def _is_hdf5(path: Path, head: bytes) -> bool:
    if head.startswith(hdf5_files.MAGIC) or path.is_dir():
        return bool(head)
    with path.open("rb") as file:
        file.seek(_USER_BLOCK)
        return file.read(len(hdf5_files.MAGIC)) == hdf5_files.MAGIC


def _is_described(path: Path, head: bytes) -> bool:
    return path.suffix.lower() in LYTRO_DESCRIBED or head.lstrip()[:1] == b"{"


def _is_raytrix(path: Path, head: bytes) -> bool:
    return path.suffix.lower() in RAYTRIX_SUFFIXES or RAYTRIX in head


# What opens files of a kind; its module is imported when it is needed.


def _open_zarr(path: Path, **words: Any) -> Opened:
    from clplen.io.lightfields.container_lightfields import open_zarr

    return open_zarr(path, **words)


def _open_hdf5(path: Path, **words: Any) -> Opened:
    from clplen.io.lightfields.container_lightfields import open_hdf5

    return open_hdf5(path, **words)


def _open_matlab(path: Path, **words: Any) -> Opened:
    from clplen.io.lightfields.array_files import open_matlab

    return open_matlab(path, **words)


def _open_npy(path: Path, **words: Any) -> Opened:
    from clplen.io.lightfields.array_files import open_npy

    return open_npy(path, **words)


def _open_lytro(path: Path, **words: Any) -> Opened:
    from clplen.io.lightfields.lytro_files import read_lytro

    return nullcontext(Whole(partial(read_lytro, path, **words)))


def _open_mosaic(path: Path, **words: Any) -> Opened:
    from clplen.io.lightfields.mosaic import read_mosaic

    return nullcontext(Whole(partial(read_mosaic, path, **words)))


def _refuse_raytrix(path: Path, **_: Any) -> Opened:
    from clplen.io.raw.raytrix import read_raytrix

    read_raytrix(path)
    raise FormatError(
        f"{path} is the calibration of a focused (plenoptic 2.0) raw image, whose views are "
        "rendered, not sliced: clplen.io.read_raw(path) gives the raw image with its lenses."
    )


KINDS = {
    "zarr": Kind("Zarr", ARRAY_WORDS, _open_zarr, marks=zarr_files.MARKS),
    "folder": Kind("a folder of views", NAME_WORDS, view_folders.open_folder, folder=True),
    "archive": Kind("an archive of views", NAME_WORDS, view_folders.open_archive, magic=ZIP),
    "hdf5": Kind("HDF5", ARRAY_WORDS, _open_hdf5, recognises=_is_hdf5),
    "matlab": Kind(
        "a MATLAB file", ARRAY_WORDS, _open_matlab, magic=MATLAB, suffixes=MATLAB_SUFFIXES
    ),
    "numpy": Kind("a NumPy array", (*VIEW_WORDS, "order", "srgb"), _open_npy, magic=npy.MAGIC),
    "lytro": Kind("a Lytro container", _LYTRO_WORDS, _open_lytro, magic=LYTRO),
    "described": Kind(
        "a raw image described by JSON", _LYTRO_WORDS, _open_lytro, recognises=_is_described
    ),
    "raytrix": Kind("a Raytrix calibration", (), _refuse_raytrix, recognises=_is_raytrix),
    "picture": Kind(
        "a picture",
        (*VIEW_WORDS, *RAW_WORDS, "order", "srgb"),
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
    """Read a light field from files of any kind, told by their content.

    What was taken for what is logged at level INFO by the logger ``clplen.io``. A word of layout
    that does not apply to a kind of file is refused.

    Parameters
    ----------
    path : path-like
        A folder or zip archive with one picture a view, a mosaic, a raw lenslet image, HDF5, Zarr,
        MATLAB, NumPy or a Lytro container.
    device : Device or str, optional
        Default ``Device.open()``.
    pattern : str, optional
        Names of the views in a folder: ``{v}`` and ``{u}`` row and column of the view, or ``{i}``
        row by row; ``{n}`` a counter that is ignored; ``*`` anything. The numbers are ranked, so
        neither the first nor the step matters. None guesses.
    views : tuple of int, optional
        (V, U), rows and columns as the names count them; of a mosaic; of a raw image, the pixels
        that are taken from each lenslet (default: its pitch, rounded).
    flip_v, flip_u, swap_uv : bool
        How the file's view axes become ours: swapped first, then the resulting axes reversed.
    order : str, optional
        Axes of an array, such as "uvyxc"; of a mosaic "yvxu" (lenslet images) or "vyux" (views
        side by side); "lawnmower" for names that count every other row backwards.
    white, dark : path-like, optional
        White image and dark frame of a raw image.
    grid : path-like, optional
        Lenslet lattice of a raw image: JSON of `clplen.lightfield.calibration`, or Raytrix XML.
    calibration : path-like, optional
        Folder or tar archive with the white images of a Lytro camera, of which the right one is
        chosen; default ``$CLPLEN_LYTRO``, or what was last used for the same camera.
    allow_missing : bool
        Whether views may be missing; they get weight 0.
    positions : path-like, optional
        Where the views lie on the aperture, in view steps, in place of their row and column: a CSV
        with the columns v, u, y, x, or "names" for file names of the Stanford archive.
    srgb : bool
        Whether to decode sRGB to linear light from 0 to 1 (float32).
    step : float, optional
        Pixels a view of a raw image (default: pitch over the number of views).
    lattice : {"square", "hexagonal"}, optional
        Of the lenslets of a raw image; None finds out.
    bayer : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
        Colour filters of a raw image.
    demosaic : {"within", "after", "before"}, optional
        Whether colours are fitted to the pixels under each lenslet (the default), or interpolated
        after slicing, which mixes no directions, or before.
    devignette : bool, optional
        Whether a raw image is divided by its white image, where there is one (default).
    dataset : str, optional
        Which array of a file that holds several.
    max_bytes : int, optional
        Largest allocation that a file may ask for; default half of the free memory.
    trust_lattice : bool
        Whether to take a lattice that was measured and is not to be trusted, of a raw image
        without a white image too, with a `SamplingWarning`.
    intrinsics : path-like, optional
        Of the camera, as `write_intrinsics` writes them: the views are rectified
        (`clplen.lightfield.rectify_views`).
    force : bool
        Whether to go on, with a `SamplingWarning`, where the lattice of the white image is not to
        be trusted, or the raw image shows another one.
    progress : bool
        Whether to show a bar on standard error.

    Returns
    -------
    LightField
        Samples of uint8, uint16, float16 or float32 as in the file (other types become float32).

    Raises
    ------
    FormatError, ValueError, ShapeError
        If the file or folder is missing, damaged, incomplete or of an unknown kind; if a value in
        an array file (a sample that is NaN, a spacing of 0) makes no light field; if a word of
        layout does not apply to this kind of file, or a value in pictures makes no light field.

    Examples
    --------
    >>> np.save("views.npy", np.ones((5, 7, 32, 48), np.uint8))
    >>> clplen.read_lightfield("views.npy")
    <LightField (5, 7, 32, 48) uint8, ...>
    >>> clplen.read_lightfield("views.npy", order="uvyx").shape
    (7, 5, 32, 48)
    """
    words = locals()
    layout = Layout(**{field.name: words[field.name] for field in fields(Layout)})
    with _opened(Path(path), device, layout) as source:
        lf, took = source.load(progress=progress)
    logger.info("read %s", took)
    return lf


@contextmanager
def _opened(path: Path, device: DeviceLike | None, layout: Layout) -> Iterator[LightFieldSource]:
    """Open a file of any kind: the one set of checks of paths and words of layout."""
    kind = kind_of(path)
    intrinsics, layout = layout.intrinsics, replace(layout, intrinsics=None)
    camera = None
    if intrinsics is not None:  # read before anything else is
        from clplen.io.formats.intrinsics_files import read_intrinsics

        camera = read_intrinsics(intrinsics)
    layout.require(kind.words, kind.name)
    with kind.open(path, device=as_device(device), layout=layout) as source:
        if camera is None:
            yield source
            return

        def rectified(progress: bool) -> tuple[LightField, str]:
            from clplen.lightfield.metric.rectification import rectify_views

            lf, took = source.load(progress=progress)
            return rectify_views(lf, camera), took

        yield Whole(rectified)


@contextmanager
def open_lightfield(
    path: PathLike, *, device: DeviceLike | None = None, **layout: Any
) -> Iterator[StoredLightField]:
    """Open a light field of any kind without reading it all, to be read in tiles.

    Arrays (HDF5, Zarr, NumPy, MATLAB 7.3), folders and archives of views are read part by part
    while the file is open. What is one raw picture, MATLAB up to 7.2, and what is rectified by
    ``intrinsics`` is read as a whole.

    Parameters
    ----------
    path : path-like
        A file or folder, as for `read_lightfield`.
    device : Device or str, optional
        Default ``Device.open()``; what is read as a whole lies there.
    **layout
        Words of layout as for `read_lightfield`; ``max_bytes`` bounds what is unpacked at once.

    Yields
    ------
    StoredLightField
        Valid inside the ``with`` block.

    Raises
    ------
    FormatError, ValueError, ShapeError
        As `read_lightfield`; samples that are damaged or NaN are found when they are read.

    Examples
    --------
    >>> np.save("views.npy", np.ones((5, 5, 32, 48), np.uint8))
    >>> with clplen.open_lightfield("views.npy") as stored:
    ...     stored.shape, stored.read(np.s_[2:3, 0:5, 0:16, 0:48]).shape
    ((5, 5, 32, 48), (1, 5, 16, 48))
    """
    with _opened(Path(path), device, _layout_of(layout, "open_lightfield")) as source:
        stored, took = source.stored()
        logger.info("opened %s", took)
        yield stored


def _layout_of(layout: dict[str, Any], what: str) -> Layout:
    """The words of layout that a function was given by ``**``."""
    check_keywords(layout, [one.name for one in fields(Layout)], what)
    return Layout(**layout)


def files_of(path: PathLike, **layout: Any) -> list[Path]:
    """Return the files that `read_lightfield` would read, and those that words of layout name."""
    path = Path(path)
    words = _layout_of(layout, "files_of")
    named = (words.white, words.dark, words.grid, words.calibration, words.positions)
    given = [file for file in (*named, words.intrinsics) if file is not None]
    beside = [Path(file) for file in given if str(file) != NAMES]
    if not path.is_dir() or kind_of(path) is not KINDS["folder"]:
        return [path, *beside]
    return [*(path / name for name in view_folders.find_views(path, words)[2].values()), *beside]


def write_lightfield(path: PathLike, lf: LightField | ArrayLike) -> None:
    """Write a light field so that `read_lightfield` gives it back.

    Parameters
    ----------
    path : path-like
        ``.h5``, ``.hdf5`` and ``.zarr`` (a new folder) keep everything; a name without suffix
        becomes a new folder of pictures, which keeps the samples only.
    lf : LightField or array_like
        Shape (v, u, y, x[, c]).

    Raises
    ------
    ValueError, FormatError, OSError
        If the suffix is another one; if it is ``.zarr`` and the package zarr is not installed; if
        it cannot be written, or the folder holds something already.

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
            "A light field is written to .h5, to .zarr or to a new folder, not to "
            f"{Path(path).name}."
        )


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
    """What a file or folder is."""
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
    for kind in KINDS.values():
        if kind.fits(path, head):
            return kind
    *names, last = (kind.name for kind in KINDS.values())
    raise FormatError(
        f"{path} is no light field that clplen reads ({_beginning(head)}): "
        f"give {', '.join(names)} or {last}."
    )
