"""Run all checks in order, in this process or in a child that survives driver crashes.

A child reports lines of JSON: ["facts", {...}], ["begin", name], ["result", {...}].
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
    """Compare a device's results with float64 NumPy, in this process."""
    results = []
    for check in selected_checks(names):
        results.append(run_check(check, device))
        if watch is not None:
            watch(results[-1])
    return results


def selected_checks(names: Iterable[str] | None) -> list[Check]:
    """Return the checks of these names, in order; all for None."""
    if names is None:
        return list(CHECKS)
    requested = set(names)
    unknown = sorted(requested - {check.name for check in CHECKS})
    if unknown:
        raise ValueError(f"names must be names of checks, got {unknown[0]!r}.")
    return [check for check in CHECKS if check.name in requested]


OPENING = Check("opening", "the device opens and compiles a kernel", lambda device: (), 0.0)
Message = tuple[str, Any]


def run_isolated(
    device: Device, *, names: Iterable[str] | None = None, watch: Watch | None = None
) -> DeviceReport:
    """Run the checks in child processes, since a faulty driver may crash.

    A check that crashes its child is reported as failed, and a new child continues with the next.
    """
    left, start = [check.name for check in selected_checks(names)], perf_counter()
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
                        (current,) = selected_checks([value])
                    else:
                        add(_read(value))
                        left = left[1:] if current is not OPENING else []
            except BaseException:
                child.kill()
                raise
            if left:
                add(_failure(current, _exit_reason(child.wait(), errors)))
                left = left[1:] if current is not OPENING else []
    report.seconds = perf_counter() - start
    return report


def numbers_of(reports: Iterable[DeviceReport]) -> dict[str, Any]:
    """Return reports of devices and their environment, ready for JSON."""
    devices = [
        {
            "facts": report.facts,
            "seconds": report.seconds,
            "results": [_json_ready(result) for result in report.results],
        }
        for report in reports
    ]
    return {"environment": environment(), "devices": devices}


def _child(selector: str, names: list[str], errors: IO[bytes]) -> subprocess.Popen[bytes]:
    paths = [os.environ.get("PYTHONPATH"), *(path or os.getcwd() for path in sys.path)]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "PYTHONSAFEPATH": "1",  # import nothing from the working directory
    }
    command = [sys.executable, "-W", "ignore", "-m", "clplen.selftest", selector, *names]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=errors)


def _messages(child: subprocess.Popen[bytes]) -> Iterator[Message]:
    """Yield the messages of a child until it ends; skip other output of its drivers."""
    assert child.stdout is not None
    with child.stdout:
        for line in child.stdout:
            try:
                kind, value = json.loads(line)
            except (ValueError, TypeError):
                continue
            yield kind, value


def _exit_reason(status: int, errors: IO[bytes]) -> str:
    """Describe how a child ended, with the last line of its error output."""
    errors.seek(0)
    lines = [line.strip() for line in errors.read().decode(errors="replace").splitlines()]
    last_line = next((line for line in reversed(lines) if line), "")
    text = f"the process ended with status {status}"
    if status < 0:
        names = {int(number): number.name for number in signal.Signals}
        text = f"the process was ended by {names.get(-status, f'signal {-status}')}"
    return f"{text}: {last_line}" if last_line else text


# Child process


def serve(selector: str, names: Iterable[str]) -> None:
    """Check one device and report every result."""
    from clplen.compute.device import Device

    try:
        device = Device.open(selector)
    except ClplenError as error:
        _send("result", _json_ready(_failure(OPENING, sentence_of(error))))
        return
    _send("facts", device_facts(device, is_open=True))
    for check in selected_checks(names):
        _send("begin", check.name)
        _send("result", _json_ready(run_check(check, device)))


def _failure(check: Check, reason: str) -> CheckResult:
    """Return the result of a check that did not finish."""
    about = (check.name, check.compared, check.files, math.nan, check.tolerance)
    return CheckResult(*about, "FAILED", reason, 0.0)


def _json_ready(result: CheckResult) -> dict[str, Any]:
    """Return a result for JSON, without NaN and infinity."""
    return asdict(result) | {"error": result.error if math.isfinite(result.error) else None}


def _read(values: dict[str, Any]) -> CheckResult:
    error = math.nan if values["error"] is None else values["error"]
    return CheckResult(**values | {"error": error, "files": tuple(values["files"])})


def _send(kind: str, value: Any) -> None:
    print(json.dumps([kind, value]), flush=True)
