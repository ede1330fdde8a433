"""Lattices of lenslets as JSON: our own form, and LensletGridModel of LFToolbox."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from clplen.errors import FormatError
from clplen.outputs import MARK

if TYPE_CHECKING:
    from clplen.lightfield.raw.lenslet_lattice import Lattice

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
    """What `Lattice` takes, by name, from JSON of either form.

    Raises
    ------
    FormatError
        Naming the source and the entry.
    """
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
        if min(ny, nx) < 1 or int(ny) != ny or int(nx) != nx:
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
