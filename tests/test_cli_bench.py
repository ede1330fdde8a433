"""The command ``clplen bench``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from clplen.bench import registry
from clplen.cli import main
from clplen.compute.device import Device

QUICK = ["bench", "transfers", "--quick", "--repeats", "1"]


def run(device: Device, *args: str) -> Result:
    return CliRunner().invoke(main, [*args, "--device", device.place])


def test_all_benchmarks_are_listed() -> None:
    result = CliRunner().invoke(main, ["bench", "--list"])
    assert [line.split()[0] for line in result.output.splitlines()] == list(registry.NAMES)


def test_json_and_comparison(device: Device, tmp_path: Path) -> None:
    made = run(device, *QUICK, "--json")
    found: dict[str, Any] = json.loads(made.stdout)
    assert found["environment"]["device"] == device.name
    (report,) = found["reports"]
    assert report["name"] == "transfers"
    first = report["rows"][1]
    saved = tmp_path / "before.json"
    first["ratio"] = 1e6  # so that the change is known
    saved.write_text(json.dumps(found))
    compared = run(device, *QUICK, "--compare", str(saved))
    assert compared.exit_code == 0, compared.output
    (line,) = (one for one in compared.output.splitlines() if "1e+06 before" in one)
    assert first["name"] in line
    assert "-100.0%" in line
    saved.write_text(json.dumps(found | {"reports": []}))
    assert "no row is in both" in run(device, *QUICK, "--compare", str(saved)).output


def test_a_profile(device: Device) -> None:
    result = run(device, *QUICK, "--profile")
    assert result.exit_code == 0, result.output
    for word in (device.name, "copy within the host", "ratio", "ceilings:"):
        assert word in result.output
    line = next(one for one in result.output.splitlines() if one.endswith("  upload"))
    assert "%" in line


def test_wrong_words(device: Device) -> None:
    for words, message in {
        "stacks": "no benchmark 'stacks'",
        "transfers --size 3x4": "size must be VxUxYxX",
        "--size 3x4x5x6": "--size applies to a single benchmark",
        "transfers --repeats 0": "--repeats",
        "transfers --json --profile": "give one of them",
        "transfers --size 99999x99999x32x32": "No benchmark fits",
    }.items():
        result = run(device, "bench", *words.split())
        assert result.exit_code != 0
        assert message in result.output
        assert "Traceback" not in result.output


def test_files_that_are_no_saved_run(device: Device, tmp_path: Path) -> None:
    file = tmp_path / "before.json"
    for content, message in {
        "no json": "is not JSON",
        "[1]": "not a saved run",
        '{"format": "clplen bench", "version": 99}': "got 99",
        '{"format": "clplen bench", "version": 1, "reports": [3]}': "is damaged",
    }.items():
        file.write_text(content)
        result = run(device, *QUICK, "--compare", str(file))
        assert result.exit_code == 1
        assert message in result.output
