"""What ``clplen info`` says of a light field, as rows of a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clplen.lightfield.axis_check.lightfield_report import LightFieldReport

Rows = list[tuple[str, str]]
Words = tuple[str, ...]

_LISTED = 12  # views that a line lists


def of_samples(report: LightFieldReport) -> Rows:
    """Views, their samples and brightness, and what is known of their places."""
    V, U, ny, nx = report.shape[:4]
    views, channels = V * U, report.shape[4:]
    rows = [
        ("Views", f"{V} x {U} (V x U) of {ny} x {nx} pixels, {(channels or (1,))[0]} channels"),
        ("Samples", f"{report.dtype}, {report.low:g} to {report.high:g}"),
    ]
    for label, flat in (("Dark views", report.dark), ("Constant views", report.constant)):
        rows.append((label, f"{len(flat)} of {views}: {_listed(flat)}" if flat else "none"))
    rows += _of_brightness(report)
    rows.append(("Left out", f"{report.left_out} of {views} views have weight 0"))
    spacing = "not known"
    if report.spacing is not None:
        spacing = ", ".join(
            f"{name} {1e6 * step:g} um"
            for name, step in zip(("dv", "du", "dy", "dx"), report.spacing, strict=True)
        )
    rows.append(("Spacing", spacing))
    if report.scattered:
        rows.append(("Positions", "each view has its own"))
    return rows


def _listed(views: Sequence[tuple[int, int]]) -> str:
    more = f" and {len(views) - _LISTED} more" if len(views) > _LISTED else ""
    return ", ".join(f"({v}, {u})" for v, u in views[:_LISTED]) + more


def _of_brightness(report: LightFieldReport) -> Rows:
    """How much the views differ, and which hold hardly any light."""
    low, high = report.brightness
    rows = []
    if math.isfinite(low) and low < high:
        rows.append(
            (
                "Brightness",
                f"of views differs by {100 * (1 - low / high):.0f} %: their means are {low:.2f} to "
                f"{high:.2f} of the median",
            )
        )
    if report.nearly_black:
        from clplen.lightfield.axis_check.view_brightness import NEARLY_BLACK

        share = f"{len(report.nearly_black)} of {math.prod(report.shape[:2])}"
        rows.append(
            (
                "Nearly black",
                f"{share}, below {100 * NEARLY_BLACK:g} % of the median: "
                f"{_listed(report.nearly_black)}; --aperture of depth, refocus and render leaves "
                "them out",
            )
        )
    return rows


def of_orders(report: LightFieldReport, read_with: Words, sentence: str) -> Rows:
    """The range of disparities, and how sharp each order of the view axes is."""
    from clplen.lightfield.axis_check.lightfield_report import combine_layout_words

    rows = []
    low, high = report.disparities
    if math.isfinite(low):
        rows.append(("Disparities", f"99 % of the pixels from {low:+.2f} to {high:+.2f}"))
    rows.append(("View axes", sentence))
    if report.orders:
        rows.append(("Orders", "  sharpness  disparity"))
    for order in sorted(report.orders, key=lambda order: -order.sharpness):
        words = typed(combine_layout_words(read_with, order.keywords)) or "(no word on the axes)"
        mark = "*" if order in report.best and report.verdict != "none" else " "
        text = f"{mark} {order.sharpness:9.3f}  {order.disparity:+9.2f}  {words}"
        rows.append(("", text + ("" if order.keywords else "  as read")))
    return rows


def typed(words: Words) -> str:
    """Words of layout as options."""
    return " ".join("--" + word.replace("_", "-") for word in words)
