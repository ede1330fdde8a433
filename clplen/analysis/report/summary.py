"""A comparison of cameras as Markdown: one table, and which camera is best at what and why."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.cameras.camera_psf import object_nyquist
from clplen.analysis.cameras.comparison import Comparison, Measured
from clplen.analysis.cameras.sampling import ROWS
from clplen.analysis.report import reasons
from clplen.analysis.report.tables import summary_values

EQUAL = 1.05  # ratio up to which two numbers count as the same


@dataclass(frozen=True)
class Criterion:
    """One number of a camera, and how it is said."""

    analysis: str  # that it belongs to
    name: str
    value: Callable[[Measured], float]  # of a `Measured`; NaN where it has none
    more_is_better: bool
    scale: float  # from SI units to those shown
    unit: str
    # what sets the number of a `Measured`, in words; empty where nothing known does
    why: Callable[[Measured], str]


def usable_mtf50(one: Measured) -> float:
    """The lower of MTF50 and the samples' Nyquist frequency, along x."""
    return float(np.fmin(one.mtf().at(0.5), one.sampling.nyquist))


def usable_limit(one: Measured) -> float:
    """The larger of the two-point limit and two samples, along x."""
    return max(one.two_point_limit(), 2 * one.sampling.spatial_pitch)


def criteria(comparison: Comparison) -> list[Criterion]:
    """Those for which a comparison has numbers."""
    shared = common_depths(comparison)
    every = [
        Criterion(
            "sampling", "places along x", lambda one: one.sampling.spatial_samples, True, 1.0, "",
            reasons.places,
        ),
        Criterion(
            "sampling", "independent directions", lambda one: one.sampling.independent_views, True,
            1.0, "", reasons.views,
        ),
        Criterion("mtf", "usable MTF50", usable_mtf50, True, 1e-3, "cycles/mm", reasons.frequency),
        Criterion("two-points", "two-point limit", usable_limit, False, 1e6, "um", reasons.limit),
        Criterion("strehl", "Strehl ratio", Measured.strehl, True, 1.0, "", reasons.peak),
        Criterion(
            "energy", "radius of 80 % of the light", lambda one: one.radius(0.8), False, 1e6, "um",
            reasons.radius,
        ),
        Criterion(
            "crosstalk", "crosstalk", lambda one: _known(one.crosstalk), False, 100.0, "%",
            reasons.crosstalk,
        ),
        Criterion(
            "depth", "depths measured",
            lambda one: _known(None if one.depth is None else np.isfinite(one.depth.rms).sum()),
            True, 1.0, "", reasons.depth_range,
        ),
        Criterion(
            "depth", "rms depth error where all measure", lambda one: depth_rms(one, shared), False,
            1e3, "mm", reasons.depth,
        ),
    ]  # fmt: skip
    return [one for one in every if one.analysis in comparison.analyses]


def common_depths(comparison: Comparison) -> Any:
    """Which depths every camera has measured, or None where none was asked for."""
    known = [np.isfinite(one.depth.rms) for one in comparison.cameras if one.depth is not None]
    return np.logical_and.reduce(known) if known else None


def depth_rms(one: Measured, chosen: Any) -> float:
    """rms error over some of the depths, in metres; NaN where there is none."""
    if one.depth is None or chosen is None or not np.any(chosen):
        return math.nan
    return float(np.sqrt(np.mean(one.depth.errors[chosen] ** 2)))


def judge(criterion: Criterion, cameras: Sequence[Measured]) -> str:
    """One sentence: who is best, by how much, and what limits each."""
    numbers = [(criterion.value(one) * criterion.scale, one) for one in cameras]
    known = [(value, one) for value, one in numbers if math.isfinite(value)]
    if not known:
        return f"**{criterion.name}**: no camera has one."
    order = sorted(known, key=lambda pair: pair[0], reverse=criterion.more_is_better)
    said = "; ".join(f"{_number(value, criterion.unit)} of `{one.name}`" for value, one in order)
    missing = [f"none of `{one.name}`" for value, one in numbers if not math.isfinite(value)]
    said = "; ".join([said, *missing])
    why = _reasons(criterion, order)
    return f"**{criterion.name}**: {_verdict(criterion, order)} {said}. {why}".rstrip()


def depth_verdicts(comparison: Comparison) -> list[str]:
    """Who resolves most at which depths: a sentence for each run of depths."""
    cameras = [one for one in comparison.cameras if one.transfer is not None]
    if not cameras:
        return []
    depths = cameras[0].transfer.dz  # type: ignore[union-attr]
    best: list[tuple[float, str, list[float]]] = []
    for k, dz in enumerate(depths):
        values = [usable_over_depth(one)[k] for one in cameras]
        name = "none" if np.isnan(values).all() else cameras[int(np.nanargmax(values))].name
        best.append((float(dz), name, values))
    lines = []
    for first, last in _runs([name for _, name, _ in best]):
        table = np.array([v for _, _, v in best[first : last + 1]]) * 1e-3
        span = _span(best[first][0], best[last][0])
        numbers = ", ".join(f"`{one.name}` {_range(table[:, k])}" for k, one in enumerate(cameras))
        lines.append(f"at dz {span}: `{best[first][1]}` ({numbers} cycles/mm of the object)")
    return lines


def usable_over_depth(one: Measured) -> Any:
    """The lower of MTF50 and Nyquist's frequency of the object, at every depth of `transfer`."""
    assert one.transfer is not None
    limits = [object_nyquist(one.camera, float(dz)) for dz in one.transfer.dz]
    known = np.array([curve is not None for curve in one.transfer.curves])
    return np.where(known, np.fmin(one.transfer.mtf50, limits), np.nan)


def _verdict(criterion: Criterion, order: list[tuple[float, Measured]]) -> str:
    if len(order) == 1:
        return "only"
    best = order[0][0]
    pairs = [(best, v) if criterion.more_is_better else (v, best) for v, _ in order]
    lags = [_ratio(more, less) for more, less in pairs]
    first = [f"`{one.name}`" for lag, (_, one) in zip(lags, order, strict=True) if lag < EQUAL]
    if len(first) == len(order):
        return "no difference,"
    if len(first) > 1:
        return f"{', '.join(first)} win alike:"
    if math.isinf(lags[1]):
        return f"{first[0]} wins:"
    return f"{first[0]} wins by a factor of {lags[1]:.3g}:"


def _ratio(more: float, less: float) -> float:
    if more == less:
        return 1.0
    return more / less if less else math.inf


def _reasons(criterion: Criterion, order: list[tuple[float, Measured]]) -> str:
    """What makes the numbers; one reason cannot make two that differ."""
    told: dict[str, list[tuple[float, str]]] = {}
    for value, one in order:
        told.setdefault(criterion.why(one), []).append((value, f"`{one.name}`"))
    said = []
    for reason, found in told.items():
        values = [value for value, _ in found]
        if reason and _ratio(max(values), min(values)) < EQUAL:
            said.append(f"{', '.join(name for _, name in found)}: {reason}")
    return "; ".join(said) + "." if said else ""


def _number(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()


def _known(value: Any) -> float:
    return math.nan if value is None else float(value)


def _runs(names: list[str]) -> list[tuple[int, int]]:
    """First and last index of equal neighbours."""
    found: list[tuple[int, int]] = []
    for k, name in enumerate(names):
        if found and names[found[-1][0]] == name:
            found[-1] = (found[-1][0], k)
        else:
            found.append((k, k))
    return found


def _span(first: float, last: float) -> str:
    if first == last:
        return f"{first * 1e3:g} mm"
    return f"{first * 1e3:g} to {last * 1e3:g} mm"


def _range(values: Any) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return "none"
    low, high = f"{known.min():.3g}", f"{known.max():.3g}"
    return low if low == high else f"{low} to {high}"


_UNITS = {"m": (1e6, "um"), "cycles/m": (1e-3, "cycles/mm")}
_MILLIMETRES = ("depth", "dz")


def report(comparison: Comparison) -> str:
    """Markdown: the numbers of all cameras, then what follows from them."""
    names = [f"`{one.name}`".replace("|", r"\|") for one in comparison.cameras]
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
    lines += [f"- {judge(one, comparison.cameras)}" for one in criteria(comparison)]
    depths = depth_verdicts(comparison)
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
        for label, name, factor, unit in ROWS:
            values = (getattr(one.sampling, name) * factor for one in comparison.cameras)
            rows.append([label.replace("the axis", "x"), *map(_cell, values), unit])
    every = [summary_values(one, comparison.analyses) for one in comparison.cameras]
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


def _cell(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"
