"""Sources, tasks and reports of items: small records that are sent to workers."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from clplen.files import is_plain_name
from clplen.reprs import OneLine

_INT64 = 1 << 63  # upper bound of file sizes and times
_MAX_NESTING = 64  # levels of a report; camera files, its deepest part, have fewer than ten


@dataclass(frozen=True, repr=False)
class Task(OneLine):
    """Light field and the operations on it.

    ``source`` describes the light field: ``kind`` "file" with ``path`` and ``layout``, or "camera"
    or "scene" with the content of its file. ``files`` are relative to ``base``.
    """

    name: str
    folder: str
    source: dict[str, Any]
    work: dict[str, Any]
    base: str = "."
    files: tuple[str, ...] = ()

    @property
    def parameters(self) -> str:
        """Digest of all settings that affect the result, without the content of the files."""
        text = json.dumps([self.source, self.work], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, repr=False)
class Report(OneLine):
    """Outcome of a task.

    Attributes
    ----------
    name : str
        Name of the item.
    state : {"done", "failed"}
    parameters : str
        Digest of the settings of the task.
    inputs : dict
        Properties of each file: ``bytes``, ``changed`` (time, nanoseconds) and ``sha256``.
    outputs : dict
        Properties of each file or folder in the item's folder: ``bytes`` and ``sha256``.
    seconds : dict
        Time of each stage in seconds; ``total`` is the sum.
    started : float
        Start, in seconds since 1970.
    device, software, worker : str
    settings : dict
        Source and work of the task.
    error : str
        Error message in one sentence; empty on success.
    passing : bool
        True if the error may be temporary.
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
        """Return the report as JSON text."""
        return json.dumps(asdict(self), sort_keys=True, indent=1)

    @classmethod
    def from_json(cls, text: str) -> Report:
        """Read a report of unknown origin; raise ValueError if it is damaged or names a folder."""
        try:
            content = json.loads(text)
            report = cls(**content)
        except (TypeError, RecursionError) as error:
            raise ValueError(f"The file is not a report: {error}.") from error
        blank = cls("", "", "", 0.0)
        if not (
            all(type(getattr(report, f.name)) is type(getattr(blank, f.name)) for f in fields(cls))
            and all(map(_is_finite, (report.started, *report.seconds.values())))
            and all(_has_stamp(entry, "bytes", "changed") for entry in report.inputs.values())
            and all(_has_stamp(entry, "bytes") for entry in report.outputs.values())
            and all(map(is_plain_name, report.outputs))
            and (report.outputs or report.state != "done")
            and _is_shallow(content, _MAX_NESTING)
        ):
            raise ValueError(
                "The file is not a report: a value has a wrong type, or a name leaves the folder."
            )
        "".join((report.device, report.software, report.worker)).encode()  # rejects surrogates
        return report


def _is_finite(value: object) -> bool:
    return type(value) is float and math.isfinite(value)


def _has_stamp(entry: Any, *names: str) -> bool:
    """Return True if the entry of a file has a digest and integers with these names."""
    if type(entry) is not dict or type(entry.get("sha256")) is not str:
        return False
    numbers = [entry.get(name) for name in names]
    return all(type(number) is int and abs(number) < _INT64 for number in numbers)


def _is_shallow(value: Any, levels: int) -> bool:
    """Return True if JSON data are nested at most ``levels`` deep."""
    inner = value.values() if type(value) is dict else value if type(value) is list else ()
    return levels > 0 and all(_is_shallow(entry, levels - 1) for entry in inner)


@dataclass(frozen=True)
class Source:
    """Light field of a job: its settings (without the content of files) and its files."""

    name: str
    origin: dict[str, Any]
    files: tuple[str, ...] = ()
