"""The fastest form of a kernel on a device: timed once for a class of problems, kept on disk."""

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
_BUDGET = 1.0  # seconds of one tuning
_ROUNDS = 2


class TimedDevice(Protocol):
    """What forms of kernels are timed on."""

    name: str
    driver: str

    def finish(self) -> None:
        """Wait until everything enqueued is done."""


class Tuning:
    """What was found fastest on one device; it changes speed, never results.

    Findings lie in ``tuning.json`` of the user's cache folder, by device, driver, text of the
    kernel and class of problem. ``CLPLEN_TUNING=off`` takes what is expected to be fastest, times
    nothing and reads nothing.
    """

    def __init__(self, device: TimedDevice) -> None:
        self._device = device
        self._lock = Guard()
        self._known: dict[str, str] | None = None
        self.set_aside: dict[str, str] = {}  # forms that the device could not run, and why

    @property
    def enabled(self) -> bool:
        """Whether forms are timed and remembered."""
        return os.environ.get("CLPLEN_TUNING", "").lower() != "off"

    @property
    def note(self) -> str:
        """One sentence on forms that were set aside, or nothing."""
        return "; ".join(f"without {form} ({why})" for form, why in self.set_aside.items())

    def leave(self, form: str, error: Exception) -> None:
        """Remember that the device cannot run a form."""
        self.set_aside[form] = (str(error).splitlines() or [type(error).__name__])[0]

    def found(self, file: str, problem: str, labels: Sequence[str]) -> str | None:
        """Return the fastest label for this class of problem, if it is known and still offered."""
        if not self.enabled:
            return None
        with self._lock:
            if self._known is None:
                self._known = _read(cache_dir() / FILE)
            label = self._known.get(self._key(file, problem))
        return label if label in labels else None

    def fastest(
        self, file: str, problem: str, labels: Sequence[str], run: Callable[[str], float]
    ) -> str:
        """The fastest form: what is known, else every form is timed, in turn, and it is kept."""
        if not self.enabled or len(labels) < 2:
            return labels[0]
        with self._lock:
            known = self.found(file, problem, labels)
            if known is not None:  # by another thread, which this one waited for
                return known
            start, best = perf_counter(), dict.fromkeys(labels, float("inf"))
            for _ in range(_ROUNDS):
                for label in labels:
                    if perf_counter() - start < _BUDGET:
                        best[label] = min(best[label], self._seconds(label, run))
            label = min(labels, key=lambda one: best[one])
            self._keep(self._key(file, problem), label)
            return label

    def _seconds(self, label: str, run: Callable[[str], float]) -> float:
        """Of one part of the work, for each unit of it."""
        self._device.finish()
        start = perf_counter()
        amount = run(label)
        self._device.finish()
        return (perf_counter() - start) / amount

    def _key(self, file: str, problem: str) -> str:
        digest = hashlib.sha256(kernel_source(file).encode()).hexdigest()[:12]
        return " | ".join((self._device.name, self._device.driver, f"{file} {digest}", problem))

    def _keep(self, key: str, label: str) -> None:
        """Add a finding to those of other processes; where nothing can be written, for this one."""
        path = cache_dir() / FILE
        known = {**_read(path, warn=False), **(self._known or {}), key: label}
        self._known = known
        keep_json(path, {"format": _FORMAT, "found": known})


def _read(path: Path, *, warn: bool = True) -> dict[str, str]:
    """What a file holds; nothing where it is not there, and nothing, with a warning, if foreign."""
    try:
        held = json.loads(path.read_text("utf-8"))
        found = held["found"] if held["format"] == _FORMAT else None
        if not isinstance(found, dict) or not all(isinstance(v, str) for v in found.values()):
            raise TypeError
    except OSError:
        return {}
    except (ValueError, KeyError, TypeError, RecursionError):
        if warn:
            message = f"{path} is no tuning cache of this version: ignored, and later written anew."
            warn_caller(message, RuntimeWarning)
        return {}
    return found
