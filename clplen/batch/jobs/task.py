"""Sources, tasks and reports of items, as they travel to workers: no arrays."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from typing import Any

from clplen.reprs import OneLine


@dataclass(frozen=True, repr=False)
class Task(OneLine):
    """One light field and what is made of it.

    Attributes
    ----------
    name : str
        Of the item: its folder below the job's output.
    folder : str
        Of the job's output, absolute.
    source : dict
        Where the light field comes from: ``kind`` "file" with ``path`` and ``layout``, "camera" or
        "scene" with what `clplen.batch.work.simulation` makes them of.
    work : dict
        What is made, by the names of the job's tables; and ``formats``.
    base : str
        Folder of the job file, from where names of files are seen.
    files : tuple of str
        Files and folders that are read, seen from ``base``.

    Examples
    --------
    >>> task = clplen.batch.Task(
    ...     "a", "/data/out", {"kind": "file", "path": "a.h5", "layout": {}},
    ...     {"stack": {"disparities": [-1.0, 0.0, 1.0]}, "formats": ["ome-tiff"]}, files=("a.h5",))
    >>> task.name, task.base, len(task.parameters)
    ('a', '.', 64)
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

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> from pathlib import Path
    >>> task = clplen.batch.Task(
    ...     "a", str(Path("out").absolute()), {"kind": "file", "path": "a.npy", "layout": {}},
    ...     {"stack": {"disparities": [-1.0, 0.0, 1.0]}, "formats": ["ome-tiff"]}, files=("a.npy",))
    >>> with clplen.batch.local_executor(Path("out"), selector=None, memory=2**28) as executor:
    ...     [report] = executor.run([task])
    >>> report.name, report.state, list(report.outputs)
    ('a', 'done', ['stack.ome.tif'])
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
        """The inverse of `to_json`.

        Raises
        ------
        ValueError
            If it is none.
        """
        try:
            found = cls(**json.loads(text))
            for entry in (*found.inputs.values(), *found.outputs.values()):
                int(entry["bytes"]), str(entry["sha256"])
            for entry in found.inputs.values():
                int(entry["changed"])
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"It is no report: {error!r}.") from error
        return found


@dataclass(frozen=True)
class Source:
    """One light field of a job.

    Attributes
    ----------
    name : str
        Of its item.
    words : dict
        ``kind`` and all that decides the light field, but for the content of the files.
    files : tuple of str
        What is read, seen from the folder of the job.
    """

    name: str
    words: dict[str, Any]
    files: tuple[str, ...] = ()
