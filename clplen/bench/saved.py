"""Runs of benchmarks as JSON, and the comparison of a run with a saved one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from clplen.bench.report import Report
from clplen.errors import FormatError

FORMAT = "clplen bench"
VERSION = 1


def as_json(reports: Sequence[Report], environment: dict[str, Any]) -> str:
    """A run with the place and the time (UTC) where it was made."""
    found = {
        "format": FORMAT,
        "version": VERSION,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "environment": environment,
        "reports": [report.as_json() for report in reports],
    }
    return json.dumps(found, indent=1)


def read(path: Path) -> dict[str, Any]:
    """A saved run.

    Raises
    ------
    FormatError
        If the file holds something else.
    """
    try:
        found = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path} holds no JSON: save a run by 'clplen bench --json'.") from error
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise FormatError(f"{path} is no saved run of 'clplen bench --json'.")
    if found.get("version") != VERSION:
        raise FormatError(
            f"{path} is version {found.get('version')} of a saved run, and {VERSION} is read: "
            "save the run again."
        )
    try:
        compared([], found)
    except (KeyError, TypeError) as error:
        raise FormatError(f"{path} is damaged: save it by 'clplen bench --json' again.") from error
    return found


def compared(reports: Sequence[Report], saved: dict[str, Any]) -> str:
    """A line for every ratio that is in both, its change first where it is a large one."""
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
