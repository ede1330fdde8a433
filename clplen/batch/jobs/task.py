"""Sources, tasks and reports of items, as they travel to workers: no arrays."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from clplen.files import is_plain_name
from clplen.reprs import OneLine

_INT64 = 1 << 63  # sizes and times of files are below
_MAX_NESTING = 64  # levels of a report; those of camera files, the deepest part, are below ten


@dataclass(frozen=True, repr=False)
class Task(OneLine):
    """One light field and what is made of it.

    ``source`` says where the light field comes from: ``kind`` "file" with ``path`` and ``layout``,
    "camera" or "scene" with the content of its file. ``files`` are seen from ``base``.
    """

    name: str
    folder: str
    source: dict[str, Any]
    work: dict[str, Any]
    base: str = "."
    files: tuple[str, ...] = ()

    @property
    def parameters(self) -> str:
        """A digest of what decides the result, but for the content of the files."""
        text = json.dumps([self.source, self.work], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, repr=False)
class Report(OneLine):
    """What became of a task.

    Attributes
    ----------
    name : str
        Of the item.
    state : {"done", "failed"}
    parameters : str
        As of the task.
    inputs : dict
        Of each file: ``bytes``, ``changed`` (time, nanoseconds) and ``sha256``.
    outputs : dict
        Of each file or folder, by its name in the item's folder: ``bytes`` and ``sha256``.
    seconds : dict
        By stage; ``total`` is all.
    started : float
        Seconds since 1970.
    device, software, worker : str
    settings : dict
        Source and work of the task.
    error : str
        One sentence, if it failed.
    passing : bool
        Whether trying again may help.
    """

    name: str
    state: str
    parameters: str
    started: float
    inputs: dict[str, dict[str, Any]] = field(default_factory=dict)
    outputs: dict[str, dict[str, Any]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    device: str = ""
    software: str = ""
    worker: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    error: str = ""
    passing: bool = False

    def to_json(self) -> str:
        """As text."""
        return json.dumps(asdict(self), sort_keys=True, indent=1)

    @classmethod
    def from_json(cls, text: str) -> Report:
        """Read a report of unknown origin; raise ValueError if it is damaged or names a folder."""
        try:
            content = json.loads(text)
            found = cls(**content)
        except (TypeError, RecursionError) as error:
            raise ValueError(f"It is no report: {error}.") from error
        typical = cls("", "", "", 0.0)
        if not (
            all(type(getattr(found, f.name)) is type(getattr(typical, f.name)) for f in fields(cls))
            and all(map(_is_finite, (found.started, *found.seconds.values())))
            and all(_has_stamp(entry, "bytes", "changed") for entry in found.inputs.values())
            and all(_has_stamp(entry, "bytes") for entry in found.outputs.values())
            and all(map(is_plain_name, found.outputs))
            and (found.outputs or found.state != "done")
            and _is_shallow(content, _MAX_NESTING)
        ):
            raise ValueError("It is no report: a value is of another type, or a name leads away.")
        "".join((found.device, found.software, found.worker)).encode()  # surrogates
        return found


def _is_finite(value: object) -> bool:
    return type(value) is float and math.isfinite(value)


def _has_stamp(entry: Any, *names: str) -> bool:
    """Return whether what is known of a file has a digest and whole numbers of these names."""
    if type(entry) is not dict or type(entry.get("sha256")) is not str:
        return False
    numbers = [entry.get(name) for name in names]
    return all(type(number) is int and abs(number) < _INT64 for number in numbers)


def _is_shallow(value: Any, levels: int) -> bool:
    """Return whether JSON is nested no deeper than so many levels."""
    inner = value.values() if type(value) is dict else value if type(value) is list else ()
    return levels > 0 and all(_is_shallow(one, levels - 1) for one in inner)


@dataclass(frozen=True)
class Source:
    """One light field of a job: what decides it (but for the content of files), what is read."""

    name: str
    words: dict[str, Any]
    files: tuple[str, ...] = ()
