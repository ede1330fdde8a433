"""Markdown report of a comparison: a table, and the best camera for each criterion with causes."""

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

MAX_TIE_RATIO = 1.05  # largest ratio of two numbers that counts as a tie


@dataclass(frozen=True)
class Criterion:
    """Number of a camera, with its presentation and cause."""

    analysis: str  # name in `ANALYSES`
    name: str
    value: Callable[[Measured], float]  # NaN where the camera has no such number
    more_is_better: bool
    scale: float  # from SI units to ``unit``
    unit: str
    # cause of the number of a `Measured`; empty if unknown
    cause: Callable[[Measured], str]


def usable_mtf50(measured: Measured) -> float:
    """Return the lower of MTF50 and the samples' Nyquist frequency, along x."""
    return float(np.fmin(measured.mtf().at(0.5), measured.sampling.nyquist))


def usable_limit(measured: Measured) -> float:
    """Return the larger of the two-point limit and two samples, along x."""
    return max(measured.two_point_limit(), 2 * measured.sampling.spatial_pitch)


def criteria(comparison: Comparison) -> list[Criterion]:
    """Return the criteria for which a comparison has numbers."""
    shared = common_depths(comparison)
    table = [
        Criterion(
            "sampling", "places along x", lambda c: c.sampling.spatial_samples, True, 1.0, "",
            reasons.spatial_samples,
        ),
        Criterion(
            "sampling", "independent directions", lambda c: c.sampling.independent_views, True,
            1.0, "", reasons.views,
        ),
        Criterion("mtf", "usable MTF50", usable_mtf50, True, 1e-3, "cycles/mm", reasons.frequency),
        Criterion("two-points", "two-point limit", usable_limit, False, 1e6, "um", reasons.limit),
        Criterion("strehl", "Strehl ratio", Measured.strehl, True, 1.0, "", reasons.peak),
        Criterion(
            "energy", "radius of 80 % of the light", lambda c: c.radius(0.8), False, 1e6, "um",
            reasons.radius,
        ),
        Criterion(
            "crosstalk", "crosstalk", lambda c: _number_or_nan(c.crosstalk), False, 100.0, "%",
            reasons.crosstalk,
        ),
        Criterion(
            "depth", "depths measured",
            lambda c: _number_or_nan(None if c.depth is None else np.isfinite(c.depth.rms).sum()),
            True, 1.0, "", reasons.depth_range,
        ),
        Criterion(
            "depth", "rms depth error where all measure", lambda c: depth_rms(c, shared), False,
            1e3, "mm", reasons.depth,
        ),
    ]  # fmt: skip
    return [criterion for criterion in table if criterion.analysis in comparison.analyses]


def common_depths(comparison: Comparison) -> Any:
    """Return a mask of the depths that every camera measured; None without depth errors."""
    masks = [
        np.isfinite(measured.depth.rms)
        for measured in comparison.cameras
        if measured.depth is not None
    ]
    return np.logical_and.reduce(masks) if masks else None


def depth_rms(measured: Measured, mask: Any) -> float:
    """Return the rms error over selected depths in metres; NaN for an empty selection."""
    if measured.depth is None or mask is None or not np.any(mask):
        return math.nan
    return float(np.sqrt(np.mean(measured.depth.errors[mask] ** 2)))


def judge(criterion: Criterion, cameras: Sequence[Measured]) -> str:
    """Return a sentence with the best camera, the ratios and the causes."""
    numbers = [(criterion.value(measured) * criterion.scale, measured) for measured in cameras]
    ranked = [(value, measured) for value, measured in numbers if math.isfinite(value)]
    if not ranked:
        return f"**{criterion.name}**: no camera has one."
    order = sorted(ranked, key=lambda pair: pair[0], reverse=criterion.more_is_better)
    numbers_text = "; ".join(
        f"{_number(value, criterion.unit)} of `{measured.name}`" for value, measured in order
    )
    missing = [
        f"none of `{measured.name}`" for value, measured in numbers if not math.isfinite(value)
    ]
    numbers_text = "; ".join([numbers_text, *missing])
    causes = _reasons(criterion, order)
    return f"**{criterion.name}**: {_verdict(criterion, order)} {numbers_text}. {causes}".rstrip()


def depth_verdicts(comparison: Comparison) -> list[str]:
    """Return a sentence for each run of depths with the cameras that resolve most."""
    cameras = [measured for measured in comparison.cameras if measured.transfer is not None]
    if not cameras:
        return []
    depths = cameras[0].transfer.dz  # type: ignore[union-attr]
    usable = np.transpose([usable_over_depth(measured) for measured in cameras])
    verdicts = [_best_names(cameras, values) for values in usable]
    lines = []
    for first, last in _runs(verdicts):
        table = usable[first : last + 1] * 1e-3
        span = _span(depths[first], depths[last])
        numbers = ", ".join(
            f"`{measured.name}` {_range(table[:, k])}" for k, measured in enumerate(cameras)
        )
        lines.append(f"at dz {span}: {verdicts[first]} ({numbers} cycles/mm of the object)")
    return lines


def _best_names(cameras: Sequence[Measured], values: Any) -> str:
    """Return the camera with the largest value, or the cameras that tie with it."""
    pairs = zip(values, cameras, strict=True)
    finite = [(value, f"`{measured.name}`") for value, measured in pairs if np.isfinite(value)]
    largest = max((value for value, _ in finite), default=math.nan)
    names = [name for value, name in finite if _ratio(largest, value) < MAX_TIE_RATIO]
    if len(names) > 1:
        return f"{', '.join(names)} are equally good"
    return names[0] if names else "none"


def usable_over_depth(measured: Measured) -> Any:
    """Return the lower of MTF50 and the object's Nyquist frequency at every depth."""
    assert measured.transfer is not None
    limits = [object_nyquist(measured.camera, float(dz)) for dz in measured.transfer.dz]
    has_curve = np.array([curve is not None for curve in measured.transfer.curves])
    return np.where(has_curve, np.fmin(measured.transfer.mtf50, limits), np.nan)


def _verdict(criterion: Criterion, order: list[tuple[float, Measured]]) -> str:
    if len(order) == 1:
        return "only"
    best = order[0][0]
    pairs = [(best, v) if criterion.more_is_better else (v, best) for v, _ in order]
    lags = [_ratio(more, less) for more, less in pairs]
    first = [
        f"`{measured.name}`"
        for lag, (_, measured) in zip(lags, order, strict=True)
        if lag < MAX_TIE_RATIO
    ]
    if len(first) == len(order):
        return "no difference,"
    if len(first) > 1:
        return f"{', '.join(first)} are equally good:"
    if math.isinf(lags[1]):
        return f"{first[0]} wins:"
    return f"{first[0]} wins by a factor of {lags[1]:.3g}:"


def _ratio(more: float, less: float) -> float:
    if more == less:
        return 1.0
    return more / less if less else math.inf


def _reasons(criterion: Criterion, order: list[tuple[float, Measured]]) -> str:
    """Join the causes, without a cause that is shared by differing numbers."""
    groups: dict[str, list[tuple[float, str]]] = {}
    for value, measured in order:
        groups.setdefault(criterion.cause(measured), []).append((value, f"`{measured.name}`"))
    sentences = []
    for reason, members in groups.items():
        values = [value for value, _ in members]
        if reason and _ratio(max(values), min(values)) < MAX_TIE_RATIO:
            sentences.append(f"{', '.join(name for _, name in members)}: {reason}")
    return "; ".join(sentences) + "." if sentences else ""


def _number(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()


def _number_or_nan(value: Any) -> float:
    return math.nan if value is None else float(value)


def _runs(names: list[str]) -> list[tuple[int, int]]:
    """Return the first and last index of each run of equal names."""
    runs: list[tuple[int, int]] = []
    for k, name in enumerate(names):
        if runs and names[runs[-1][0]] == name:
            runs[-1] = (runs[-1][0], k)
        else:
            runs.append((k, k))
    return runs


def _span(first: float, last: float) -> str:
    if first == last:
        return f"{first * 1e3:g} mm"
    return f"{first * 1e3:g} to {last * 1e3:g} mm"


def _range(values: Any) -> str:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "none"
    low, high = f"{finite.min():.3g}", f"{finite.max():.3g}"
    return low if low == high else f"{low} to {high}"


_UNITS = {"m": (1e6, "um"), "cycles/m": (1e-3, "cycles/mm")}
_MILLIMETRES = ("depth", "dz")


def report(comparison: Comparison) -> str:
    """Return the comparison as Markdown: numbers of all cameras, then conclusions."""
    names = [f"`{measured.name}`".replace("|", r"\|") for measured in comparison.cameras]
    lines = ["# Comparison of plenoptic cameras", ""]
    lines += [f"| | {' | '.join(names)} | unit |", "|" + "---|" * (len(names) + 2)]
    lines += [f"| {' | '.join(row)} |" for row in _rows(comparison)]
    lines += [
        "",
        "Lengths and frequencies refer to the main lens' image, unless marked as of the object.",
        *_notes(comparison),
        "",
    ]
    if len(comparison.cameras) > 1:
        lines += ["## Which wins where, and why", ""]
    else:
        lines += ["## What limits it", ""]
    lines += [f"- {judge(measured, comparison.cameras)}" for measured in criteria(comparison)]
    depths = depth_verdicts(comparison)
    if depths:
        lines.append("- **usable MTF50 over depth**, each picture focused on its depth:")
        lines += [f"  - {line}" for line in depths]
    return "\n".join(lines) + "\n"


def _notes(comparison: Comparison) -> list[str]:
    """Return explanations of the table's numbers."""
    notes = []
    if "mtf" in comparison.analyses:
        notes.append(
            "No MTF cut-off is given where contrast stays above 0.01 beyond the diffraction limit."
        )
    scanned = [measured for measured in comparison.cameras if measured.transfer is not None]
    ended = [
        f"`{measured.name}`"
        for measured in scanned
        if measured.transfer and measured.transfer.best_at_end
    ]
    if ended:
        notes.append(
            f"The best focus of {', '.join(ended)} is at the end of the depths scanned: it may be "
            "outside."
        )
    return notes


def _rows(comparison: Comparison) -> list[list[str]]:
    rows = [["type", *(measured.sampling.kind for measured in comparison.cameras), ""]]
    if "sampling" in comparison.analyses:
        for label, name, factor, unit in ROWS:
            values = (getattr(measured.sampling, name) * factor for measured in comparison.cameras)
            rows.append([label.replace("the axis", "x"), *map(_cell, values), unit])
    summaries = [summary_values(measured, comparison.analyses) for measured in comparison.cameras]
    for name, (_, unit) in summaries[0].items():
        if name.endswith(" y") and all(_alike(measured, name) for measured in summaries):
            continue
        factor, displayed_unit = _UNITS.get(unit, (1.0, unit))
        if unit == "m" and any(word in name for word in _MILLIMETRES):
            factor, displayed_unit = 1e3, "mm"
        rows.append(
            [name, *(_cell(measured[name][0] * factor) for measured in summaries), displayed_unit]
        )
    return rows


def _alike(values: dict[str, tuple[float, str]], name: str) -> bool:
    """Return True if the numbers along y and x are equal."""
    y, x = values[name][0], values[f"{name[:-1]}x"][0]
    return math.isclose(y, x, rel_tol=1e-3) or (math.isnan(y) and math.isnan(x))


def _cell(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"
