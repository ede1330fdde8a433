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
_LARGEST = 1 << 24  # bytes of a file
_Words = dict[str, Any]


def write_intrinsics(path: PathLike, intrinsics: Intrinsics) -> None:
    """Write the intrinsics of a camera as JSON.

    Parameters
    ----------
    path : path-like
        Usually ``.json``; an existing file is replaced.
    intrinsics : Intrinsics
        Of `clplen.lightfield.calibrate`.

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
    words: _Words = {
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
    text = json.dumps(words, indent=1, allow_nan=False)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _numbers(values: Any) -> Any:
    """Numbers and lists of them, with None in place of NaN."""
    if values is None:
        return None
    known = np.asarray(values, float)
    if known.ndim == 0:
        return float(known) if np.isfinite(known) else None
    return [_numbers(part) for part in known]


def read_intrinsics(path: PathLike) -> Intrinsics:
    """Read what `write_intrinsics` wrote.

    Parameters
    ----------
    path : path-like
        The JSON file.

    Returns
    -------
    Intrinsics
        The camera.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another kind or version, or describes no camera.

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
    words = _parsed(path)
    if words.get("format") != FORMAT:
        _refuse(path, f"is no file of intrinsics, whose format is {FORMAT!r}: 'clplen calibrate'")
    if words.get("version") != VERSION:
        raise FormatError(
            f"{path} is of version {words.get('version')!r}, and version {VERSION} is known: take "
            "a newer clplen, or calibrate again."
        )
    missing = [name for name in ("views", "pixels", "matrix", "distortion") if name not in words]
    if missing:
        _refuse(path, f"has no {' and no '.join(map(repr, missing))}: the file is incomplete;")
    try:
        return _made(path, words)
    except (ValueError, ShapeError, OverflowError) as error:
        raise FormatError(f"{path} describes no camera: {error}") from error


def _refuse(path: Path, what: str) -> NoReturn:
    raise FormatError(f"{path} {what} makes one from light fields of a checkerboard.")


def _parsed(path: Path) -> _Words:
    """The object of a JSON file."""

    def constant(name: str) -> NoReturn:
        raise FormatError(f"{path} holds {name}, which is no number: calibrate again.")

    if path.exists():
        require_file(path, "file of intrinsics")
    try:
        if path.stat().st_size > _LARGEST:
            raise FormatError(f"{path} is larger than any file of intrinsics: name another.")
        text = path.read_text(encoding="utf-8")
        words = json.loads(text, parse_constant=constant)
    except OSError as error:
        raise FormatError(f"The intrinsics {path} cannot be read ({error}).") from error
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path} is no JSON ({error}): name a file of intrinsics.") from error
    if not isinstance(words, dict):
        _refuse(path, "is no file of intrinsics: 'clplen calibrate'")
    return words


def _made(path: Path, words: _Words) -> Intrinsics:
    """The camera of a file whose keys are there."""
    bent = words["distortion"]
    if not isinstance(bent, dict) or set(bent) != set(_DISTORTION):
        raise ValueError(f"its distortion is {', '.join(_DISTORTION)}, each once.")
    board, spacing, rms = (words.get(name) for name in ("board", "spacing", "rms"))
    if spacing is not None and not (is_finite(spacing) and spacing > 0):
        raise ValueError(f"its spacing is positive, in metres, not {spacing!r}.")
    if rms is not None and not (is_finite(rms) and rms >= 0):
        raise ValueError(f"its rms is a number of pixels, not {rms!r}.")
    boards = _array("board_rms", words.get("board_rms"))
    if boards is not None and boards.ndim != 1:
        raise ValueError("its board_rms is a list of numbers.")
    views, pixels = (_pair(name, words[name]) for name in ("views", "pixels"))
    matrix = _array("matrix", words["matrix"])
    assert matrix is not None
    return Intrinsics(
        matrix,
        np.array([_number(name, bent[name]) for name in _DISTORTION]),
        (*views, *pixels),
        float("nan") if rms is None else float(rms),
        None if board is None else _pair("board", board),
        None if spacing is None else float(spacing),
        boards,
        _array("view_rms", words.get("view_rms")),
        _array("deviations", words.get("deviations")),
    )


def _pair(name: str, value: Any) -> tuple[int, int]:
    """Two whole numbers from 1 on."""
    if not isinstance(value, list) or len(value) != 2 or not all(map(is_integer, value)):
        raise ValueError(f"its {name} are two whole numbers, not {value!r}.")
    if min(value) < 1:
        raise ValueError(f"its {name} are two whole numbers from 1 on, not {value!r}.")
    return int(value[0]), int(value[1])


def _number(name: str, value: Any) -> float:
    if not is_finite(value) or isinstance(value, bool):
        raise ValueError(f"its {name} is a finite number, not {value!r}.")
    return float(value)


def _array(name: str, value: Any) -> np.ndarray[Any, Any] | None:
    """An array of numbers, NaN where the file has null; None of nothing."""
    if value is None:
        if name == "matrix":
            raise ValueError("its matrix is empty.")
        return None
    try:
        return float64_array(value)
    except (TypeError, ValueError):
        raise ValueError(f"its {name} is an array of numbers.") from None
