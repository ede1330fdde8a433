"""Settings of reading a light field."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clplen.files import PathLike
from clplen.settings.declaration import INPUT, Settings, setting
from clplen.units import bytes_of

BAYER = ("RGGB", "BGGR", "GRBG", "GBRG")
Mosaic = tuple[tuple[str, ...], ...]  # colours of the pixels of a tile, row by row


def bayer_of(value: Any) -> str | Mosaic:
    """Return the name of a Bayer mosaic in capitals, or the tile of another mosaic."""
    if isinstance(value, tuple):
        return value
    if isinstance(value, str) and value.upper() in BAYER:
        return value.upper()
    raise ValueError(f"must be {', '.join(map(repr, BAYER[:-1]))} or {BAYER[-1]!r}")


def size_of(value: Any) -> int:
    """Return a size of memory in bytes, at least 1."""
    if (size := bytes_of(value)) < 1:
        raise ValueError('must be 1 byte or more, such as "512MiB"')
    return size


@dataclass(frozen=True)
class ReadingSettings(Settings):
    """Settings of `clplen.read_lightfield`, which documents them."""

    pattern: str | None = setting(
        None,
        "Names of the views in a folder: {v} and {u} row and column, or {i} row by row; {n} a "
        "counter to ignore; * anything.",
        kind=str, group=INPUT, default_text="guessed", example="view_{v}_{u}.png", metavar="NAMES",
    )  # fmt: skip
    views: tuple[int, int] | None = setting(
        None, "Number of rows and columns of views in the names.",
        kind=int, minimum=1, pair=True, group=INPUT, default_text="detected", example=[9, 9],
        metavar="V U",
    )  # fmt: skip
    swap_uv: bool = setting(False, "The names count columns before rows.", kind=bool, group=INPUT)
    flip_v: bool = setting(False, "Reverse the rows of views.", kind=bool, group=INPUT)
    flip_u: bool = setting(False, "Reverse the columns of views.", kind=bool, group=INPUT)
    allow_missing: bool = setting(
        False, "Give missing views the weight 0 instead of an error.", kind=bool, group=INPUT
    )
    order: str | None = setting(
        None,
        "Axes of an array (uvyxc); of a mosaic yvxu (lenslet images) or vyux (views side by side); "
        "lawnmower for names that count every other row backwards.",
        kind=str, group=INPUT, default_text="detected", example="vuyx", metavar="AXES",
    )  # fmt: skip
    dataset: str | None = setting(
        None, "Name of the array in a file that holds several (HDF5, Zarr, .mat).",
        kind=str, group=INPUT, default_text="detected", example="LF", metavar="NAME",
    )  # fmt: skip
    positions: PathLike | None = setting(
        None,
        "Positions of the views on the aperture, in view steps: a table v,u,y,x, or 'names' for "
        "file names of the Stanford archive.",
        kind=Path, group=INPUT, default_text="a regular grid", example="names",
        metavar="CSV|names",
    )  # fmt: skip
    srgb: bool = setting(False, "Decode sRGB to linear light.", kind=bool, group=INPUT)
    white: PathLike | None = setting(
        None, "White image of a raw lenslet image.",
        kind=Path, group=INPUT, default_text="none", example="white.png", metavar="FILE",
    )  # fmt: skip
    dark: PathLike | None = setting(
        None, "Dark frame of a raw lenslet image.",
        kind=Path, group=INPUT, default_text="none", example="dark.png", metavar="FILE",
    )  # fmt: skip
    calibration: PathLike | None = setting(
        None, "White images of a Lytro camera: folder or tar archive.",
        kind=Path, group=INPUT, default_text="$CLPLEN_LYTRO, or the last one used for this camera",
        example="caldata.tar", metavar="FILE",
    )  # fmt: skip
    grid: PathLike | None = setting(
        None, "Lenslet lattice: JSON of clplen or a Raytrix XML.",
        kind=Path, group=INPUT, default_text="detected", example="lattice.json", metavar="FILE",
    )  # fmt: skip
    trust_lattice: bool = setting(
        False, "Accept a detected lattice although it is uncertain.", kind=bool, group=INPUT
    )
    intrinsics: PathLike | None = setting(
        None, "Camera model of 'clplen calibrate', which removes the distortion of the views.",
        kind=Path, group=INPUT, default_text="none", example="camera.json", metavar="FILE",
    )  # fmt: skip
    step: float | None = setting(
        None, "Step between views, in pixels of the raw image.",
        above=0, group=INPUT, default_text="pitch over number of views", example=1.0,
    )  # fmt: skip
    lattice: str | None = setting(
        None, "Lattice of the lenslets.", kind=str, choices=("square", "hexagonal"), group=INPUT,
        default_text="detected", example="square",
    )  # fmt: skip
    bayer: str | Mosaic | None = setting(
        None, "Colour filters of a raw image.", kind=str, choices=BAYER, check=bayer_of,
        group=INPUT, default_text="none", example="RGGB",
    )  # fmt: skip
    demosaic: str | None = setting(
        None, "Interpolate colours within lenslets, or after or before slicing into views.",
        kind=str, choices=("within", "after", "before"), group=INPUT, default_text="within",
        example="within",
    )  # fmt: skip
    devignette: bool | None = setting(
        None, "Divide a raw image by its white image.",
        kind=bool, group=INPUT, default_text="if there is a white image", example=True,
    )  # fmt: skip
    max_bytes: int | None = setting(
        None, "Largest allocation that a file may request.",
        check=size_of, group=INPUT, default_text="half of the free memory", example="2 GiB",
        metavar="SIZE",
    )  # fmt: skip
    force: bool = setting(
        False, "Accept a white image whose lattice is uncertain.", kind=bool, group=INPUT
    )
