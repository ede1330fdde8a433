"""Positions of the views of a light field, from a table or from file names."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from clplen.checks import fits_float64
from clplen.errors import FormatError, argument
from clplen.files import PathLike
from clplen.io.formats.untrusted import listed
from clplen.io.lightfields.layout import Layout, View

Positions = np.ndarray[Any, np.dtype[np.float64]]

NAMES = "names"
_COLUMNS = ("v", "u", "y", "x")
_MAX_LINE_BYTES = 1000  # average over the table
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def positions_of(
    layout: Layout, views: View, *, names: Mapping[View, str] | None = None
) -> Positions | None:
    """Return the positions of a layout in the view order of the final light field."""
    if layout.positions is None:
        return None
    positions = layout.oriented(read_positions(layout.positions, views, names=names))
    if str(layout.positions) == NAMES:
        if layout.swap_uv:
            positions = positions[..., ::-1]
        positions = positions * [-1 if flip else 1 for flip in (layout.flip_v, layout.flip_u)]
    return np.ascontiguousarray(positions)


def read_positions(
    source: PathLike, views: View, *, names: Mapping[View, str] | None = None
) -> Positions:
    """Return the positions of the views in view steps."""
    if str(source) == NAMES:
        positions = _from_names(views, names or {})
    else:
        positions = _from_table(Path(source), views)
    return np.asarray(positions - positions.mean(axis=(0, 1)))


def _from_table(path: Path, views: View) -> Positions:
    positions = np.full((*views, 2), np.nan)
    lines: dict[View, int] = {}
    for line, row in _rows(path, views):
        v, u, y, x = (_number(path, line, name, row[name]) for name in _COLUMNS)
        if not (v in range(views[0]) and u in range(views[1])):
            raise FormatError(
                f"{path}, line {line}: v and u must be indices from 0 of {views[0]} x {views[1]} "
                f"views (V x U), got v={v:g}, u={u:g}."
            )
        view = (int(v), int(u))
        if view in lines:
            raise FormatError(
                f"{path}, line {line}: the view v={view[0]}, u={view[1]} already occurs in line "
                f"{lines[view]}: list each view once."
            )
        lines[view] = line
        positions[view] = y, x
    missing = [f"(v={v}, u={u})" for v, u in np.ndindex(*views) if (v, u) not in lines]
    if missing:
        raise FormatError(
            f"{path} has no positions for {len(missing)} of {views[0]} x {views[1]} views (V x U): "
            f"{listed(missing)}."
        )
    return positions


def _rows(path: Path, views: View) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield (line, text by column) of a table."""
    if not path.is_file():
        raise FormatError(
            f"There is no table of positions {path}: give a CSV file, or "
            f"{argument('positions', NAMES)}."
        )
    if path.stat().st_size > _MAX_LINE_BYTES * (math.prod(views) + 1):
        raise FormatError(f"{path} is too large for the positions of {math.prod(views)} views.")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            header = [name.strip().lower() for name in next(reader, [])]
            if sorted(header) != sorted(_COLUMNS):
                raise FormatError(
                    f"{path}, line 1: the header must be v,u,y,x, got {','.join(header)[:80]!r}."
                )
            for row in reader:
                if len(row) not in (0, len(header)):
                    raise FormatError(
                        f"{path}, line {reader.line_num}: a row must have the columns "
                        f"{','.join(header)}, got {len(row)}."
                    )
                if row:
                    yield reader.line_num, dict(zip(header, row, strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(f"{path} is not a comma-separated table ({error}).") from error


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not fits_float64(value):
        raise FormatError(
            f"{path}, line {line}: {name} must be a number, got {text.strip()[:40]!r}."
        )
    return value


def _from_names(views: View, names: Mapping[View, str]) -> Positions:
    """Return y and x of file names in view steps, scaled by the steps of rows and columns."""
    if not names:
        raise FormatError(
            f"{argument('positions', NAMES)} needs views in named files: give a table v,u,y,x."
        )
    grid = np.array(sorted(names), np.float64)
    coordinates = np.array([_camera(names[view]) for view in sorted(names)])
    fits = [_line(grid[:, axis], coordinates[:, axis], "vu"[axis]) for axis in (0, 1)]
    step = abs(fits[1][1] if views[1] > 1 else fits[0][1]) or 1.0
    positions = np.empty((*views, 2))
    rows, columns = grid.astype(int).T
    for axis, (start, slope) in enumerate(fits):
        size = math.copysign(step, slope)
        positions[..., axis] = slope / size * np.indices(views)[axis]
        positions[rows, columns, axis] = (coordinates[:, axis] - start) / size
    return positions


def _camera(name: str) -> tuple[float, float]:
    numbers = _NUMBER.findall(PurePosixPath(name).stem)
    if len(numbers) < 4:
        raise FormatError(
            f"The name {name} has {len(numbers)} numbers; {argument('positions', NAMES)} needs "
            "row, column, y and x, as in out_00_01_-381.9_1103.4_.png."
        )
    return float(numbers[-2]), float(numbers[-1])


def _line(index: Positions, value: Positions, axis: str) -> tuple[float, float]:
    """Return (value at 0, step) by least squares; a single row or column has step 0."""
    centred = index - index.mean()
    if not centred.any():
        return float(value.mean()), 0.0
    slope = float(centred @ value / (centred @ centred))
    if slope == 0 or not fits_float64(slope):
        raise FormatError(
            f"The camera positions in the names do not change with {axis}: give a table v,u,y,x."
        )
    return float(value.mean() - slope * index.mean()), slope
