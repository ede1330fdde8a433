"""All checks, in this process or in one that may die."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import IO, TYPE_CHECKING, Any

from clplen.errors import ClplenError
from clplen.selftest import basics, cues, frames, lenses, scenes, views, volumes, waves
from clplen.selftest.check import Check, CheckResult, run_check, sentence_of
from clplen.selftest.report import device_facts, environment

if TYPE_CHECKING:
    from clplen.compute.device import Device

Watch = Callable[[CheckResult], None]

CHECKS: tuple[Check, ...] = (
    *basics.CHECKS,
    *waves.CHECKS,
    *lenses.CHECKS,
    *views.CHECKS,
    *cues.CHECKS,
    *frames.CHECKS,
    *scenes.CHECKS,
    *volumes.CHECKS,
)
OPENING = Check("opening", "the device opens and compiles a kernel", lambda device: (), 0.0)


@dataclass
class DeviceReport:
    """What the checks found out about one device.

    Attributes
    ----------
    facts : dict of str to str
        The device in words, by what they tell.
    results : list of CheckResult
    """

    facts: dict[str, str]
    results: list[CheckResult] = field(default_factory=list)


def run_checks(
    device: Device, *, names: Iterable[str] | None = None, watch: Watch | None = None
) -> list[CheckResult]:
    """Compare what a device computes with float64 NumPy, in this process.

    Parameters
    ----------
    device : Device
        In single precision.
    names : iterable of str, optional
        Of the checks to run; default all.
    watch : callable, optional
        Called with each result when it is there.

    Returns
    -------
    list of CheckResult
        One for each check, in the order of `CHECKS`; errors are results, not raised.

    Raises
    ------
    ValueError
        If there is no check of a name.
    """
    results = []
    for check in chosen(names):
        results.append(run_check(check, device))
        if watch is not None:
            watch(results[-1])
    return results


def chosen(names: Iterable[str] | None) -> list[Check]:
    """The checks of these names, in order.

    Raises
    ------
    ValueError
    """
    if names is None:
        return list(CHECKS)
    wanted = set(names)
    unknown = sorted(wanted - {check.name for check in CHECKS})
    if unknown:
        raise ValueError(f"There is no check {unknown[0]!r}.")
    return [check for check in CHECKS if check.name in wanted]


def run_isolated(
    device: Device, *, names: Iterable[str] | None = None, watch: Watch | None = None
) -> DeviceReport:
    """`run_checks` in a child process, which a faulty driver may end.

    A check that ends it is reported as failed, and another child goes on with the next one.

    Parameters
    ----------
    device : Device
        Opened by its ``place`` in the child; here only its description is read.
    names, watch
        As of `run_checks`.

    Returns
    -------
    DeviceReport
    """
    report = DeviceReport(device_facts(device))
    left = [check.name for check in chosen(names)]
    by_name = {check.name: check for check in (OPENING, *CHECKS)}

    def keep(result: CheckResult) -> None:
        report.results.append(result)
        if watch is not None:
            watch(result)

    while left:
        begun = OPENING.name
        with tempfile.TemporaryFile() as errors:
            child = _child(device.place, left, errors)
            for kind, value in _messages(child):
                if kind == "facts":
                    report.facts |= value
                elif kind == "begin":
                    begun = value
                elif kind == "result":
                    result = _read(value)
                    left = [] if result.name == OPENING.name else left[1:]
                    keep(result)
            if not left:
                return report
            reason = _last_words(child.returncode, errors)
        keep(_failure(by_name[begun], reason))
        left = [] if begun == OPENING.name else left[1:]
    return report


def as_numbers(reports: Iterable[DeviceReport]) -> dict[str, Any]:
    """Reports of devices and where they were made, ready for JSON."""
    devices = [
        {"facts": report.facts, "results": [_written(result) for result in report.results]}
        for report in reports
    ]
    return {"environment": environment(), "devices": devices}


def serve(place: str, names: Iterable[str]) -> None:
    """The child's part: checks of one device, and a line of JSON for whatever happens.

    Parameters
    ----------
    place : str
        platform:device.
    names : iterable of str
    """
    from clplen.compute.device import Device

    try:
        device = Device.open(place)
        _say("facts", device_facts(device, is_open=True))
    except ClplenError as error:
        _say("result", _written(_failure(OPENING, sentence_of(error))))
        return
    for check in chosen(names):
        _say("begin", check.name)
        _say("result", _written(run_check(check, device)))


def _failure(check: Check, reason: str) -> CheckResult:
    return CheckResult(
        check.name, check.compared, check.files, math.nan, check.tolerance, "FAILED", reason, 0.0
    )


def _written(result: CheckResult) -> dict[str, Any]:
    """A result as JSON has it: no NaN."""
    return asdict(result) | {"error": result.error if math.isfinite(result.error) else None}


def _read(values: dict[str, Any]) -> CheckResult:
    error = math.nan if values["error"] is None else values["error"]
    return CheckResult(**values | {"error": error, "files": tuple(values["files"])})


def _say(kind: str, value: Any) -> None:
    print(json.dumps([kind, value]), flush=True)


def _child(place: str, names: list[str], errors: IO[bytes]) -> subprocess.Popen[bytes]:
    paths = [os.environ.get("PYTHONPATH", ""), *sys.path]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    command = [sys.executable, "-W", "ignore", "-m", "clplen.selftest", place, *names]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=errors)


def _messages(child: subprocess.Popen[bytes]) -> Iterator[tuple[str, Any]]:
    """What a child says, until it ends; other output of its drivers is passed over."""
    assert child.stdout is not None
    try:
        with child.stdout:
            for line in child.stdout:
                try:
                    kind, value = json.loads(line)
                except (ValueError, TypeError):
                    continue
                yield kind, value
    except BaseException:
        child.kill()
        raise
    finally:
        child.wait()


def _last_words(status: int, errors: IO[bytes]) -> str:
    """Why a child ended, with the last line that it or its driver wrote."""
    errors.seek(0)
    lines = [line.strip() for line in errors.read().decode(errors="replace").splitlines()]
    said = next((line for line in reversed(lines) if line), "")
    if status < 0:
        name = signal.Signals(-status).name if -status in set(signal.Signals) else str(-status)
        how = f"the process was ended by {name}"
    else:
        how = f"the process ended with status {status}"
    return f"{how}: {said}" if said else how
