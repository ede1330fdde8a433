"""Lattices of lenslets on the sensor: base vectors, centres, and sampling grids.

Files store lattices as JSON in the clplen format or as LensletGridModel of LFToolbox.
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

_MAX_FILE_BYTES = 1 << 24  # bytes of a file
_FORMAT = "clplen lattice"
_VERSION = 1
_MAX_POSITION = 1e9  # pixels: larger numbers are no sensor positions


def _json_of(lattice: Lattice) -> str:
    """Return JSON of a lattice; an unknown residual is null."""
    has_residual = math.isfinite(lattice.residual)
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
            "residual": float(lattice.residual) if has_residual else None,
            "trust": lattice.trust,
            "verdict": lattice.verdict,
        },
        indent=2,
    )


def _parsed(text: str, source: str) -> dict[str, Any]:
    """Return the arguments of `Lattice` from JSON of either format."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{source} is not valid JSON ({error}).") from error
    if isinstance(content, dict) and isinstance(content.get("LensletGridModel"), dict):
        model, read = content["LensletGridModel"], _toolbox_model
    elif isinstance(content, dict) and {"HSpacing", "VSpacing"} <= content.keys():
        model, read = content, _toolbox_model
    elif isinstance(content, dict) and content.get("format") == _FORMAT:
        model, read = content, _own_model
    else:
        raise FormatError(
            f"{source} does not describe a lattice of lenslets; pass the JSON of Lattice.save or "
            "a CalInfo.json of LFToolbox."
        )
    return read(model, source)


def _own_model(model: dict[str, Any], source: str) -> dict[str, Any]:
    if model.get("version") != _VERSION:
        raise FormatError(
            f"{source} must have version {_VERSION} of the lattice format, got "
            f"{model.get('version')!r}; save it with this version of clplen."
        )
    shape = None
    if model.get("shape") is not None:
        ny, nx = _numbers(model, "shape", 2, source)
        if not (is_integer(ny) and is_integer(nx) and min(ny, nx) >= 1):
            raise FormatError(f"{source}: 'shape' must be two positive integers, got {[ny, nx]}.")
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
    """Convert lenslet (row i, column j) of LFToolbox to 0-based pixels and rows, y and x.

    (x, y) = (HOffset, VOffset) + R(Rot) (j HSpacing + h, i VSpacing), h = HSpacing/2 on odd rows.
    """
    names = ("HSpacing", "VSpacing", "HOffset", "VOffset", "Rot", "FirstPosShiftRow")
    h, v, x, y, turn, first = (_numbers(model, name, 1, source)[0] for name in names)
    if first not in (1, 2) or not (h > 0 and v > 0):
        raise FormatError(
            f"{source}: HSpacing and VSpacing must be positive and FirstPosShiftRow 1 or 2, got "
            f"{h}, {v} and {first}."
        )
    column = (h * math.sin(turn), h * math.cos(turn))
    row = (v * math.cos(turn), -v * math.sin(turn))
    # FirstPosShiftRow + 2, ... are shifted (LFToolbox 0.5, LFBuildHexGrid)
    shift = 0.5 if first == 1 else 0.0
    origin = (y - 1 + shift * column[0], x - 1 + shift * column[1])
    if model.get("Orientation", "horz") == "vert":  # the picture was transposed first
        row, column, origin = column[::-1], row[::-1], origin[::-1]
    if not 0.7 < min(h, v) / max(h, v) < 0.95:
        raise FormatError(
            f"{source}: HSpacing {h} and VSpacing {v} must have the ratio 0.866 of a hexagonal "
            "lattice."
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
    """Return ``count`` finite numbers of an entry."""
    value = model.get(name)
    values: list[Any] = value if isinstance(value, list) else [value]
    if len(values) != count or not all(_is_number(n) for n in values):
        expected = "a number" if count == 1 else f"{count} numbers"
        raise FormatError(f"{source}: {name!r} must be {expected}, got {value!r}.")
    return [float(n) for n in values]


def _is_number(n: Any) -> bool:
    return isinstance(n, int | float) and not isinstance(n, bool) and abs(n) < _MAX_POSITION


Pair = tuple[float, float]
Values = np.ndarray[Any, np.dtype[np.float64]]

KINDS = ("square", "hexagonal")
TRUST = ("high", "low")


def lattice_kind(name: str) -> str:
    """Return the kind of a lattice, "square" or "hexagonal"."""
    if name not in KINDS:
        raise ValueError(f"kind must be {' or '.join(KINDS)}, got {name!r}.")
    return name


@dataclass(frozen=True)
class Lattice:
    """Centres of the sub-images on the sensor, in pixels; pixel centres are integers.

    Lenslet (i, k) of a square lattice, whose cell may be a rectangle, has its centre at
    ``origin + i row + k column``. In a hexagonal lattice the lines of nearest neighbours are:

    - its rows, near x, if abs(row) < abs(column); odd rows are shifted by half of ``column``,
    - its columns, near y, if abs(row) > abs(column) (`turned`); odd columns are shifted by half of
      ``row``.

    Attributes
    ----------
    kind : {"square", "hexagonal"}
        Lattice type; "rectangular" is read as "square".
    origin : tuple of float
        Centre (y, x) of lenslet (0, 0), near the middle of the picture if estimated.
    row, column : tuple of float
        Steps (y, x) to the next row (nearly +y) and to the next column (nearly +x).
    shape : tuple of int or None
        Shape (ny, nx) of the raw picture; None if a file does not state it.
    residual : float
        Rms distance between local fits and this lattice, in pixels; NaN unless estimated.
    trust : {"high", "low"}
        Reliability of an estimated lattice.
    verdict : str
        Sentence on the result of the estimate.

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
            raise ValueError(f"trust must be {' or '.join(TRUST)}, got {self.trust!r}.")
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise ValueError(
                "origin, row and column of a lattice must be finite pairs (y, x), got "
                f"{self.origin}, {self.row}, {self.column}."
            )
        area = self.row[0] * self.column[1] - self.row[1] * self.column[0]
        if not (self.row[0] > 0 and self.column[1] > 0 and area > 0):
            raise ValueError(
                "rows of a lattice must follow along +y and columns along +x, got steps "
                f"{self.row} and {self.column}."
            )

    @property
    def is_measured(self) -> bool:
        """False if the lattice is a placeholder, because no lattice could be measured."""
        return self.trust == "high" or math.isfinite(self.residual)

    @property
    def pitch(self) -> Pair:
        """Distances between columns and rows in pixels: (abs(column), abs(row))."""
        return math.hypot(*self.column), math.hypot(*self.row)

    @property
    def neighbour(self) -> float:
        """Mean distance of nearest neighbours in pixels."""
        row, column = np.array(self.row), np.array(self.column)
        if self.kind == "square":
            return float(min(self.pitch))
        along, across = (row, column) if self.turned else (column, row)
        three = (along, across + along / 2, across - along / 2)
        return float(np.mean([math.hypot(*step) for step in three]))

    @property
    def rotation(self) -> float:
        """Mean angle in radians of columns from +x and rows from +y.

        Positive angles turn +x towards +y, clockwise on a screen.
        """
        column_angle = math.atan2(self.column[0], self.column[1])
        return (column_angle + math.atan2(-self.row[1], self.row[0])) / 2

    @property
    def turned(self) -> bool:
        """True for a hexagonal lattice with nearest neighbours along y."""
        return self.kind == "hexagonal" and self.pitch[1] > self.pitch[0]

    def centres(self) -> Values:
        """Return the centres (y, x) of all lenslets whose centre lies on the picture.

        Returns
        -------
        numpy.ndarray
            Centres, float64, shape (n, 2), row by row.

        Raises
        ------
        ValueError
            If the shape of the picture is unknown.
        """
        i, k = self._indices()
        positions = self.at(i, k)
        ny, nx = self._shape()
        y, x = positions[:, 0], positions[:, 1]
        inside = (y >= -0.5) & (y < ny - 0.5) & (x >= -0.5) & (x < nx - 0.5)
        return positions[inside]

    def at(self, i: Any, k: Any) -> Values:
        """Return the centres (y, x) of lenslets in row i and column k, float64, shape (..., 2)."""
        i, k = np.broadcast_arrays(np.asarray(i), np.asarray(k))
        half_i = k % 2 / 2 if self.turned else 0.0
        half_k = i % 2 / 2 if self.kind == "hexagonal" and not self.turned else 0.0
        rows = (i + half_i)[..., None] * np.asarray(self.row)
        return np.asarray(self.origin) + rows + (k + half_k)[..., None] * np.asarray(self.column)

    def views(self) -> tuple[int, int]:
        """Return (V, U), the pixels across a sub-image: its pitch, rounded."""
        if self.kind == "hexagonal":
            return (max(1, round(self.neighbour)),) * 2
        return max(1, round(self.pitch[1])), max(1, round(self.pitch[0]))

    def view_steps(self, views: tuple[int, int], step: float | None = None) -> tuple[Pair, Pair]:
        """Return the steps (y, x) in pixels between views, along the rows and the columns.

        ``step`` is their length; None divides the pitch by the number of views, separately for rows
        and columns (the distance of nearest neighbours for a hexagonal lattice).
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
        """Return the sampling grid of a full rectangle of lenslets.

        Parameters
        ----------
        views : tuple of int
            Number (V, U) of views.
        step : float, optional
            Pixels a view; default as in `view_steps`.
        complete : bool
            True if sub-images must be complete, False if their centres must lie on the picture.
        square : bool
            True to resample a hexagonal lattice to square pixels, with the distance of its rows,
            sqrt(3)/2 of the pitch, along both axes; False to keep the pitch along the rows.

        Returns
        -------
        LensletGrid
            Grid. For a `turned` lattice its rows and columns are exchanged, and those of the views.

        Raises
        ------
        ShapeError
            If no lenslet lies on the picture.
        """
        down, right = self.view_steps(views, step)
        reach = (np.array(views) - 1) / 2 if complete else np.zeros(2)
        margin = reach[0] * np.abs(down) + reach[1] * np.abs(right)
        top, bottom, left, end = self._complete_rectangle(margin)
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
                "The lattice has no picture shape; set it by replace(lattice, shape=(ny, nx))."
            )
        return self.shape

    def _indices(self) -> tuple[Any, Any]:
        """Return rows and columns of all lenslets that may lie on the picture, flat."""
        ny, nx = self._shape()
        matrix = np.linalg.inv(np.array([self.row, self.column]).T)
        corners = np.array([(y, x) for y in (-0.5, ny) for x in (-0.5, nx)]) - self.origin
        indices = np.clip(corners @ matrix.T, -1e15, 1e15)  # integers, however far away
        low, high = (
            np.floor(indices.min(0)).astype(int) - 1,
            np.ceil(indices.max(0)).astype(int) + 1,
        )
        i, k = np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1]
        return i.ravel(), k.ravel()

    def _complete_rectangle(self, margin: Any) -> tuple[int, int, int, int]:
        """Return a large rectangle of rows and columns whose lenslets keep a margin (y, x)."""
        ny, nx = self._shape()
        i, k = self._indices()
        centres = self.at(i, k)
        low, high = centres - margin, centres + margin
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
                f"No lenslet of pitch {self.neighbour:.4g} px has a complete sub-image on a "
                f"picture of shape {(ny, nx)}; pass complete=False, fewer views or a smaller step."
            )
        return int(i[0]) + top, int(i[0]) + bottom, int(k[0]) + left, int(k[0]) + right

    def to_json(self) -> str:
        """Return the lattice as JSON (``format``: "clplen lattice", ``version``: 1)."""
        return _json_of(self)

    @classmethod
    def from_json(cls, text: str, *, source: str = "The lattice") -> Lattice:
        """Create a lattice from the text of `to_json` or of a CalInfo.json of LFToolbox.

        Parameters
        ----------
        text : str
            JSON of the lattice.
        source : str
            Name of the lattice in messages.

        Raises
        ------
        FormatError
            If the text is in neither format, or a number is missing or invalid.
        """
        fields = _parsed(text, source)
        try:
            return cls(**fields)
        except ValueError as error:
            raise FormatError(f"{source}: {error}") from error

    def save(self, path: PathLike) -> None:
        """Write the lattice to a JSON file.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        with replacing(path) as temporary:
            temporary.write_text(self.to_json() + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: PathLike) -> Lattice:
        """Read a file written by `save`, or a CalInfo.json of LFToolbox.

        Raises
        ------
        FormatError
            If the file is missing, unreadable, or describes no lattice.
        """
        if require_file(path, "lattice").stat().st_size > _MAX_FILE_BYTES:
            raise FormatError(f"{path} is too large for a lattice file; choose another file.")
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise FormatError(f"The lattice {path} cannot be read ({error}).") from error
        return cls.from_json(text, source=str(path))


def _transposed(grid: LensletGrid) -> LensletGrid:
    """Exchange rows and columns of a grid."""
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
