"""Wavefront maps as Zemax OpticStudio lists them as text ("Listing of Wavefront Map Data").

A head of lines, in any order, then one line for each row of numbers, in waves:

    0.7500 um at 0.7500 (deg)               wavelength, field
    Exit Pupil Diameter: 1.0610E+03 Millimeters
    Pupil grid size: 512 by 512             columns by rows
    Center point is: Col 257, Row 256       of the chief ray, from 1

The first row is the largest y. An even grid of N has N - 2 steps from rim to rim about its centre,
an odd one N - 1. The OPD is the chief ray's path less the ray's, so that it is ahead where it is
positive. Samples without light are 0, and so is the chief ray's. Files are UTF-16 or UTF-8.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats.untrusted import Bound

Values = np.ndarray[Any, np.dtype[np.float64]]
_NUMBER = r"([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)"
_WAVELENGTH = re.compile(_NUMBER + r"\s*(?:\u00b5|\u03bc|u|\ufffd)m\s+at\s+(.*)")
_GRID = re.compile(r"Pupil grid size:?\s*(\d{1,6})\s+by\s+(\d{1,6})", re.IGNORECASE)
_CENTRE = re.compile(r"Center point is:?\s*Col\s+(\d{1,6}),\s*Row\s+(\d{1,6})", re.IGNORECASE)
_DIAMETER = re.compile(r"Exit Pupil Diameter:?\s*" + _NUMBER + r"\s*(\w+)", re.IGNORECASE)
_UNITS = {"millimeters": 1e-3, "centimeters": 1e-2, "meters": 1.0, "inches": 0.0254}
_HEAD = 1 << 16  # bytes that hold the lines before the numbers
_LONGEST = 64  # bytes of a number: 14 letters of UTF-16, and as many more
_LEAST = 5  # samples along an axis


@dataclass(frozen=True)
class ZemaxMap:
    """One wavefront map."""

    # W in metres, positive where it retards, shape (n_v, n_u) from rim to rim, y upwards in the
    # prescription from the first row on; NaN where no light passed.
    path: Values
    wavelength: float  # in metres
    field: str  # the field as the listing has it, as "0.0000, 14.0000 (deg)"
    pupil_diameter: float | None  # of the exit pupil in metres


def read_zemax_map(path: PathLike, *, max_bytes: int | None = None) -> ZemaxMap:
    """Read a listing of a wavefront map."""
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    size = path.stat().st_size
    Bound(path, size, 12, max_bytes).require(12 * size, "its text")
    with path.open("rb") as file:
        head = _decoded(file.read(_HEAD))
    colour, grid = _WAVELENGTH.search(head), _GRID.search(head)
    if grid is None or colour is None:
        what = "'Pupil grid size: ... by ...'" if grid is None else "'... um at ...'"
        raise FormatError(
            f"{path} is no listing of a wavefront map: it has no line {what}. In OpticStudio save "
            "the text of the analysis Wavefront Map."
        )
    columns, rows = (int(n) for n in grid.groups())
    if size > _HEAD + _LONGEST * columns * rows:
        raise FormatError(
            f"{path} has {size:,} bytes, far more than its {columns} by {rows} numbers need: it is "
            "damaged."
        )
    text = _decoded(path.read_bytes())
    centre = _CENTRE.search(text)
    column, row = (int(n) for n in centre.groups()) if centre else (columns // 2 + 1, rows // 2)
    if centre is None and rows % 2:
        row = rows // 2 + 1
    waves = _numbers(text, (rows, columns), path)
    half = [n // 2 - 1 if n % 2 == 0 else n // 2 for n in (rows, columns)]
    fits = all(
        at - reach >= 1 and at + reach <= n and 2 * reach + 1 >= _LEAST
        for at, reach, n in zip((row, column), half, (rows, columns), strict=True)
    )
    if not fits:
        raise FormatError(
            f"{path}: the grid of {columns} by {rows} with its centre at column {column}, row "
            f"{row} does not reach from rim to rim."
        )
    down, right = (
        slice(at - 1 - reach, at + reach) for at, reach in zip((row, column), half, strict=True)
    )
    wavelength = float(colour[1]) * 1e-6
    lit = _lit(waves)[down, right]
    diameter = _DIAMETER.search(text)
    unit = _UNITS.get(diameter[2].lower()) if diameter else None
    return ZemaxMap(
        np.where(lit, -waves[down, right] * wavelength, np.nan)[::-1],
        wavelength,
        colour[2].strip().rstrip("."),
        float(diameter[1]) * unit if diameter and unit else None,
    )


def _decoded(data: bytes) -> str:
    """Text by its byte order mark, by its zeros, or UTF-8."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    if data[1:200:2].count(0) > 40:
        return data.decode("utf-16-le", "replace")
    return data.decode("utf-8-sig", "replace")


def _numbers(text: str, shape: tuple[int, int], path: Path) -> Values:
    """The rows of numbers at the end."""
    rows = []
    for line in text.splitlines():
        words = line.split()
        if len(words) == shape[1]:
            try:
                rows.append([float(word) for word in words])
            except ValueError:
                continue
    found = np.array(rows, np.float64)
    if found.shape != shape or not np.isfinite(found).all():
        raise FormatError(
            f"{path} is truncated or damaged: it declares {shape[1]} by {shape[0]} samples, and "
            f"holds {len(rows)} rows of {shape[1]} numbers."
        )
    return found


def _lit(waves: Values) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Where light passed: all but zeros, unless they lie alone among others, as the chief ray's."""
    lit = waves != 0
    padded = np.pad(lit, 1)
    beside = sum(
        padded[1 + i : 1 + i + lit.shape[0], 1 + k : 1 + k + lit.shape[1]].astype(int)
        for i, k in ((-1, 0), (1, 0), (0, -1), (0, 1))
    )
    return np.asarray(lit | (beside == 4))
