"""Wavefront maps in text listings of Zemax OpticStudio ("Listing of Wavefront Map Data").

Header lines in any order are followed by a line for each row of numbers, in waves:

    0.7500 um at 0.7500 (deg)               wavelength, field
    Exit Pupil Diameter: 1.0610E+03 Millimeters
    Pupil grid size: 512 by 512             columns by rows
    Center point is: Col 257, Row 256       of the chief ray, from 1

The first row has the largest y. An even grid of N has N - 2 steps from rim to rim about its centre,
an odd grid N - 1. The OPD is the chief ray's path minus the ray's path: positive values are ahead.
Samples without light are 0, and so is the chief ray's sample. Files are UTF-16 or UTF-8.
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
_HEADER_BYTES = 1 << 16  # with the lines before the numbers
_MAX_NUMBER_BYTES = 64  # more than twice 14 characters of UTF-16
_MIN_SAMPLES = 5  # along an axis


@dataclass(frozen=True)
class ZemaxMap:
    """Wavefront map of a field and wavelength."""

    # OPD W in metres, positive for retardation, shape (n_v, n_u) from rim to rim, rows in the
    # order of increasing y; NaN without light.
    path: Values
    wavelength: float  # in metres
    field: str  # field in the listing, such as "0.0000, 14.0000 (deg)"
    pupil_diameter: float | None  # of the exit pupil in metres


def read_zemax_map(path: PathLike, *, max_bytes: int | None = None) -> ZemaxMap:
    """Read the text listing of a wavefront map."""
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    size = path.stat().st_size
    Bound(path, size, 12, max_bytes).require(12 * size, "its text")
    with path.open("rb") as file:
        head = _decoded(file.read(_HEADER_BYTES))
    colour, grid = _WAVELENGTH.search(head), _GRID.search(head)
    if grid is None or colour is None:
        what = "'Pupil grid size: ... by ...'" if grid is None else "'... um at ...'"
        raise FormatError(
            f"{path} is not a listing of a wavefront map: it has no line {what}. In OpticStudio, "
            "save the text of the analysis Wavefront Map."
        )
    columns, rows = (int(n) for n in grid.groups())
    if size > _HEADER_BYTES + _MAX_NUMBER_BYTES * columns * rows:
        raise FormatError(
            f"{path} has {size:,} bytes, far more than its {columns} by {rows} numbers need: the "
            "file is damaged."
        )
    text = _decoded(path.read_bytes())
    centre = _CENTRE.search(text)
    column, row = (int(n) for n in centre.groups()) if centre else (columns // 2 + 1, rows // 2)
    if centre is None and rows % 2:
        row = rows // 2 + 1
    waves = _numbers(text, (rows, columns), path)
    half = [n // 2 - 1 if n % 2 == 0 else n // 2 for n in (rows, columns)]
    fits = all(
        at - reach >= 1 and at + reach <= n and 2 * reach + 1 >= _MIN_SAMPLES
        for at, reach, n in zip((row, column), half, (rows, columns), strict=True)
    )
    if not fits:
        raise FormatError(
            f"{path}: the grid must extend from rim to rim, got {columns} by {rows} samples with "
            f"the centre at column {column}, row {row}."
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
    """Decode text by its byte order mark, by its zero bytes, or as UTF-8."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    if data[1:200:2].count(0) > 40:
        return data.decode("utf-16-le", "replace")
    return data.decode("utf-8-sig", "replace")


def _numbers(text: str, shape: tuple[int, int], path: Path) -> Values:
    """Return the rows of numbers at the end of a listing."""
    rows = []
    for line in text.splitlines():
        items = line.split()
        if len(items) == shape[1]:
            try:
                rows.append([float(item) for item in items])
            except ValueError:
                continue
    values = np.array(rows, np.float64)
    if values.shape != shape or not np.isfinite(values).all():
        raise FormatError(
            f"{path} is truncated or damaged: it declares {shape[1]} by {shape[0]} samples, but "
            f"has {len(rows)} rows of {shape[1]} numbers."
        )
    return values


def _lit(waves: Values) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return the samples with light: nonzero ones, and isolated zeros such as the chief ray's."""
    lit = waves != 0
    padded = np.pad(lit, 1)
    neighbours = sum(
        padded[1 + i : 1 + i + lit.shape[0], 1 + k : 1 + k + lit.shape[1]].astype(int)
        for i, k in ((-1, 0), (1, 0), (0, -1), (0, 1))
    )
    return np.asarray(lit | (neighbours == 4))
