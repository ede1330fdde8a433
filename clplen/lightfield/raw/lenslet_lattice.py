"""Lattices of lenslets as they lie on the sensor: base vectors, centres, and what to sample.

Files hold them as JSON: our own form, and LensletGridModel of LFToolbox.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import is_integer
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike, replacing, require_file
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.outputs import MARK

_LARGEST = 1 << 24  # bytes of a file
_FORMAT = "clplen lattice"
_VERSION = 1
_FARTHEST = 1e9  # pixels: beyond it a number is no place on a sensor


def _json_of(lattice: Lattice) -> str:
    """JSON of a lattice; a residual that is not known is null."""
    known = math.isfinite(lattice.residual)
    return json.dumps(
        {
            "format": _FORMAT,
            "version": _VERSION,
            "software": MARK,
            "unit": "pixels (y, x), pixel centres at integers from 0",
            "kind": lattice.kind,
            "origin": [float(n) for n in lattice.origin],
            "row": [float(n) for n in lattice.row],
            "column": [float(n) for n in lattice.column],
            "shape": None if lattice.shape is None else [int(n) for n in lattice.shape],
            "residual": float(lattice.residual) if known else None,
            "trust": lattice.trust,
            "verdict": lattice.verdict,
        },
        indent=2,
    )


def _parsed(text: str, source: str) -> dict[str, Any]:
    """What `Lattice` takes, by name, from JSON of either form."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{source} is no JSON ({error}).") from error
    if isinstance(content, dict) and isinstance(content.get("LensletGridModel"), dict):
        model, read = content["LensletGridModel"], _toolbox_model
    elif isinstance(content, dict) and {"HSpacing", "VSpacing"} <= content.keys():
        model, read = content, _toolbox_model
    elif isinstance(content, dict) and content.get("format") == _FORMAT:
        model, read = content, _own_model
    else:
        raise FormatError(
            f"{source} describes no lattice of lenslets: give the JSON that Lattice.save writes, "
            "or a CalInfo.json of LFToolbox."
        )
    return read(model, source)


def _own_model(model: dict[str, Any], source: str) -> dict[str, Any]:
    if model.get("version") != _VERSION:
        raise FormatError(
            f"{source} has version {model.get('version')!r} of the lattice format, clplen reads "
            f"{_VERSION}: write it again with this version."
        )
    shape = None
    if model.get("shape") is not None:
        ny, nx = _numbers(model, "shape", 2, source)
        if not (is_integer(ny) and is_integer(nx) and min(ny, nx) >= 1):
            raise FormatError(f"{source}: 'shape' is two positive integers, not {[ny, nx]}.")
        shape = (int(ny), int(nx))
    residual = math.nan
    if model.get("residual") is not None:
        (residual,) = _numbers(model, "residual", 1, source)
    pairs = {name: tuple(_numbers(model, name, 2, source)) for name in ("origin", "row", "column")}
    return {
        "kind": str(model.get("kind")),
        **pairs,
        "shape": shape,
        "residual": residual,
        "trust": str(model.get("trust")),
        "verdict": str(model.get("verdict", "")),
    }


def _toolbox_model(model: dict[str, Any], source: str) -> dict[str, Any]:
    """Lenslet (row i, column j) of LFToolbox, one-based pixels and rows, y and x from 0 here.

    (x, y) = (HOffset, VOffset) + R(Rot) (j HSpacing + h, i VSpacing) with h = HSpacing/2 on rows
    FirstPosShiftRow, FirstPosShiftRow + 2, ... (LFToolbox 0.5, LFBuildHexGrid); Orientation "vert"
    means that the picture was transposed first.
    """
    names = ("HSpacing", "VSpacing", "HOffset", "VOffset", "Rot", "FirstPosShiftRow")
    h, v, x, y, turn, first = (_numbers(model, name, 1, source)[0] for name in names)
    if first not in (1, 2) or not (h > 0 and v > 0):
        raise FormatError(
            f"{source}: HSpacing and VSpacing are positive and FirstPosShiftRow is 1 or 2, not "
            f"{h}, {v} and {first}."
        )
    column = (h * math.sin(turn), h * math.cos(turn))
    row = (v * math.cos(turn), -v * math.sin(turn))
    moved = 0.5 if first == 1 else 0.0
    origin = (y - 1 + moved * column[0], x - 1 + moved * column[1])
    if model.get("Orientation", "horz") == "vert":
        row, column, origin = column[::-1], row[::-1], origin[::-1]
    if not 0.7 < min(h, v) / max(h, v) < 0.95:
        raise FormatError(
            f"{source}: HSpacing {h} and VSpacing {v} make no hexagonal lattice, whose ratio is "
            "0.866."
        )
    verdict = "from a calibration of LFToolbox"
    return {
        "kind": "hexagonal",
        "origin": origin,
        "row": row,
        "column": column,
        "verdict": verdict,
    }


def _numbers(model: dict[str, Any], name: str, count: int, source: str) -> list[float]:
    """So many finite numbers of an entry."""
    value = model.get(name)
    values: list[Any] = value if isinstance(value, list) else [value]
    if len(values) != count or not all(_is_number(n) for n in values):
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise FormatError(f"{source}: {name!r} is {wanted}, not {value!r}.")
    return [float(n) for n in values]


def _is_number(n: Any) -> bool:
    return isinstance(n, int | float) and not isinstance(n, bool) and abs(n) < _FARTHEST


Pair = tuple[float, float]
Values = np.ndarray[Any, np.dtype[np.float64]]

KINDS = ("square", "hexagonal")
TRUST = ("high", "low")


def lattice_kind(name: str) -> str:
    """Return the kind of a lattice, "square" or "hexagonal"."""
    if name not in KINDS:
        raise ValueError(f"A lattice is {' or '.join(KINDS)}, not {name!r}.")
    return name


@dataclass(frozen=True)
class Lattice:
    """Centres of the sub-images on the sensor, in pixels; pixel centres are integers.

    Lenslet (i, k) of a square lattice, whose cell may be a rectangle, has its centre at
    ``origin + i row + k column``. The rows of a hexagonal lattice run along its lines of nearest
    neighbours, which lie nearest to either x or y:

    - along x (abs(row) < abs(column)): odd rows are moved by half of ``column``,
    - along y (abs(row) > abs(column)), `turned`: odd columns are moved by half of ``row``.

    Attributes
    ----------
    kind : {"square", "hexagonal"}
        "rectangular" is read as "square".
    origin : tuple of float
        (y, x) of the centre of lenslet (0, 0), near the middle of the picture when estimated.
    row, column : tuple of float
        (y, x), steps to the next row (nearly +y) and to the next column (nearly +x).
    shape : tuple of int or None
        (ny, nx) of the raw picture; None where a file does not tell.
    residual : float
        rms distance of local lattices from this one, in pixels; NaN when not estimated.
    trust : {"high", "low"}
    verdict : str
        One sentence on what was found.

    Examples
    --------
    >>> lattice = clplen.lightfield.Lattice("square", (7.0, 7.0), (15.0, 0.0), (0.0, 15.0))
    >>> lattice.save("grid.json")
    >>> clplen.lightfield.Lattice.load("grid.json").row
    (15.0, 0.0)
    """

    kind: str
    origin: Pair
    row: Pair
    column: Pair
    shape: tuple[int, int] | None = None
    residual: float = math.nan
    trust: str = "high"
    verdict: str = "given"

    def __post_init__(self) -> None:
        numbers = (*self.origin, *self.row, *self.column)
        object.__setattr__(self, "kind", lattice_kind(self.kind))
        if self.trust not in TRUST:
            raise ValueError(f"The trust in a lattice is {' or '.join(TRUST)}, not {self.trust!r}.")
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise ValueError(
                "The origin, row and column of a lattice are finite pairs (y, x), not "
                f"{self.origin}, {self.row}, {self.column}."
            )
        area = self.row[0] * self.column[1] - self.row[1] * self.column[0]
        if not (self.row[0] > 0 and self.column[1] > 0 and area > 0):
            raise ValueError(
                "The rows of a lattice follow one another along +y and its columns along +x, not "
                f"by {self.row} and {self.column}."
            )

    @property
    def is_measured(self) -> bool:
        """Whether the lattice was given or found, and does not stand in for a missing one."""
        return self.trust == "high" or math.isfinite(self.residual)

    @property
    def pitch(self) -> Pair:
        """Distances between columns and between rows, in pixels: (abs(column), abs(row))."""
        return math.hypot(*self.column), math.hypot(*self.row)

    @property
    def neighbour(self) -> float:
        """Mean distance of nearest neighbours, in pixels."""
        row, column = np.array(self.row), np.array(self.column)
        if self.kind == "square":
            return float(min(self.pitch))
        along, across = (row, column) if self.turned else (column, row)
        three = (along, across + along / 2, across - along / 2)
        return float(np.mean([math.hypot(*step) for step in three]))

    @property
    def rotation(self) -> float:
        """Angle in radians by which columns are turned from +x and rows from +y, their mean.

        Positive turns +x towards +y, that is clockwise on a screen.
        """
        of_column = math.atan2(self.column[0], self.column[1])
        return (of_column + math.atan2(-self.row[1], self.row[0])) / 2

    @property
    def turned(self) -> bool:
        """Whether a hexagonal lattice has its nearest neighbours along y."""
        return self.kind == "hexagonal" and self.pitch[1] > self.pitch[0]

    def centres(self) -> Values:
        """Centres (y, x) of all lenslets whose centre lies on the picture.

        Returns
        -------
        numpy.ndarray
            float64, shape (n, 2), row by row.

        Raises
        ------
        ValueError
            If the shape of the picture is not known.
        """
        i, k = self._indices()
        at = self.at(i, k)
        ny, nx = self._shape()
        y, x = at[:, 0], at[:, 1]
        on = (y >= -0.5) & (y < ny - 0.5) & (x >= -0.5) & (x < nx - 0.5)
        return at[on]

    def at(self, i: Any, k: Any) -> Values:
        """Centres (y, x) of the lenslets of row i and column k, float64, shape (..., 2)."""
        i, k = np.broadcast_arrays(np.asarray(i), np.asarray(k))
        half_i = k % 2 / 2 if self.turned else 0.0
        half_k = i % 2 / 2 if self.kind == "hexagonal" and not self.turned else 0.0
        rows = (i + half_i)[..., None] * np.asarray(self.row)
        return np.asarray(self.origin) + rows + (k + half_k)[..., None] * np.asarray(self.column)

    def views(self) -> tuple[int, int]:
        """(V, U), the pixels across a sub-image: its pitch, rounded."""
        if self.kind == "hexagonal":
            return (max(1, round(self.neighbour)),) * 2
        return max(1, round(self.pitch[1])), max(1, round(self.pitch[0]))

    def view_steps(self, views: tuple[int, int], step: float | None = None) -> tuple[Pair, Pair]:
        """Steps (y, x) in pixels from view to view, along the rows and along the columns.

        ``step`` is their length; None divides the pitch by the number of views, for rows and
        columns each (for the nearest neighbours of a hexagonal lattice).
        """
        along, across = self.pitch
        near = self.neighbour
        spans = (near, near) if self.kind == "hexagonal" else (across, along)
        lengths = [span / n if step is None else step for span, n in zip(spans, views, strict=True)]
        down = np.array(self.row) * lengths[0] / across
        right = np.array(self.column) * lengths[1] / along
        return (float(down[0]), float(down[1])), (float(right[0]), float(right[1]))

    def grid(
        self,
        views: tuple[int, int],
        *,
        step: float | None = None,
        complete: bool = True,
        square: bool = False,
    ) -> LensletGrid:
        """What to sample: a full rectangle of lenslets.

        Parameters
        ----------
        views : tuple of int
            (V, U).
        step : float, optional
            Pixels a view; default as in `view_steps`.
        complete : bool
            Whether the whole sub-image of every lenslet lies on the picture; else only its centre.
        square : bool
            Whether the lines of nearest neighbours of a hexagonal lattice are interpolated to
            pixels as far apart as the lines are, sqrt(3)/2 of the pitch; else they keep the pitch.

        Returns
        -------
        LensletGrid
            Of a `turned` lattice with rows and columns exchanged, views too.

        Raises
        ------
        ShapeError
            If not one lenslet lies on the picture.
        """
        down, right = self.view_steps(views, step)
        reach = (np.array(views) - 1) / 2 if complete else np.zeros(2)
        margin = reach[0] * np.abs(down) + reach[1] * np.abs(right)
        top, bottom, left, end = self._kept(margin)
        count = (bottom - top, end - left)
        first = self.at(top, left)
        shift = 0.0
        if self.kind == "hexagonal":
            shift = -0.5 if (left if self.turned else top) % 2 else 0.5
        grid = LensletGrid(
            count, views, (first[0], first[1]), self.row, self.column, shift, down, right
        )
        grid = _transposed(grid) if self.turned else grid
        if square and self.kind == "hexagonal":
            step = min(self.pitch) / max(self.pitch)
            grid = replace(grid, columns=(int((grid.count[1] - 1) / step) + 1, step))
        return grid

    def _shape(self) -> tuple[int, int]:
        if self.shape is None:
            raise ValueError(
                "The lattice does not say how large its picture is: use replace(lattice, "
                "shape=(ny, nx))."
            )
        return self.shape

    def _indices(self) -> tuple[Any, Any]:
        """Rows and columns of all lenslets that may lie on the picture, flat."""
        ny, nx = self._shape()
        matrix = np.linalg.inv(np.array([self.row, self.column]).T)
        corners = np.array([(y, x) for y in (-0.5, ny) for x in (-0.5, nx)]) - self.origin
        places = np.clip(corners @ matrix.T, -1e15, 1e15)  # whole numbers, however far it lies
        low, high = np.floor(places.min(0)).astype(int) - 1, np.ceil(places.max(0)).astype(int) + 1
        i, k = np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1]
        return i.ravel(), k.ravel()

    def _kept(self, margin: Any) -> tuple[int, int, int, int]:
        """Rows and columns of a large rectangle whose lenslets all keep a margin (y, x)."""
        ny, nx = self._shape()
        i, k = self._indices()
        at = self.at(i, k)
        low, high = at - margin, at + margin
        inside = (low >= -0.5).all(1) & (high < np.array([ny, nx]) - 0.5).all(1)
        good = inside.reshape(np.ptp(i) + 1, np.ptp(k) + 1)
        top, left, (bottom, right) = 0, 0, good.shape
        while top < bottom and left < right and not good[top:bottom, left:right].all():
            box = good[top:bottom, left:right]
            missing = [(~side).mean() for side in (box[0], box[-1], box[:, 0], box[:, -1])]
            side = int(np.argmax(missing))
            top, bottom = top + (side == 0), bottom - (side == 1)
            left, right = left + (side == 2), right - (side == 3)
        if top >= bottom or left >= right:
            raise ShapeError(
                f"No lenslet of pitch {self.neighbour:.4g} px has its whole sub-image on a picture "
                f"of shape {(ny, nx)}: give complete=False, fewer views or a smaller step."
            )
        return int(i[0]) + top, int(i[0]) + bottom, int(k[0]) + left, int(k[0]) + right

    def to_json(self) -> str:
        """The lattice as JSON (``format``: "clplen lattice", ``version``: 1)."""
        return _json_of(self)

    @classmethod
    def from_json(cls, text: str, *, source: str = "The lattice") -> Lattice:
        """The inverse of `to_json`; a CalInfo.json of LFToolbox is understood too.

        Parameters
        ----------
        text : str
        source : str
            What messages call it.

        Raises
        ------
        FormatError
            If it is neither, or a number in it is missing or no lattice.
        """
        fields = _parsed(text, source)
        try:
            return cls(**fields)
        except ValueError as error:
            raise FormatError(f"{source}: {error}") from error

    def save(self, path: PathLike) -> None:
        """Write `to_json` to a file.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        with replacing(path) as temporary:
            temporary.write_text(self.to_json() + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: PathLike) -> Lattice:
        """Read what `save` wrote, or a CalInfo.json of LFToolbox.

        Raises
        ------
        FormatError
            If the file is missing, unreadable, or describes no lattice.
        """
        if require_file(path, "lattice").stat().st_size > _LARGEST:
            raise FormatError(f"{path} is larger than any file of a lattice: name another.")
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise FormatError(f"The lattice {path} cannot be read ({error}).") from error
        return cls.from_json(text, source=str(path))


def _transposed(grid: LensletGrid) -> LensletGrid:
    """The same lenslets with rows for columns."""
    return replace(
        grid,
        exchanged=True,
        count=grid.count[::-1],
        views=grid.views[::-1],
        row_step=grid.column_step,
        column_step=grid.row_step,
        row_view_step=grid.column_view_step,
        column_view_step=grid.row_view_step,
    )
