"""Reports and profiles as text."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from typing import Any

from clplen.bench.ceilings import Ceilings
from clplen.bench.report import Goal, Report, Row
from clplen.compute.profile import Run

_PREFIXES = ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k"))
_LONGEST = 64  # characters of a name


def device_text(environment: dict[str, Any]) -> str:
    """Device, driver, processor and versions in two lines."""
    packages = ", ".join(f"{name} {version}" for name, version in environment["packages"].items())
    note = f" {environment['note']}" if environment["note"] else ""
    return (
        f"{environment['device']} ({environment['driver']}), {environment['precision']}, FFT by "
        f"{environment['fft']}; {environment['processor']}, {environment['cores']} cores.{note}\n"
        f"clplen {environment['clplen']}, Python {environment['python']}, {packages}"
    )


def report_text(report: Report) -> str:
    """A table with its goals and notes."""
    width = max([len(row.name) for row in report.rows] + [4])
    lines = [f"{report.name}, {report.size}; ratio: {report.ratio_is}"]
    lines.append(f"  {'':{width}s}  {'median':>10s} {'spread':>7s} {'rate':>18s} {'ratio':>8s}")
    lines += [f"  {_row(row, width)}" for row in report.rows]
    lines += [f"  {_goal(goal)}" for goal in report.goals]
    lines += [f"  {note}" for note in report.notes]
    return "\n".join(lines)


def _row(row: Row, width: int) -> str:
    ratio = "" if row.ratio is None else f"{row.ratio:8.2f}"
    rate = f"{scaled(row.rate)}{row.unit}/s"
    return (
        f"{row.name:{width}s}  {_time(row.seconds):>10s} {row.spread:6.0%} {rate:>19s} {ratio:>8s}"
    )


def _goal(goal: Goal) -> str:
    state = "met" if goal.met else "NOT MET"
    why = f" ({goal.why})" if goal.why and not goal.met else ""
    return f"{state:7s} {goal.name}: {goal.measured:.3g}, {goal.rule} {goal.limit:g}{why}"


def scaled(value: float) -> str:
    """A number of three digits with its SI prefix."""
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
    """A line a kernel: how often, how long, how near the ceiling that binds it.

    The share of the ceiling is the larger one of bytes and operations at the machine's own rates
    over the time taken. Operations are those that the package counts; most kernels move memory.
    """
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(run.name, []).append(run)
    total = sum(run.seconds for group in found.values() for run in group)
    lines = [
        f"ceilings: {scaled(ceilings.bytes_per_second)}B/s of a copy, "
        f"{scaled(ceilings.operations_per_second)}op/s of multiply-adds in registers",
        f"{'count':>7s} {'median':>10s} {'of all':>7s} {'B/s':>9s} {'op/s':>9s}"
        f" {'of ceiling':>15s}  name",
    ]
    ordered = sorted(found.items(), key=lambda item: -sum(run.seconds for run in item[1]))
    lines += [_profile_line(name, group, total, ceilings) for name, group in ordered]
    return "\n".join(lines)


def _profile_line(name: str, group: Sequence[Run], total: float, ceilings: Ceilings) -> str:
    spent = sum(run.seconds for run in group)
    moved, done = sum(run.nbytes for run in group), sum(run.operations for run in group)
    share, which = ceilings.fraction(spent, moved, done)
    median = statistics.median(run.seconds for run in group)
    rates = [f"{scaled(count / spent) if count and spent else '-':>9s}" for count in (moved, done)]
    shown = name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}..."
    part = f"{spent / total if total else 0:7.0%}"
    ceiling = f"{share:4.0%} {which}"
    return f"{len(group):7d} {_time(median):>10s} {part} {' '.join(rates)} {ceiling:>15s}  {shown}"
