"""Files in and out: folders of views, HDF5, focal stacks, depth maps and pictures."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike, check_folder, check_writable, output_folder
from clplen.io.hdf5 import SIGNATURE, read_hdf5, write_hdf5
from clplen.io.pfm import read_pfm, write_pfm
from clplen.io.picture import read_picture, write_picture
from clplen.io.stack import write_depth, write_stack
from clplen.io.views import Layout, find_views, read_views, write_views
from clplen.lightfield.lightfield import LightField

__all__ = [
    "check_folder",
    "check_writable",
    "files_of",
    "output_folder",
    "read_lightfield",
    "read_pfm",
    "read_picture",
    "write_depth",
    "write_lightfield",
    "write_pfm",
    "write_picture",
    "write_stack",
]

logger = logging.getLogger(__name__)


def read_lightfield(
    path: PathLike,
    *,
    device: Device | None = None,
    pattern: str | None = None,
    views: tuple[int, int] | None = None,
    flip_v: bool = False,
    flip_u: bool = False,
    swap_uv: bool = False,
    order: str | None = None,
    white: PathLike | None = None,
    dark: PathLike | None = None,
    grid: PathLike | None = None,
    allow_missing: bool = False,
    progress: bool = False,
) -> LightField:
    """Read a light field: a folder of views, or the HDF5 file of `write_lightfield`.

    What was taken for what is logged at level INFO by the logger ``clplen.io``.

    Parameters
    ----------
    path : path-like
        A folder with one picture a view, or a file.
    device : Device, optional
        Default ``Device.open()``.
    pattern : str, optional
        Names of the views in a folder: ``{v}`` and ``{u}`` row and column of the view, or ``{i}``
        row by row; ``{n}`` a counter that is ignored; ``*`` anything. The numbers are ranked, so
        neither the first nor the step matters. None guesses.
    views : tuple of int, optional
        (V, U), rows and columns as the names count them.
    flip_v, flip_u, swap_uv : bool
        How the names' view axes become ours: swapped first, then the resulting axes reversed.
    order, white, dark, grid : optional
        Layout of other kinds of file; neither a folder nor our HDF5 takes them.
    allow_missing : bool
        Whether views may be missing; they get weight 0.
    progress : bool
        Whether to show a bar on standard error.

    Returns
    -------
    LightField
        uint8, uint16 or float32 as in the file (other types become float32).

    Raises
    ------
    FormatError
        If the file or folder is missing, damaged, incomplete or of an unknown kind.
    ValueError, ShapeError
        If a word of layout does not apply to this kind of file, or a value in it (a sample that is
        NaN, a spacing of 0) makes no light field.
    """
    path = Path(path)
    foreign = {"order": order, "white": white, "dark": dark, "grid": grid}
    layout = Layout(pattern, views, flip_v, flip_u, swap_uv, allow_missing)
    if path.is_dir():
        _refuse(foreign, "a folder of views")
        device = device or Device.open()
        lf, took = read_views(path, device=device, layout=layout, progress=progress)
    elif not path.is_file():
        raise FormatError(f"There is no file or folder {path}.")
    elif _starts_with(path, SIGNATURE):
        _refuse(foreign | vars(layout), "an HDF5 light field")
        lf, took = read_hdf5(path, device=device or Device.open())
    else:
        raise FormatError(
            f"{path} is no light field that clplen reads: give a folder with one picture a view, "
            "or an HDF5 file with a dataset 'lightfield'."
        )
    logger.info("read %s", took)
    return lf


def files_of(path: PathLike, **layout: Any) -> list[Path]:
    """The files that `read_lightfield` would read.

    Parameters
    ----------
    path : path-like
    **layout
        ``pattern`` and ``views`` as for `read_lightfield`, and its other words of layout.

    Returns
    -------
    list of pathlib.Path

    Raises
    ------
    FormatError
        If the names in a folder do not show which file is which view.
    """
    path = Path(path)
    if not path.is_dir():
        return [path]
    return [path / name for name in find_views(path, Layout(**layout))[2].values()]


def _refuse(words: dict[str, Any], kind: str) -> None:
    """Refuse words of layout that were given but do not apply."""
    given = [f"{name}=" for name, value in words.items() if value not in (None, False)]
    if given:
        raise ValueError(f"{', '.join(given)} does not apply to {kind}.")


def _starts_with(path: Path, signature: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(signature)) == signature


def write_lightfield(path: PathLike, lf: LightField) -> None:
    """Write a light field so that `read_lightfield` gives it back.

    Parameters
    ----------
    path : path-like
        ``.h5`` or ``.hdf5`` keeps everything; a name without suffix becomes a new folder of
        pictures, which keeps the samples only.
    lf : LightField

    Raises
    ------
    ValueError
        If the suffix is another one.
    OSError
        If it cannot be written, or the folder holds something already.
    """
    suffix = Path(path).suffix.lower()
    if suffix in (".h5", ".hdf5"):
        write_hdf5(path, lf)
    elif suffix == "" or Path(path).is_dir():
        write_views(path, lf)
    else:
        raise ValueError(
            f"A light field is written to .h5 or to a new folder, not to {Path(path).name}."
        )
