"""Fastest form of a kernel on a device: timed once for each class of problems, stored on disk."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Protocol

from clplen.compute.drivers.environment import cache_dir, keep_json
from clplen.compute.drivers.forked import Guard
from clplen.compute.drivers.program import kernel_source
from clplen.errors import warn_caller

FILE = "tuning.json"
_FORMAT = "clplen tuning 1"
_BUDGET = 1.0  # maximum seconds for timing all forms of a kernel
_ROUNDS = 2  # timings of each form, of which the shortest counts


class TimedDevice(Protocol):
    """Device on which forms of kernels are timed."""

    name: str
    driver: str

    def finish(self) -> None:
        """Wait until all enqueued work is done."""


class Tuning:
    """Fastest forms of kernels on a device; they change speed, never results.

    The file ``tuning.json`` in the user's cache folder stores them by device, driver, kernel text
    and problem class. ``CLPLEN_TUNING=off`` disables timing and reading and selects the form
    expected to be fastest.
    """

    def __init__(self, device: TimedDevice) -> None:
        self._device = device
        self._lock = Guard()
        self._labels: dict[str, str] | None = None
        self.set_aside: dict[str, str] = {}  # forms that fail on the device, with the reason

    @property
    def enabled(self) -> bool:
        """True if forms are timed and stored."""
        return os.environ.get("CLPLEN_TUNING", "").lower() != "off"

    @property
    def note(self) -> str:
        """Summary of the excluded forms, or an empty string."""
        return "; ".join(f"without {form} ({why})" for form, why in self.set_aside.items())

    def leave(self, form: str, error: Exception) -> None:
        """Exclude a form that the device cannot run."""
        self.set_aside[form] = (str(error).splitlines() or [type(error).__name__])[0]

    def lookup(self, file: str, problem: str, labels: Sequence[str]) -> str | None:
        """Return the stored label of the fastest form for a class of problems, if still offered."""
        if not self.enabled:
            return None
        with self._lock:
            if self._labels is None:
                self._labels = _read(cache_dir() / FILE)
            label = self._labels.get(self._key(file, problem))
        return label if label in labels else None

    def fastest(
        self, file: str, problem: str, labels: Sequence[str], run: Callable[[str], float]
    ) -> str:
        """Return the label of the fastest form; time all forms if none is stored."""
        if not self.enabled or len(labels) < 2:
            return labels[0]
        with self._lock:
            stored = self.lookup(file, problem, labels)
            if stored is not None:  # another thread timed the forms while this thread waited
                return stored
            start, best = perf_counter(), dict.fromkeys(labels, float("inf"))
            for _ in range(_ROUNDS):
                for label in labels:
                    if perf_counter() - start < _BUDGET:
                        best[label] = min(best[label], self._seconds(label, run))
            label = min(labels, key=lambda form: best[form])
            self._keep(self._key(file, problem), label)
            return label

    def _seconds(self, label: str, run: Callable[[str], float]) -> float:
        """Return the seconds per unit of work for a part of the work."""
        self._device.finish()
        start = perf_counter()
        amount = run(label)
        self._device.finish()
        return (perf_counter() - start) / amount

    def _key(self, file: str, problem: str) -> str:
        digest = hashlib.sha256(kernel_source(file).encode()).hexdigest()[:12]
        return " | ".join((self._device.name, self._device.driver, f"{file} {digest}", problem))

    def _keep(self, key: str, label: str) -> None:
        """Add a label to the file; if writing fails, keep it for this process only."""
        path = cache_dir() / FILE
        labels = {**_read(path, warn=False), **(self._labels or {}), key: label}
        self._labels = labels
        keep_json(path, {"format": _FORMAT, "found": labels})


def _read(path: Path, *, warn: bool = True) -> dict[str, str]:
    """Read the labels of a file; return none if it is missing or, with a warning, invalid."""
    try:
        content = json.loads(path.read_text("utf-8"))
        labels = content["found"] if content["format"] == _FORMAT else None
        if not isinstance(labels, dict) or not all(isinstance(v, str) for v in labels.values()):
            raise TypeError
    except OSError:
        return {}
    except (ValueError, KeyError, TypeError, RecursionError):
        if warn:
            message = f"{path} is not a tuning cache of this version; it is ignored and rewritten."
            warn_caller(message, RuntimeWarning)
        return {}
    return labels
