"""Rows of ``clplen info`` for a light field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clplen.lightfield.axis_check.lightfield_report import LightFieldReport

Rows = list[tuple[str, str]]
LayoutWords = tuple[str, ...]

_MAX_LISTED_VIEWS = 12  # fits on one line


def sample_rows(report: LightFieldReport) -> Rows:
    """Return the number, samples, brightness, spacing and positions of the views."""
    V, U, ny, nx = report.shape[:4]
    views, channels = V * U, report.shape[4:]
    rows = [
        ("Views", f"{V} x {U} (V x U) of {ny} x {nx} pixels, {(channels or (1,))[0]} channels"),
        ("Samples", f"{report.dtype}, {report.low:g} to {report.high:g}"),
    ]
    for label, flat in (("Dark views", report.dark), ("Constant views", report.constant)):
        rows.append((label, f"{len(flat)} of {views}: {_listed(flat)}" if flat else "none"))
    rows += _brightness_rows(report)
    rows.append(("Left out", f"{report.left_out} of {views} views have weight 0"))
    spacing = "not known"
    if report.spacing is not None:
        spacing = ", ".join(
            f"{name} {1e6 * step:g} um"
            for name, step in zip(("dv", "du", "dy", "dx"), report.spacing, strict=True)
        )
    rows.append(("Spacing", spacing))
    if report.scattered:
        rows.append(("Positions", "stored for each view"))
    return rows


def _listed(views: Sequence[tuple[int, int]]) -> str:
    rest = len(views) - _MAX_LISTED_VIEWS
    more = f" and {rest} more" if rest > 0 else ""
    return ", ".join(f"({v}, {u})" for v, u in views[:_MAX_LISTED_VIEWS]) + more


def _brightness_rows(report: LightFieldReport) -> Rows:
    """Return the spread of the brightness of the views, and the nearly black views."""
    low, high = report.brightness
    rows = []
    if math.isfinite(low) and low < high:
        rows.append(
            (
                "Brightness",
                f"of the views differs by {100 * (1 - low / high):.0f} %: their means are "
                f"{low:.2f} to {high:.2f} of the median",
            )
        )
    if report.nearly_black:
        from clplen.lightfield.axis_check.view_brightness import NEARLY_BLACK

        share = f"{len(report.nearly_black)} of {math.prod(report.shape[:2])}"
        rows.append(
            (
                "Nearly black",
                f"{share}, below {100 * NEARLY_BLACK:g} % of the median: "
                f"{_listed(report.nearly_black)}; exclude them with --aperture of depth, refocus "
                "and render",
            )
        )
    return rows


def order_rows(report: LightFieldReport, read_with: LayoutWords, sentence: str) -> Rows:
    """Return the range of disparities, and the sharpness of each order of the view axes."""
    from clplen.lightfield.axis_check.lightfield_report import combine_layout_words

    rows = []
    low, high = report.disparities
    if math.isfinite(low):
        rows.append(("Disparities", f"99 % of the pixels from {low:+.2f} to {high:+.2f}"))
    rows.append(("View axes", sentence))
    if report.orders:
        rows.append(("Orders", "  sharpness  disparity"))
    for order in sorted(report.orders, key=lambda order: -order.sharpness):
        flags = as_options(combine_layout_words(read_with, order.keywords)) or "(no option)"
        mark = "*" if order in report.best and report.verdict != "none" else " "
        text = f"{mark} {order.sharpness:9.3f}  {order.disparity:+9.2f}  {flags}"
        rows.append(("", text + ("" if order.keywords else "  as read")))
    return rows


def as_options(layout_words: LayoutWords) -> str:
    """Return layout settings as command-line options."""
    return " ".join("--" + word.replace("_", "-") for word in layout_words)
