"""Results of benchmarks: tables as text, saved runs and their comparison."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from clplen.bench.ceilings import Ceilings
from clplen.bench.measure import Times
from clplen.compute.device import Device
from clplen.compute.profile import Run
from clplen.errors import FormatError

FORMAT = "clplen bench"
VERSION = 1


@dataclass(frozen=True)
class Row:
    """Row of a table: median seconds per run, work per second, ratio as in `Report.ratio_is`."""

    name: str
    seconds: float
    spread: float
    rate: float
    unit: str
    ratio: float | None = None


@dataclass(frozen=True)
class Report:
    """Results of one benchmark at one size; ``ratio_is`` describes the ratios of its rows."""

    name: str
    size: str
    ratio_is: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()


def time_rows(times: Sequence[Times], by: Times | None = None) -> tuple[Row, ...]:
    """Return rows with their time over that of ``by`` as ratio."""
    return tuple(
        Row(t.case.name, t.median, t.spread, t.rate, t.case.unit, t.over(by) if by else None)
        for t in times
    )


def rate_rows(times: Sequence[Times], by: Times) -> tuple[Row, ...]:
    """Return rows with their rate over that of ``by`` as ratio."""
    scale = [t.case.work / by.case.work for t in times]
    return tuple(
        Row(t.case.name, t.median, t.spread, t.rate, t.case.unit, s / t.over(by))
        for t, s in zip(times, scale, strict=True)
    )


@dataclass(frozen=True)
class Benchmark:
    """Measurement at several sizes.

    ``needs`` returns the memory of a size in bytes, on host and device together; ``quick`` is a
    small size; ``run`` measures one size with a number of repeats on a device.
    """

    name: str
    summary: str
    sizes: tuple[str, ...]
    quick: str
    needs: Callable[[str], int]
    run: Callable[[Device, str, int], Report]


def run_as_json(reports: Sequence[Report], environment: dict[str, Any]) -> str:
    """Format a run as JSON, with its machine and time (UTC)."""
    data = {
        "format": FORMAT,
        "version": VERSION,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "environment": environment,
        "reports": [asdict(report) for report in reports],
    }
    return json.dumps(data, indent=1)


def read_run(path: Path) -> dict[str, Any]:
    """Read a saved run; raise FormatError for any other file."""
    try:
        data = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path} is not JSON: save a run by 'clplen bench --json'.") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise FormatError(f"{path} is not a saved run of 'clplen bench --json'.")
    if data.get("version") != VERSION:
        raise FormatError(
            f"{path} must be version {VERSION} of a saved run, got {data.get('version')}: "
            "save the run again."
        )
    try:
        compare_runs([], data)
    except (KeyError, TypeError) as error:
        raise FormatError(f"{path} is damaged: save it by 'clplen bench --json' again.") from error
    return data


def compare_runs(reports: Sequence[Report], saved: dict[str, Any]) -> str:
    """Return a line for every ratio that is in both runs, its change first."""
    before = {
        (report["name"], report["size"], row["name"]): row["ratio"]
        for report in saved["reports"]
        for row in report["rows"]
        if row["ratio"]
    }
    lines = []
    for report in reports:
        for row in report.rows:
            old = before.get((report.name, report.size, row.name))
            if old is not None and row.ratio is not None:
                change = row.ratio / old - 1
                lines.append(
                    f"{change:+7.1%}  {report.name} {report.size}: {row.name}: ratio "
                    f"{old:.3g} before, {row.ratio:.3g} now"
                )
    head = f"compared with the run of {saved['date']} on {saved['environment']['device']}:"
    return "\n".join([head, *lines] if lines else [f"{head} no row is in both"])


_PREFIXES = ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k"))
_MAX_NAME = 64  # characters


def device_text(environment: dict[str, Any]) -> str:
    """Format device, driver, processor and versions as two lines."""
    packages = ", ".join(f"{name} {version}" for name, version in environment["packages"].items())
    note = f" {environment['note']}" if environment["note"] else ""
    return (
        f"{environment['device']} ({environment['driver']}), {environment['precision']}, FFT by "
        f"{environment['fft']}; {environment['processor']}, {environment['cores']} cores.{note}\n"
        f"clplen {environment['clplen']}, Python {environment['python']}, {packages}"
    )


def report_text(report: Report) -> str:
    """Format a table with its notes."""
    width = max([len(row.name) for row in report.rows] + [4])
    lines = [f"{report.name}, {report.size}; ratio: {report.ratio_is}"]
    lines.append(f"  {'':{width}s}  {'median':>10s} {'spread':>7s} {'rate':>18s} {'ratio':>8s}")
    for row in report.rows:
        ratio = "" if row.ratio is None else f"{row.ratio:8.2f}"
        rate = f"{scaled(row.rate)}{row.unit}/s"
        time = f"{_time(row.seconds):>10s} {row.spread:6.0%}"
        lines.append(f"  {row.name:{width}s}  {time} {rate:>19s} {ratio:>8s}")
    lines += [f"  {note}" for note in report.notes]
    return "\n".join(lines)


def scaled(value: float) -> str:
    """Format a number of three digits with its SI prefix."""
    for size, prefix in _PREFIXES:
        if value >= size:
            return f"{value / size:.3g} {prefix}"
    return f"{value:.3g} "


def _time(seconds: float) -> str:
    for size, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us")):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def profile_text(runs: Iterable[Run], ceilings: Ceilings) -> str:
    """Format a line for each kernel: count, times, share of the ceiling that limits it.

    The share is the larger of the times for bytes and for operations at the machine's ceilings,
    over the measured time. Operations are those that the package counts.
    """
    runs_by_name: dict[str, list[Run]] = {}
    for run in runs:
        runs_by_name.setdefault(run.name, []).append(run)
    total = sum(run.seconds for group in runs_by_name.values() for run in group)
    lines = [
        f"ceilings: {scaled(ceilings.bytes_per_second)}B/s of a copy, "
        f"{scaled(ceilings.operations_per_second)}op/s of multiply-adds in registers",
        f"{'count':>7s} {'median':>10s} {'of all':>7s} {'B/s':>9s} {'op/s':>9s}"
        f" {'of ceiling':>15s}  name",
    ]
    ordered = sorted(runs_by_name.items(), key=lambda item: -sum(run.seconds for run in item[1]))
    lines += [_profile_line(name, group, total, ceilings) for name, group in ordered]
    return "\n".join(lines)


def _profile_line(name: str, group: Sequence[Run], total: float, ceilings: Ceilings) -> str:
    spent = sum(run.seconds for run in group)
    moved, done = sum(run.nbytes for run in group), sum(run.operations for run in group)
    share, limit = ceilings.fraction(spent, moved, done)
    median = statistics.median(run.seconds for run in group)
    rates = [f"{scaled(count / spent) if count and spent else '-':>9s}" for count in (moved, done)]
    label = name if len(name) <= _MAX_NAME else f"{name[: _MAX_NAME - 3]}..."
    part = f"{spent / total if total else 0:7.0%}"
    ceiling = f"{share:4.0%} {limit}"
    return f"{len(group):7d} {_time(median):>10s} {part} {' '.join(rates)} {ceiling:>15s}  {label}"
