"""All checks in order, in this process or in children: a faulty driver ends one of them only.

Kernels are compiled on one core each, so that several children are done sooner, too. A child says
what it does in lines of JSON: ["facts", {...}], ["begin", name], ["result", {...}].
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from queue import SimpleQueue
from threading import Event, Thread
from time import perf_counter
from typing import IO, Any

from clplen.compute.device import Device
from clplen.errors import ClplenError
from clplen.selftest import adjoints, basics, depth, frames, gradients, optics, views, waves
from clplen.selftest.check import Check, CheckResult, run_check, sentence_of
from clplen.selftest.report import DeviceReport, device_facts, environment

Watch = Callable[[CheckResult], None]

CHECKS: tuple[Check, ...] = (
    *basics.CHECKS,
    *waves.CHECKS,
    *optics.CHECKS,
    *gradients.CHECKS,
    *views.CHECKS,
    *depth.CHECKS,
    *depth.MATCHING_CHECKS,
    *frames.CHECKS,
    *optics.SCENE_CHECKS,
    *frames.VOLUME_CHECKS,
    *adjoints.CHECKS,
)


def run_checks(
    device: Device, *, names: Iterable[str] | None = None, watch: Watch | None = None
) -> list[CheckResult]:
    """Compare what a device computes with float64 NumPy, in this process."""
    results = []
    for check in chosen(names):
        results.append(run_check(check, device))
        if watch is not None:
            watch(results[-1])
    return results


def chosen(names: Iterable[str] | None) -> list[Check]:
    """The checks of these names, in order; None: all."""
    if names is None:
        return list(CHECKS)
    wanted = set(names)
    unknown = sorted(wanted - {check.name for check in CHECKS})
    if unknown:
        raise ValueError(f"There is no check {unknown[0]!r}.")
    return [check for check in CHECKS if check.name in wanted]


OPENING = Check("opening", "the device opens and compiles a kernel", lambda device: (), 0.0)
MOST_CHILDREN = 4
Message = tuple[str, Any]


def run_isolated(
    device: Device, *, names: Iterable[str] | None = None, watch: Watch | None = None
) -> DeviceReport:
    """`run_checks` in child processes, which a faulty driver may end.

    A check that ends its child is reported as failed, and another child goes on with the next one.
    """
    wanted, start = [check.name for check in chosen(names)], perf_counter()
    count = max(1, min(MOST_CHILDREN, os.cpu_count() or 1, len(wanted)))
    shares = [wanted[k::count] for k in range(count)]
    crew = _Crew(device.place)
    crew.begin(shares[:1])  # the others when that has opened the device: once is enough to find out
    report = DeviceReport(device_facts(device))
    ordered = _Ordered([OPENING.name, *wanted], watch)
    try:
        while crew.at_work:
            kind, value = crew.inbox.get()
            if kind == "end":
                crew.at_work -= 1
            elif kind == "facts":
                report.facts |= value
                crew.begin(shares[1:])
                del shares[1:]
            else:
                ordered.add(value)
    except BaseException:
        crew.stop()
        raise
    report.results, report.seconds = ordered.finish(), perf_counter() - start
    return report


def numbers_of(reports: Iterable[DeviceReport]) -> dict[str, Any]:
    """Reports of devices and where they were made, ready for JSON."""
    devices = [
        {
            "facts": report.facts,
            "seconds": report.seconds,
            "results": [_written(result) for result in report.results],
        }
        for report in reports
    ]
    return {"environment": environment(), "devices": devices}


class _Ordered:
    """Results that come in any order, passed on in that of the checks."""

    def __init__(self, names: list[str], watch: Watch | None) -> None:
        self._names, self._watch = names, watch
        self._found: dict[str, CheckResult] = {}
        self._passed = 1  # "opening" is a result only if it failed

    def add(self, result: CheckResult) -> None:
        if result.name == OPENING.name and OPENING.name not in self._found:
            self._tell(result)
        self._found[result.name] = result
        while self._passed < len(self._names) and self._names[self._passed] in self._found:
            self._tell(self._found[self._names[self._passed]])
            self._passed += 1

    def finish(self) -> list[CheckResult]:
        """All results, in order; those behind one that is missing are passed on now."""
        for name in self._names[self._passed :]:
            if name in self._found:
                self._tell(self._found[name])
        return [self._found[name] for name in self._names if name in self._found]

    def _tell(self, result: CheckResult) -> None:
        if self._watch is not None:
            self._watch(result)


class _Crew:
    """Threads that each keep one child at work on a part of the checks."""

    def __init__(self, place: str) -> None:
        self.inbox: SimpleQueue[Message] = SimpleQueue()
        self.at_work = 0
        self._place = place
        self._children: list[subprocess.Popen[bytes]] = []
        self._stopped = Event()

    def begin(self, shares: Iterable[list[str]]) -> None:
        """Let one more thread work on each of some parts of the checks."""
        for names in shares:
            self.at_work += 1
            Thread(target=self._work, args=(names,), daemon=True).start()

    def stop(self) -> None:
        """End all children, and let none begin."""
        self._stopped.set()
        for child in self._children:
            child.kill()

    def _work(self, names: list[str]) -> None:
        """Have some checks done, by as many children as it takes."""
        try:
            while names and not self._stopped.is_set():
                names = self._served(names)
        finally:
            self.inbox.put(("end", None))

    def _served(self, names: list[str]) -> list[str]:
        """One child's work; the names that are left."""
        begun, by_name = OPENING.name, {check.name: check for check in (OPENING, *CHECKS)}
        with tempfile.TemporaryFile() as errors:
            child = _child(self._place, names, errors)
            self._children.append(child)
            for kind, value in _messages(child):
                if kind == "facts":
                    self.inbox.put((kind, value))
                elif kind == "begin":
                    begun = value
                else:
                    self.inbox.put((kind, _read(value)))
                    names = names[1:] if begun == value["name"] != OPENING.name else []
            if names:
                failure = _failure(by_name[begun], _last_words(child.returncode, errors))
                self.inbox.put(("result", failure))
        return [] if begun == OPENING.name else names[1:]


def _child(place: str, names: list[str], errors: IO[bytes]) -> subprocess.Popen[bytes]:
    paths = [os.environ.get("PYTHONPATH", ""), *sys.path]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "PYTHONSAFEPATH": "1",  # no module of the folder in which it is started
    }
    command = [sys.executable, "-W", "ignore", "-m", "clplen.selftest", place, *names]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=errors)


def _messages(child: subprocess.Popen[bytes]) -> Iterator[Message]:
    """What a child says, until it ends; other output of its drivers is passed over."""
    assert child.stdout is not None
    with child.stdout:
        for line in child.stdout:
            try:
                kind, value = json.loads(line)
            except (ValueError, TypeError):
                continue
            yield kind, value
    child.wait()


def _last_words(status: int, errors: IO[bytes]) -> str:
    """Why a child ended, with the last line that it or its driver wrote."""
    errors.seek(0)
    lines = [line.strip() for line in errors.read().decode(errors="replace").splitlines()]
    said = next((line for line in reversed(lines) if line), "")
    how = f"the process ended with status {status}"
    if status < 0:
        known = {int(one): one.name for one in signal.Signals}
        how = f"the process was ended by {known.get(-status, f'signal {-status}')}"
    return f"{how}: {said}" if said else how


# The child's part


def serve(place: str, names: Iterable[str]) -> None:
    """Check one device, and say whatever happens."""
    from clplen.compute.device import Device

    try:
        device = Device.open(place)
    except ClplenError as error:
        _say("result", _written(_failure(OPENING, sentence_of(error))))
        return
    _say("facts", device_facts(device, is_open=True))
    for check in chosen(names):
        _say("begin", check.name)
        _say("result", _written(run_check(check, device)))


def _failure(check: Check, reason: str) -> CheckResult:
    """Of a check that did not come to its end."""
    about = (check.name, check.compared, check.files, math.nan, check.tolerance)
    return CheckResult(*about, "FAILED", reason, 0.0)


def _written(result: CheckResult) -> dict[str, Any]:
    """A result as JSON has it, without NaN and infinity."""
    return asdict(result) | {"error": result.error if math.isfinite(result.error) else None}


def _read(values: dict[str, Any]) -> CheckResult:
    error = math.nan if values["error"] is None else values["error"]
    return CheckResult(**values | {"error": error, "files": tuple(values["files"])})


def _say(kind: str, value: Any) -> None:
    print(json.dumps([kind, value]), flush=True)
