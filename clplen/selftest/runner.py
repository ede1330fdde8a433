"""Run all checks in order, in this process or in a child, which a faulty driver may end.

A child reports in lines of JSON: ["facts", {...}], ["begin", name], ["result", {...}].
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
from time import perf_counter
from typing import IO, Any

from clplen.compute.device import Device
from clplen.errors import ClplenError
from clplen.selftest import basics, depth, frames, optics, views, waves
from clplen.selftest.check import Check, CheckResult, run_check, sentence_of
from clplen.selftest.report import DeviceReport, device_facts, environment

Watch = Callable[[CheckResult], None]

CHECKS: tuple[Check, ...] = (
    *basics.CHECKS,
    *waves.CHECKS,
    *optics.CHECKS,
    *views.CHECKS,
    *depth.CHECKS,
    *frames.CHECKS,
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
Message = tuple[str, Any]


def run_isolated(
    device: Device, *, names: Iterable[str] | None = None, watch: Watch | None = None
) -> DeviceReport:
    """Run the checks in child processes, which a faulty driver may end.

    A check that ends its child is reported as failed, and another child goes on with the next one.
    """
    left, start = [check.name for check in chosen(names)], perf_counter()
    report = DeviceReport(device_facts(device))

    def add(result: CheckResult) -> None:
        report.results.append(result)
        if watch is not None:
            watch(result)

    while left:
        current = OPENING
        with tempfile.TemporaryFile() as errors, _child(device.place, left, errors) as child:
            try:
                for kind, value in _messages(child):
                    if kind == "facts":
                        report.facts |= value
                    elif kind == "begin":
                        (current,) = chosen([value])
                    else:
                        add(_read(value))
                        left = left[1:] if current is not OPENING else []
            except BaseException:
                child.kill()
                raise
            if left:
                add(_failure(current, _last_words(child.wait(), errors)))
                left = left[1:] if current is not OPENING else []
    report.seconds = perf_counter() - start
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


def _child(place: str, names: list[str], errors: IO[bytes]) -> subprocess.Popen[bytes]:
    paths = [os.environ.get("PYTHONPATH"), *(path or os.getcwd() for path in sys.path)]
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
