"""Checkpoints of long averages: what was reached, and of which set-up."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike, check_writable, replacing

FORMAT = "clplen average 1"
SetUp = Mapping[str, str]
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")  # of an object, another in every process


@dataclass(frozen=True, eq=False)
class State:
    """How far an average has come.

    Attributes
    ----------
    mean, m2 : numpy.ndarray
        As in `Statistics`.
    count : int
    convergence : numpy.ndarray
        float64, shape (n, 2): snapshots, standard error over mean.
    """

    mean: np.ndarray[Any, Any]
    m2: np.ndarray[Any, Any]
    count: int
    convergence: np.ndarray[Any, Any]


def fingerprint(value: Any) -> str:
    """What decides a result, as text that is the same in every process.

    Of arrays a digest, of data classes their fields, of a function its name: what it encloses is
    not seen.

    Parameters
    ----------
    value : object

    Returns
    -------
    str
    """
    if isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()[:16]
        return f"array({value.shape}, {value.dtype}, {digest})"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = (
            f"{field.name}={fingerprint(getattr(value, field.name))}"
            for field in dataclasses.fields(value)
        )
        return f"{type(value).__name__}({', '.join(parts)})"
    if isinstance(value, list | tuple):
        return f"({', '.join(fingerprint(one) for one in value)})"
    if isinstance(value, partial):
        return f"{fingerprint(value.func)}({fingerprint(sorted(value.keywords.items()))})"
    name = getattr(value, "__qualname__", None)
    return name if name is not None else _ADDRESS.sub("", repr(value))


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
    heading = {"format": FORMAT, "count": state.count, "setup": dict(setup)}
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
                f"The checkpoint {target} is of another set-up: its {name} is {then}, this run's "
                f"is {now}. Name another file, or remove this one to start anew."
            )
    return state


def _read(target: Path) -> tuple[State, dict[str, str]]:
    try:
        with target.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            text = str(file["heading"])
            heading = json.loads(text)
            state = State(file["mean"], file["m2"], int(heading["count"]), file["convergence"])
            whole = str(file["digest"]) == _digest(text, state)
            known, found = heading["format"] == FORMAT, dict(heading["setup"])
    except Exception as error:  # whatever a broken archive makes its readers say
        raise FormatError(f"{_damaged(target)} ({type(error).__name__}: {error})") from error
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
