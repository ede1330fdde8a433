"""A comparison of cameras as a short text: one table, and which of them wins where and why."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from clplen.analysis.sampling import ROWS
from clplen.analysis.tables import summary_of
from clplen.analysis.verdicts import criteria, judged, over_depth

if TYPE_CHECKING:
    from clplen.analysis.comparison import Comparison
    from clplen.analysis.measured import Measured

_UNITS = {"m": (1e6, "um"), "cycles/m": (1e-3, "cycles/mm")}
_MILLIMETRES = ("depth", "dz")


def report(comparison: Comparison) -> str:
    """Markdown: the numbers of all cameras, then what follows from them.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    str
    """
    names = [f"`{one.name}`" for one in comparison.cameras]
    lines = ["# Comparison of plenoptic cameras", ""]
    lines += [f"| | {' | '.join(names)} | unit |", "|" + "---|" * (len(names) + 2)]
    lines += [f"| {' | '.join(row)} |" for row in _rows(comparison)]
    lines += [
        "",
        "Lengths and frequencies are those on the main lens' image, unless they are of the object.",
        *_notes(comparison),
        "",
    ]
    if len(comparison.cameras) > 1:
        lines += ["## Which wins where, and why", ""]
    else:
        lines += ["## What limits it", ""]
    lines += [f"- {judged(one, comparison.cameras)}" for one in criteria(comparison)]
    depths = over_depth(comparison)
    if depths:
        lines.append("- **usable MTF50 over depth**, each picture focused on its depth:")
        lines += [f"  - {line}" for line in depths]
    return "\n".join(lines) + "\n"


def _notes(comparison: Comparison) -> list[str]:
    """What the table's numbers need to be understood."""
    found = []
    if "mtf" in comparison.analyses:
        found.append(
            "No MTF cut-off is given where contrast stays above .01 beyond the diffraction cut-off."
        )
    scanned = [one for one in comparison.cameras if one.transfer is not None]
    ended = [f"`{one.name}`" for one in scanned if one.transfer and one.transfer.best_at_end]
    if ended:
        found.append(
            f"The best focus of {', '.join(ended)} is at the end of the depths scanned: it may lie "
            "beyond."
        )
    return found


def _rows(comparison: Comparison) -> list[list[str]]:
    rows = [["type", *(one.sampling.kind for one in comparison.cameras), ""]]
    if "sampling" in comparison.analyses:
        rows += [_sampling_row(comparison, *row) for row in ROWS]
    every = [summary_of(one, comparison.analyses) for one in comparison.cameras]
    for name, (_, unit) in every[0].items():
        if name.endswith(" y") and all(_alike(one, name) for one in every):
            continue
        factor, shown = _UNITS.get(unit, (1.0, unit))
        if unit == "m" and any(word in name for word in _MILLIMETRES):
            factor, shown = 1e3, "mm"
        rows.append([name, *(_cell(one[name][0] * factor) for one in every), shown])
    return rows


def _alike(found: dict[str, tuple[float, str]], name: str) -> bool:
    """Whether the number along y is that along x."""
    y, x = found[name][0], found[f"{name[:-1]}x"][0]
    return math.isclose(y, x, rel_tol=1e-3) or (math.isnan(y) and math.isnan(x))


def _sampling_row(
    comparison: Comparison, label: str, name: str, factor: float, unit: str
) -> list[str]:
    def value(one: Measured) -> float:
        return float(getattr(one.sampling, name)) * factor

    return [
        label.replace("the axis", "x"),
        *(_cell(value(one)) for one in comparison.cameras),
        unit,
    ]


def _cell(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"
