"""``clplen devices --check``: the table, the exit status, the report; drivers that die."""

from __future__ import annotations

import json
import math
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from click.testing import CliRunner, Result

import clplen
from clplen.cli import main
from clplen.compute.device import Device
from clplen.selftest import CHECKS, CheckResult, run_checks, run_isolated, runner
from clplen.selftest.report import DeviceReport, environment, paste_block, row, summary

GOOD = CheckResult("window", "padding", ("window.cl",), 1e-7, 1e-6, "ok", "", 0.5)
BAD = CheckResult("shear", "planes", ("shear.cl",), 0.25, 1e-5, "FAILED", "wrong values", 0.5)
NONE = CheckResult("opening", "opens", (), math.nan, 0.0, "FAILED", "It cannot build kernels.", 0.0)
FATAL = """
import os
import sys
import scipy.fft

def fatal(*_, **__):
    print("LLVM ERROR: Cannot select: planted", file=sys.stderr, flush=True)
    os.abort()

scipy.fft.fftn = fatal
"""


def run(*words: object) -> Result:
    return CliRunner().invoke(main, ["devices", *(str(word) for word in words)])


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> list[CheckResult]:
    """What the checks of every device come to."""
    results: list[CheckResult] = []

    def found(device: Device, *, watch: Any = None) -> DeviceReport:
        for result in results:
            if watch is not None:
                watch(result)
        return DeviceReport({"device": device.name}, list(results), 1.5)

    monkeypatch.setattr(runner, "run_isolated", found)
    return results


@pytest.mark.thorough
def test_every_check_passes(device: Device) -> None:
    result = run("--check", "--device", device.place)
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    rows = [line for line in lines if line.endswith(" s") and line[20:].strip()]
    for check, line in zip(CHECKS, rows, strict=False):
        assert line.startswith(f"{check.name:<19s} {check.compared}")
        assert " ok " in line or "left out" in line
    assert f"{len(CHECKS)} checks ok" in result.output or "left out," in result.output
    block = result.output[result.output.index("---- paste") :]
    for words in (f"clplen     {clplen.__version__}, Python", "pyopencl ", "numpy ", "variables "):
        assert words in block
    assert device.cl_device.version.strip() in block
    assert device.cl_device.driver_version.strip() in block
    assert f"FFT        {device.fft.name}" in block
    assert "note       " in block


def test_a_failed_check_is_status_1(given: list[CheckResult]) -> None:
    given += [GOOD]
    fit = run("--check")
    assert fit.exit_code == 0
    assert fit.output.splitlines()[-1].startswith("Fit for use: ")
    given += [BAD]
    result = run("--check")
    assert result.exit_code == 1
    last = result.output.splitlines()[-1]
    assert last.startswith("Not fit for use: ")
    assert last.endswith(" (failed: shear).")
    assert "wrong values; kernels: shear.cl" in result.output
    assert "1 checks ok, 1 FAILED, 1.5 s: shear" in result.output


def test_a_device_that_cannot_be_opened_is_a_row(given: list[CheckResult]) -> None:
    given += [NONE]
    result = run("--check")
    assert result.exit_code == 1
    assert "\n    It cannot build kernels.\n" in result.output


def test_json(given: list[CheckResult]) -> None:
    given += [GOOD, NONE]
    result = run("--check", "--json")
    assert result.exit_code == 1
    found = json.loads(result.output)
    assert found["environment"]["clplen"].startswith(clplen.__version__)
    good, none = found["devices"][0]["results"]
    assert (good["name"], good["error"], good["status"]) == ("window", 1e-7, "ok")
    assert (none["error"], none["reason"]) == (None, "It cannot build kernels.")


def test_words_that_do_not_fit_are_refused() -> None:
    result = run("--json")
    assert result.exit_code == 2
    assert "--json applies to --check" in result.stderr
    result = run("--check", "--device", "zebra")
    assert result.exit_code == 1
    assert "No OpenCL device matches 'zebra'" in result.stderr
    assert "Traceback" not in result.output


def test_no_platform_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> Any:
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", none)
    result = run("--check")
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: No OpenCL platform was found.")


@pytest.mark.thorough
def test_rows_come_in_order(device: Device) -> None:
    names = [check.name for check in CHECKS if check.name.startswith("FFT")] + ["finite"]
    seen: list[str] = []
    report = run_isolated(device, names=names, watch=lambda result: seen.append(result.name))
    assert seen == names == [result.name for result in report.results]
    assert {result.status for result in report.results} <= {"ok", "left out"}
    assert report.seconds > 0


def test_a_driver_that_dies_is_a_row(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text(FATAL)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    report = run_isolated(device, names=["FFT, scipy", "finite", "intensity"])
    dead, *others = report.results
    assert [result.status for result in others] == ["ok", "ok"]
    assert dead.failed
    assert dead.reason.startswith("the process was ended by SIGABRT: ")


def test_a_device_that_is_not_there_is_one_row() -> None:
    usual = Device.open()
    seen: list[CheckResult] = []
    report = run_isolated(Device(usual.cl_device, selector="97:3"), watch=seen.append)
    assert [result.name for result in report.results] == ["opening"] == [r.name for r in seen]
    assert report.results[0].reason.startswith("No OpenCL device matches '97:3'.")


@pytest.mark.thorough
def test_an_interrupt_ends_the_children(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    children: list[subprocess.Popen[bytes]] = []
    begin = runner._child

    def kept(*args: Any) -> Any:
        children.append(begin(*args))
        return children[-1]

    def interrupt(result: CheckResult) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "_child", kept)
    with pytest.raises(KeyboardInterrupt):
        run_isolated(device, watch=interrupt)
    assert children
    for child in children:
        child.wait(timeout=20)


def test_checks_by_name(device: Device) -> None:
    assert [result.name for result in run_checks(device, names=["intensity", "finite"])] == [
        "finite",
        "intensity",
    ]
    with pytest.raises(ValueError, match="names of checks, got 'windows'"):
        run_checks(device, names=["windows"])


def test_the_report_names_variables_and_what_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POCL_PLANTED", "8")
    monkeypatch.setenv("UNRELATED_SECRET", "hidden")
    text = paste_block([DeviceReport({"device": "one"}, [GOOD, BAD], 2.0)])
    assert "POCL_PLANTED=8" in environment()["variables"]
    assert "hidden" not in text
    assert row(BAD) in text
    assert row(GOOD) not in text
    assert summary([GOOD], 2.0) == "1 checks ok, 0 FAILED, 2.0 s"
    assert "nan" not in row(NONE)
    assert np.all([len(line) <= 110 for line in row(BAD).splitlines()])
