"""Tables of numbers as CSV files, identified by the column names in their header.

The header is a line of quoted names, the cells are plain numbers: every CSV reader supports it, and
no cell can be a spreadsheet formula.
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
_MAX_BYTES = 1 << 31  # of a table that is read, against exhausting the memory


def check_unit(unit: str) -> None:
    """Raise ValueError unless a unit of positions is "m" or "voxel"."""
    if unit not in UNITS:
        raise ValueError(f'unit must be "m" or "voxel", got {unit!r}.')


def write_table(path: PathLike, columns: dict[str, Vector]) -> None:
    """Write columns of numbers to a CSV file atomically."""
    if Path(path).suffix.lower() != _SUFFIX:
        raise ValueError(f"The path of a table must end in .csv, got {path}.")
    texts = [_texts(np.asarray(values)) for values in columns.values()]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        file.write(",".join(f'"{name}"' for name in columns) + "\r\n")
        csv.writer(file).writerows(zip(*texts, strict=True))


def _texts(values: Vector) -> list[str]:
    if values.dtype.kind in "iu":
        return [str(value) for value in values.tolist()]
    return ["" if math.isnan(value) else f"{value:.9g}" for value in values.tolist()]


def read_table(path: PathLike, kind: str, names: Sequence[str]) -> dict[str, Vector]:
    """Read the named columns of numbers; ignore other columns."""
    return _columns(Path(path), kind, _rows(Path(path), kind), names)


def read_positions(
    path: PathLike, kind: str = "positions", names: Callable[[str], Sequence[str]] = lambda _: ()
) -> tuple[Vector, str, dict[str, Vector]]:
    """Read positions (z, y, x), their unit, and the columns ``names(unit)``."""
    path = Path(path)
    rows = _rows(path, kind)
    unit = next((u for u in UNITS if rows and f"z_{u}" in rows[0]), None)
    if unit is None:
        raise FormatError(
            f"{path} is not a table of positions: its header has no column "
            f"{' or '.join(f'z_{u}' for u in UNITS)}."
        )
    axes = position_columns(unit)
    table = _columns(path, kind, rows, (*axes, *names(unit)))
    positions = np.stack([table.pop(name) for name in axes], axis=1)
    if not np.isfinite(positions).all():
        raise FormatError(f"{path}: a point has no position.")
    return positions, unit, table


def _rows(path: Path, kind: str) -> list[list[str]]:
    """Read the cells of a table, with the header first."""
    if not path.is_file():
        raise FormatError(f"There is no table of {kind} {path}.")
    if path.stat().st_size > _MAX_BYTES:
        raise FormatError(f"{path} has more than {_MAX_BYTES:,} bytes: not a table of {kind}.")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(
            f"{path} is not a table of {kind}: it is not CSV text ({error})."
        ) from error
    return [[name.strip() for name in row] for row in rows[:1]] + rows[1:]


def _columns(
    path: Path, kind: str, rows: list[list[str]], names: Sequence[str]
) -> dict[str, Vector]:
    """Convert the named columns to numbers."""
    header = rows[0] if rows else []
    missing = [name for name in names if name not in header]
    if missing:
        raise FormatError(
            f"{path} is not a table of {kind}: it has no column {missing[0]!r}, its columns are "
            f"{', '.join(map(repr, header[:8])) or 'none'}."
        )
    indices = [header.index(name) for name in names]
    cells = [
        [_number(path, number, row, index, header) for index in indices]
        for number, row in enumerate(rows[1:], 2)
    ]
    table = np.array(cells, np.float64).reshape(-1, len(names))
    return {name: table[:, k].copy() for k, name in enumerate(names)}


def _number(path: Path, line: int, row: list[str], column: int, header: list[str]) -> float:
    if len(row) != len(header):
        raise FormatError(
            f"{path}, line {line} has {len(row)} cells, the header {len(header)}: it is damaged."
        )
    text = row[column].strip()
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise FormatError(
            f"{path}, line {line}: {text[:40]!r} in the column {header[column]!r} is not a number."
        ) from None


def whole_numbers(path: PathLike, values: Vector, name: str) -> Vector:
    """Convert a column of non-negative integers to int64; raise FormatError for other numbers."""
    bad = ~(np.isfinite(values) & (values >= 0) & (values == np.floor(values)) & (values < 2**53))
    if bad.any():
        raise FormatError(
            f"{path}: the column {name!r} must contain integers from 0 on, got {values[bad][0]:g}."
        )
    return values.astype(np.int64)


def position_columns(unit: str) -> tuple[str, str, str]:
    """Return the names of the columns of z, y and x in a unit, "m" or "voxel"."""
    return (f"z_{unit}", f"y_{unit}", f"x_{unit}")
