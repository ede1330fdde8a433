"""Tables of numbers as CSV, of which clplen knows its own again by the spelling of the header.

The header is a line of quoted names, the cells are plain numbers: every reader of CSV takes it, and
no cell can be a formula of a spreadsheet.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike, replacing

Vector = np.ndarray[Any, Any]

UNITS = ("m", "voxel")
_SUFFIX = ".csv"
_LARGEST = 1 << 31  # bytes of a table that is read


def check_unit(unit: str) -> None:
    """Refuse a unit of positions that is neither metres nor voxels."""
    if unit not in UNITS:
        raise ValueError(f'unit must be "m" or "voxel", got {unit!r}.')


def write_table(path: PathLike, columns: dict[str, Vector]) -> None:
    """Write columns of numbers, whole or not at all."""
    if Path(path).suffix.lower() != _SUFFIX:
        raise ValueError(f"A table is written as .csv, not as {path}.")
    texts = [_texts(np.asarray(values)) for values in columns.values()]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        file.write(",".join(f'"{name}"' for name in columns) + "\r\n")
        csv.writer(file).writerows(zip(*texts, strict=True))


def _texts(values: Vector) -> list[str]:
    if values.dtype.kind in "iu":
        return [str(value) for value in values.tolist()]
    return ["" if math.isnan(value) else f"{value:.9g}" for value in values.tolist()]


def read_table(path: PathLike, what: str, names: Sequence[str]) -> dict[str, Vector]:
    """Read columns of numbers by their names; others are left out."""
    return _columns(Path(path), what, _rows(Path(path), what), names)


def read_positions(
    path: PathLike, what: str = "positions", names: Callable[[str], Sequence[str]] = lambda _: ()
) -> tuple[Vector, str, dict[str, Vector]]:
    """Read positions (z, y, x), their unit, and the columns that ``names`` has for that unit."""
    path = Path(path)
    rows = _rows(path, what)
    unit = next((one for one in UNITS if rows and f"z_{one}" in rows[0]), None)
    if unit is None:
        raise FormatError(
            f"{path} is no table of positions: its header has no column "
            f"{' or '.join(f'z_{one}' for one in UNITS)}."
        )
    places = position_columns(unit)
    table = _columns(path, what, rows, (*places, *names(unit)))
    positions = np.stack([table.pop(name) for name in places], axis=1)
    if not np.isfinite(positions).all():
        raise FormatError(f"{path}: a point has no position.")
    return positions, unit, table


def _rows(path: Path, what: str) -> list[list[str]]:
    """Cells of a table, the header first."""
    if not path.is_file():
        raise FormatError(f"There is no table of {what} {path}.")
    if path.stat().st_size > _LARGEST:
        raise FormatError(f"{path} has more than {_LARGEST:,} bytes: no table of {what}.")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(f"{path} is no table of {what}: it is no CSV text ({error}).") from error
    return [[name.strip() for name in row] for row in rows[:1]] + rows[1:]


def _columns(
    path: Path, what: str, rows: list[list[str]], names: Sequence[str]
) -> dict[str, Vector]:
    """Numbers of some columns."""
    header = rows[0] if rows else []
    missing = [name for name in names if name not in header]
    if missing:
        raise FormatError(
            f"{path} is no table of {what}: it has no column {missing[0]!r}, its columns are "
            f"{', '.join(map(repr, header[:8])) or 'none'}."
        )
    places = [header.index(name) for name in names]
    cells = [
        [_number(path, number, row, place, header) for place in places]
        for number, row in enumerate(rows[1:], 2)
    ]
    table = np.array(cells, np.float64).reshape(-1, len(names))
    return {name: table[:, k].copy() for k, name in enumerate(names)}


def _number(path: Path, line: int, row: list[str], place: int, header: list[str]) -> float:
    if len(row) != len(header):
        raise FormatError(
            f"{path}, line {line} has {len(row)} cells, the header {len(header)}: it is damaged."
        )
    text = row[place].strip()
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise FormatError(
            f"{path}, line {line}: {text[:40]!r} in the column {header[place]!r} is no number."
        ) from None


def whole_numbers(path: PathLike, values: Vector, name: str) -> Vector:
    """A column of numbers from 0 on without fractions, as int64."""
    bad = ~(np.isfinite(values) & (values >= 0) & (values == np.floor(values)) & (values < 2**53))
    if bad.any():
        raise FormatError(
            f"{path}: {values[bad][0]:g} in the column {name!r} is no whole number from 0 on."
        )
    return values.astype(np.int64)


def position_columns(unit: str) -> tuple[str, str, str]:
    """Names of the columns of z, y and x in a unit, "m" or "voxel"."""
    return (f"z_{unit}", f"y_{unit}", f"x_{unit}")
