"""Intrinsics of light-field cameras as JSON files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from clplen.checks import float64_array, is_finite, is_integer, require
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike, replacing, require_file
from clplen.lightfield.metric.intrinsics import Intrinsics

FORMAT = "clplen intrinsics"
VERSION = 1
_UNITS = {
    "matrix": "metres (rows 1, 2) and slopes (rows 3, 4) by view and pixel; [s, t, u, v, 1] = "
    "matrix [i, j, k, l, 1]",
    "distortion": "slopes and their powers",
    "spacing": "metres",
    "rms": "pixels",
}
_DISTORTION = ("b_u", "b_v", "k1", "k2", "k3")
_MAX_FILE_BYTES = 1 << 24
_Fields = dict[str, Any]


def write_intrinsics(path: PathLike, intrinsics: Intrinsics) -> None:
    """Write the intrinsics of a camera as JSON.

    Parameters
    ----------
    path : path-like
        Output file, usually ``.json``; an existing file is replaced.
    intrinsics : Intrinsics
        Intrinsics of `clplen.lightfield.calibrate`.

    Raises
    ------
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> H = np.diag([1e-3, 1e-3, 2e-3, 2e-3, 1.0])
    >>> H[:4, 4] = -H.diagonal()[:4] * (1, 1, 23.5, 15.5)
    >>> camera = clplen.lightfield.Intrinsics(H, np.zeros(5), (3, 3, 32, 48))
    >>> clplen.io.write_intrinsics("camera.json", camera)
    """
    require(Intrinsics, intrinsics, "intrinsics", "calibrate")
    V, U, ny, nx = intrinsics.shape
    fields: _Fields = {
        "format": FORMAT,
        "version": VERSION,
        "units": _UNITS,
        "views": [V, U],
        "pixels": [ny, nx],
        "matrix": intrinsics.matrix.tolist(),
        "distortion": dict(zip(_DISTORTION, intrinsics.distortion.tolist(), strict=True)),
        "rms": _numbers(intrinsics.rms),
        "board": None if intrinsics.board is None else list(intrinsics.board),
        "spacing": intrinsics.spacing,
        "board_rms": _numbers(intrinsics.board_rms),
        "view_rms": _numbers(intrinsics.view_rms),
        "deviations": _numbers(intrinsics.deviations),
    }
    text = json.dumps(fields, indent=1, allow_nan=False)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _numbers(values: Any) -> Any:
    """Return nested lists of numbers, with None for NaN."""
    if values is None:
        return None
    array = np.asarray(values, float)
    if array.ndim == 0:
        return float(array) if np.isfinite(array) else None
    return [_numbers(part) for part in array]


def read_intrinsics(path: PathLike) -> Intrinsics:
    """Read a file of `write_intrinsics`.

    Parameters
    ----------
    path : path-like
        JSON file of `write_intrinsics`.

    Returns
    -------
    Intrinsics
        Intrinsics of the camera.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another kind or version, or invalid.

    Examples
    --------
    >>> H = np.diag([1e-3, 1e-3, 2e-3, 2e-3, 1.0])
    >>> H[:4, 4] = -H.diagonal()[:4] * (1, 1, 23.5, 15.5)
    >>> camera = clplen.lightfield.Intrinsics(H, np.zeros(5), (3, 3, 32, 48))
    >>> clplen.io.write_intrinsics("camera.json", camera)
    >>> clplen.io.read_intrinsics("camera.json")
    <Intrinsics of 3 x 3 views of 32 x 48 pixels, focal length 500 px, baseline 1 mm>
    """
    path = Path(path)
    fields = _parse(path)
    if fields.get("format") != FORMAT:
        _refuse(path, f"is not a file of intrinsics (format {FORMAT!r}): use 'clplen calibrate'")
    if fields.get("version") != VERSION:
        raise FormatError(
            f"{path} must have version {VERSION}, got {fields.get('version')!r}: install a newer "
            "clplen, or calibrate again."
        )
    missing = [name for name in ("views", "pixels", "matrix", "distortion") if name not in fields]
    if missing:
        _refuse(path, f"has no {' and no '.join(map(repr, missing))}: use 'clplen calibrate'")
    try:
        return _build(path, fields)
    except (ValueError, ShapeError, OverflowError) as error:
        raise FormatError(f"{path} is not a valid camera: {error}") from error


def _refuse(path: Path, what: str) -> NoReturn:
    raise FormatError(f"{path} {what} on light fields of a checkerboard.")


def _parse(path: Path) -> _Fields:
    """Return the object of a JSON file."""

    def constant(name: str) -> NoReturn:
        raise FormatError(f"{path} has the invalid number {name}: calibrate again.")

    if path.exists():
        require_file(path, "file of intrinsics")
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise FormatError(
                f"{path} is too large to be a file of intrinsics: choose another file."
            )
        text = path.read_text(encoding="utf-8")
        fields = json.loads(text, parse_constant=constant)
    except OSError as error:
        raise FormatError(f"Cannot read the intrinsics {path} ({error}).") from error
    except (ValueError, RecursionError) as error:
        raise FormatError(
            f"{path} is not valid JSON ({error}): choose a file of intrinsics."
        ) from error
    if not isinstance(fields, dict):
        _refuse(path, "is not a file of intrinsics: use 'clplen calibrate'")
    return fields


def _build(path: Path, fields: _Fields) -> Intrinsics:
    """Build the camera of a file whose keys are complete."""
    distortion = fields["distortion"]
    if not isinstance(distortion, dict) or set(distortion) != set(_DISTORTION):
        raise ValueError(f"distortion must have the keys {', '.join(_DISTORTION)}.")
    board, spacing, rms = (fields.get(name) for name in ("board", "spacing", "rms"))
    if spacing is not None and not (is_finite(spacing) and spacing > 0):
        raise ValueError(f"spacing must be positive, in metres, got {spacing!r}.")
    if rms is not None and not (is_finite(rms) and rms >= 0):
        raise ValueError(f"rms must be a number of pixels, got {rms!r}.")
    boards = _array("board_rms", fields.get("board_rms"))
    if boards is not None and boards.ndim != 1:
        raise ValueError("board_rms must be a list of numbers.")
    views, pixels = (_pair(name, fields[name]) for name in ("views", "pixels"))
    matrix = _array("matrix", fields["matrix"])
    assert matrix is not None
    return Intrinsics(
        matrix,
        np.array([_number(name, distortion[name]) for name in _DISTORTION]),
        (*views, *pixels),
        float("nan") if rms is None else float(rms),
        None if board is None else _pair("board", board),
        None if spacing is None else float(spacing),
        boards,
        _array("view_rms", fields.get("view_rms")),
        _array("deviations", fields.get("deviations")),
    )


def _pair(name: str, value: Any) -> tuple[int, int]:
    """Return two positive integers."""
    if not isinstance(value, list) or len(value) != 2 or not all(map(is_integer, value)):
        raise ValueError(f"{name} must be two integers, got {value!r}.")
    if min(value) < 1:
        raise ValueError(f"{name} must be two positive integers, got {value!r}.")
    return int(value[0]), int(value[1])


def _number(name: str, value: Any) -> float:
    if not is_finite(value) or isinstance(value, bool):
        raise ValueError(f"{name} must be a finite number, got {value!r}.")
    return float(value)


def _array(name: str, value: Any) -> np.ndarray[Any, Any] | None:
    """Return an array of numbers, NaN for null; None for a missing array."""
    if value is None:
        if name == "matrix":
            raise ValueError("matrix must not be null.")
        return None
    try:
        return float64_array(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of numbers.") from None
