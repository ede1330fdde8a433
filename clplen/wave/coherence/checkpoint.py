"""Checkpoints of long averages: what was reached, and of which set-up."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike, check_writable, replacing

FORMAT = "clplen average 1"
SetUp = Mapping[str, str]
SHOWN = 160  # characters of a long text in a message


@dataclass(frozen=True, eq=False)
class State:
    """How far an average has come.

    Attributes
    ----------
    mean, m2 : numpy.ndarray
        As in `Statistics`.
    count : int
    unit : float
    convergence : numpy.ndarray
        float64, shape (n, 2): snapshots, standard error over mean.
    """

    mean: np.ndarray[Any, Any]
    m2: np.ndarray[Any, Any]
    count: int
    unit: float
    convergence: np.ndarray[Any, Any]


def fingerprint(value: Any) -> str:
    """What decides a result, as text that is the same in every process.

    Of arrays a digest, of data classes and other objects their fields, of a function its module and
    name, its defaults and what it encloses.

    Parameters
    ----------
    value : object

    Returns
    -------
    str
    """
    if isinstance(value, bool | np.bool_ | str | bytes | None):
        return repr(value)
    if isinstance(value, int | float | complex | np.number):
        return repr(value.item() if isinstance(value, np.number) else value)
    if isinstance(value, np.ndarray | cla.Array):
        values = np.ascontiguousarray(value.get() if isinstance(value, cla.Array) else value)
        digest = hashlib.sha256(values.tobytes()).hexdigest()[:16]
        return f"array({values.shape}, {values.dtype}, {digest})"
    if isinstance(value, list | tuple):
        return f"({', '.join(fingerprint(one) for one in value)})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {fingerprint(one)}' for key, one in value.items())}}}"
    if isinstance(value, partial | MethodType | FunctionType):
        return _of_function(value)
    if isinstance(value, Device):
        return f"{value.name}, {value.driver}, {value.precision}"
    named = [pair for pair in getattr(value, "__dict__", {}).items() if pair[0][0] != "_"]
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        named = [(name, getattr(value, name, None)) for name in names]
    parts = [f"{name}={fingerprint(one)}" for name, one in named]
    name = value.__qualname__ if isinstance(value, type) else type(value).__qualname__
    return f"{name}({', '.join(parts)})"


def _of_function(value: partial[Any] | MethodType | FunctionType) -> str:
    if isinstance(value, partial):
        return f"{fingerprint(value.func)}({fingerprint((value.args, value.keywords))})"
    if isinstance(value, MethodType):
        return f"{fingerprint(value.__self__)}.{value.__name__}"
    cells = [cell.cell_contents for cell in value.__closure__ or ()]
    inside = fingerprint((value.__defaults__, value.__kwdefaults__, cells))
    code = hashlib.sha256(value.__code__.co_code + repr(_constants(value)).encode())
    return f"{value.__module__}.{value.__qualname__}({code.hexdigest()[:8]}, {inside})"


def _constants(function: FunctionType) -> list[Any]:
    """Plain constants of a function's code: numbers and words, not code objects."""
    plain = (bool, int, float, complex, str, bytes, type(None))
    return [one for one in function.__code__.co_consts if isinstance(one, plain)]


def save(path: PathLike, state: State, setup: SetUp) -> None:
    """Write a checkpoint, whole or not at all.

    Parameters
    ----------
    path : path-like
    state : State
    setup : mapping of str to str
        Everything that decides the result, name by name.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    heading = {"format": FORMAT, "count": state.count, "unit": state.unit, "setup": dict(setup)}
    text = json.dumps(heading)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            heading=np.array(text),
            mean=state.mean,
            m2=state.m2,
            convergence=state.convergence,
            digest=np.array(_digest(text, state)),
        )
        file.flush()
        os.fsync(file.fileno())


def load(path: PathLike, setup: SetUp) -> State | None:
    """Read a checkpoint of this set-up; None where there is no file.

    Parameters
    ----------
    path : path-like
    setup : mapping of str to str

    Returns
    -------
    State or None

    Raises
    ------
    FormatError
        If the file is damaged, no checkpoint, or one of another set-up; naming the first
        difference.
    OSError
        If the file could not be written later.
    """
    target = check_writable(path)
    if not target.exists():
        return None
    state, found = _read(target)
    for name in dict.fromkeys([*setup, *found]):
        then, now = found.get(name, "nothing"), setup.get(name, "nothing")
        if then != now:
            raise FormatError(
                f"The checkpoint {target} is of another set-up: its {name} is "
                f"{_around(then, now)}, this run's is {_around(now, then)}. Name another file, or "
                "remove this one to start anew."
            )
    return state


def verify(path: PathLike) -> None:
    """Refuse a file that cannot be written or is there and is no whole checkpoint.

    Raises
    ------
    FormatError, OSError
        As `load`.
    """
    target = check_writable(path)
    if target.exists():
        _read(target)


def _around(text: str, other: str) -> str:
    """A text, or what is next to its first difference from another."""
    if len(text) <= SHOWN:
        return text
    pairs = zip(text, other, strict=False)
    first = next((i for i, (a, b) in enumerate(pairs) if a != b), min(len(text), len(other)))
    start = max(0, first - SHOWN // 2)
    return f"... {text[start : start + SHOWN]} ..."


def _read(target: Path) -> tuple[State, dict[str, str]]:
    try:
        with target.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            text = str(file["heading"])
            heading = json.loads(text)
            state = State(
                file["mean"],
                file["m2"],
                int(heading["count"]),
                float(heading["unit"]),
                file["convergence"],
            )
            whole = str(file["digest"]) == _digest(text, state)
            known, found = heading["format"] == FORMAT, dict(heading["setup"])
    except Exception as error:  # whatever a broken archive makes its readers say
        raise FormatError(f"{_damaged(target)}.") from error
    if not (whole and known):
        raise FormatError(_damaged(target) + ": its contents and their digest disagree")
    return state, found


def _damaged(target: Path) -> str:
    return (
        f"The checkpoint {target} is damaged or no checkpoint; remove it to start anew, or name "
        "another file"
    )


def _digest(text: str, state: State) -> str:
    sha = hashlib.sha256(text.encode())
    for values in (state.mean, state.m2, state.convergence):
        sha.update(f"{values.shape}{values.dtype.str}".encode())
        sha.update(np.ascontiguousarray(values).tobytes())
    return sha.hexdigest()
