"""Where the views of a light field lie, from a table or from the names of its files."""

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
_LONGEST = 1000  # bytes of a line, on average
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def positions_of(
    layout: Layout, views: View, *, names: Mapping[View, str] | None = None
) -> Positions | None:
    """The positions that a layout asks for, in the order of the final light field."""
    if layout.positions is None:
        return None
    places = layout.oriented(read_positions(layout.positions, views, names=names))
    if str(layout.positions) == NAMES:
        if layout.swap_uv:
            places = places[..., ::-1]
        places = places * [-1 if flip else 1 for flip in (layout.flip_v, layout.flip_u)]
    return np.ascontiguousarray(places)


def read_positions(
    source: PathLike, views: View, *, names: Mapping[View, str] | None = None
) -> Positions:
    """Where the views lie, in view steps."""
    if str(source) == NAMES:
        places = _from_names(views, names or {})
    else:
        places = _from_table(Path(source), views)
    return np.asarray(places - places.mean(axis=(0, 1)))


def _from_table(path: Path, views: View) -> Positions:
    places = np.full((*views, 2), np.nan)
    seen: dict[View, int] = {}
    for line, row in _rows(path, views):
        v, u, y, x = (_number(path, line, name, row[name]) for name in _COLUMNS)
        if not (v in range(views[0]) and u in range(views[1])):
            raise FormatError(
                f"{path}, line {line}: there is no view v={v:g}, u={u:g} among {views[0]} x "
                f"{views[1]} (V x U), counted from 0."
            )
        view = (int(v), int(u))
        if view in seen:
            raise FormatError(
                f"{path}, line {line}: the view v={view[0]}, u={view[1]} is in line {seen[view]} "
                "already; each view stands in the table once."
            )
        seen[view] = line
        places[view] = y, x
    missing = [f"(v={v}, u={u})" for v, u in np.ndindex(*views) if (v, u) not in seen]
    if missing:
        raise FormatError(
            f"{path} ends without the positions of {len(missing)} of {views[0]} x {views[1]} views "
            f"(V x U): {listed(missing)}."
        )
    return places


def _rows(path: Path, views: View) -> Iterator[tuple[int, dict[str, str]]]:
    """(line, text by column) of a table."""
    if not path.is_file():
        raise FormatError(
            f"There is no table of positions {path}; or give {argument('positions', NAMES)}."
        )
    if path.stat().st_size > _LONGEST * (math.prod(views) + 1):
        raise FormatError(f"{path} is too large for the positions of {math.prod(views)} views.")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            header = [name.strip().lower() for name in next(reader, [])]
            if sorted(header) != sorted(_COLUMNS):
                raise FormatError(
                    f"{path}, line 1: a table of positions begins with v,u,y,x, not with "
                    f"{','.join(header)[:80]!r}."
                )
            for row in reader:
                if len(row) not in (0, len(header)):
                    raise FormatError(
                        f"{path}, line {reader.line_num}: {len(row)} columns where "
                        f"{','.join(header)} are meant."
                    )
                if row:
                    yield reader.line_num, dict(zip(header, row, strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(f"{path} is no table of text with commas ({error}).") from error


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not fits_float64(value):
        raise FormatError(f"{path}, line {line}: {name} is {text.strip()[:40]!r}, no number.")
    return value


def _from_names(views: View, names: Mapping[View, str]) -> Positions:
    """y and x of file names as view steps, by the steps of rows and columns."""
    if not names:
        raise FormatError(
            f"{argument('positions', NAMES)} needs views that are files with names; give a table "
            "v,u,y,x."
        )
    grid = np.array(sorted(names), np.float64)
    found = np.array([_camera(names[view]) for view in sorted(names)])
    fits = [_line(grid[:, axis], found[:, axis], "vu"[axis]) for axis in (0, 1)]
    step = abs(fits[1][1] if views[1] > 1 else fits[0][1]) or 1.0
    places = np.empty((*views, 2))
    rows, columns = grid.astype(int).T
    for axis, (start, slope) in enumerate(fits):
        size = math.copysign(step, slope)
        places[..., axis] = slope / size * np.indices(views)[axis]
        places[rows, columns, axis] = (found[:, axis] - start) / size
    return places


def _camera(name: str) -> tuple[float, float]:
    numbers = _NUMBER.findall(PurePosixPath(name).stem)
    if len(numbers) < 4:
        raise FormatError(
            f"The name {name} has {len(numbers)} numbers; {argument('positions', NAMES)} needs "
            "row, column, y and x, as in out_00_01_-381.9_1103.4_.png."
        )
    return float(numbers[-2]), float(numbers[-1])


def _line(index: Positions, value: Positions, axis: str) -> tuple[float, float]:
    """(value at 0, step) by least squares; a single row or column has no step."""
    centred = index - index.mean()
    if not centred.any():
        return float(value.mean()), 0.0
    slope = float(centred @ value / (centred @ centred))
    if slope == 0 or not fits_float64(slope):
        raise FormatError(
            f"The camera positions in the names do not change with {axis}: give a table v,u,y,x."
        )
    return float(value.mean() - slope * index.mean()), slope
