"""Report on a light field: its samples and the order of its view axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.compute.device import DeviceLike
from clplen.lightfield.arrays.stored_samples import extremes
from clplen.lightfield.axis_check.axis_test import MAX_DISPARITY, AxisTest, Order, axis_test
from clplen.lightfield.axis_check.disparity_range import UNKNOWN, disparity_range
from clplen.lightfield.axis_check.view_brightness import nearly_black_views, relative_brightness
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import Spacing
from clplen.reprs import OneLine

View = tuple[int, int]
LayoutWords = tuple[str, ...]

_FARTHEST = 2.0  # pixels a view step
_RECORDED = 0.5  # of one view's detail: a sharper picture is in focus as recorded
_MIRRORED = (
    "Reversing both view axes exchanges near and far at equal sharpness: check an object that is "
    "known to be nearer"
)


@dataclass(frozen=True, repr=False)
class LightFieldReport(OneLine):
    """Result of `check_light_field`.

    Attributes
    ----------
    shape : tuple of int
        (v, u, y, x[, c]).
    dtype : str
    low, high : float
        Smallest and largest sample.
    dark, constant : tuple
        (v, u) of the views that are 0, or of one other value, throughout.
    left_out : int
        Number of views with weight 0.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres.
    scattered : bool
        Flag that the views have ``positions`` off the grid.
    orders : tuple of Order
        The eight orders of the view axes, unchanged order first; empty without evidence.
    best : tuple of Order
        Orders that no other clearly exceeds in sharpness; all orders where they are equal.
    factor : float
        Sharpness of the best order over the next; nan without orders.
    verdict : {"fits", "wrong", "unclear", "none"}
        "fits": the order as read is the sharpest (up to mirrored disparities); "wrong": another
        is; "unclear": another is as sharp; "none": no evidence.
    reason : {"", "one view", "no detail", "in focus", "not in focus"}
        Reason for the lack of evidence.
    disparities : tuple of float
        Disparities (low, high) that enclose 99 % of the pixels, by area, in pixels a view step; nan
        if unknown or if the light field is not in focus as read.
    nearly_black : tuple
        (v, u) of weighted views whose mean is below 2 % of the median over the views.
    brightness : tuple of float
        Mean of the darkest and the brightest other view over that median; nan if all are black.

    Examples
    --------
    >>> scene = next(clplen.cameras.sample_scenes(1, (48, 48)))
    >>> lf, _ = scene.scene.light_field((5, 5), (48, 48))
    >>> report = clplen.lightfield.check_light_field(lf)
    >>> report.shape, report.left_out
    ((5, 5, 48, 48, 3), 0)
    """

    shape: tuple[int, ...]
    dtype: str
    low: float
    high: float
    dark: tuple[View, ...]
    constant: tuple[View, ...]
    left_out: int
    spacing: Spacing | None
    scattered: bool
    orders: tuple[Order, ...]
    best: tuple[Order, ...]
    factor: float
    verdict: str
    reason: str
    disparities: tuple[float, float]
    nearly_black: tuple[View, ...]
    brightness: tuple[float, float]

    def __str__(self) -> str:
        return self.sentence()

    def sentence(self, spelled: Callable[[LayoutWords], str] | None = None) -> str:
        """Return the verdict on the view axes.

        Parameters
        ----------
        spelled : callable, optional
            Function that writes layout keywords, such as ("swap_uv", "flip_u"), as text. By default
            they are written as keywords of `read_lightfield`.

        Returns
        -------
        str
        """
        spell_keywords = spelled or _keywords
        if self.verdict == "none":
            return _NO_EVIDENCE[self.reason]
        if self.verdict == "fits":
            text = (
                f"The view axes fit as they are read: sharpest at disparity "
                f"{self.orders[0].disparity:+.2f}, {self.factor:.2g} times as sharp as in the "
                "next order."
            )
        elif self.verdict == "wrong":
            text = (
                f"The view axes do not fit as they are read: {self.factor_as_read:.2g} times as "
                f"sharp with {_any(self.best, spell_keywords)}."
            )
        else:
            others = [
                order for order in self.best if order.keywords not in ((), ("flip_v", "flip_u"))
            ]
            text = (
                f"The view axes cannot be determined: as sharp as read as with "
                f"{_any(others, spell_keywords)}."
            )
        if self.may_be_lawnmower:
            text += " Every other row of views may run backwards (order 'lawnmower')."
        return f"{text} {_MIRRORED}."

    @property
    def factor_as_read(self) -> float:
        """Sharpness of the best order over that of the order as read."""
        return self.best[0].sharpness / self.orders[0].sharpness if self.orders else float("nan")

    @property
    def may_be_lawnmower(self) -> bool:
        """Flag that two equally sharp orders differ by one reversed axis."""
        groups = {order.group for order in self.best}
        swapped = {order.swap_uv for order in self.best}
        return len(groups) == 2 and len(swapped) == 1 and min(self.shape[:2]) > 1


def check_light_field(
    lf: LightField | ArrayLike, *, farthest: float = _FARTHEST, device: DeviceLike | None = None
) -> LightFieldReport:
    """Check the samples of a light field and the order of its view axes.

    The middle of the light field, at most 10 x 10 views of 384 x 384 pixels, is refocused on many
    planes in each of the eight orders (axes swapped or not, each reversed or not). The measure is
    the detail of each block of 16 pixels in its sharpest plane. An order is better if it has 5 %
    more detail and gains 50 % more over the picture as recorded, by a quarter of one view's detail
    or by four standard errors over the blocks. Reversing both axes swaps near and far without
    changing the sharpness.

    The range of the disparities comes from a depth map of all views at reduced size.

    Parameters
    ----------
    lf : LightField or array_like
        The light field.
    farthest : float
        Largest disparity of the planes, in pixels a view step. The search extends up to 8 while
        much of the detail is sharpest at an end.
    device : Device or str, optional
        Device for an array; default ``Device.open()``. A light field stays on its device.

    Returns
    -------
    LightFieldReport
        The verdict with the figures behind it.

    Raises
    ------
    ValueError
        If ``farthest`` is not between 0 and 8.

    Examples
    --------
    >>> scene = next(clplen.cameras.sample_scenes(1, (48, 48)))
    >>> lf, _ = scene.scene.light_field((5, 5), (48, 48))
    >>> clplen.lightfield.check_light_field(lf).left_out
    0
    """
    lf = as_lightfield(lf, device=device)
    if not 0 < farthest <= MAX_DISPARITY:
        raise ValueError(
            f"farthest must be above 0 and at most {MAX_DISPARITY:g}, got {farthest!r}."
        )
    low, high = extremes(lf.data, lf.device)
    dark = (low == 0) & (high == 0)
    views = lf.shape[0] * lf.shape[1]
    brightness = relative_brightness(lf)
    dim = nearly_black_views(lf, brightness)
    other_brightness = brightness[(lf.weights > 0) & ~dim]
    test = axis_test(lf, farthest=farthest) if views > 1 else AxisTest((), 0, frozenset(), np.nan)
    verdict, reason = _verdict(test) if views > 1 else ("none", "one view")
    in_focus = verdict in ("fits", "unclear") or reason == "in focus"
    return LightFieldReport(
        shape=lf.shape,
        dtype=str(lf.dtype),
        low=float(low.min()),
        high=float(high.max()),
        dark=_listed(dark),
        constant=_listed((low == high) & ~dark),
        left_out=int(np.count_nonzero(lf.weights == 0)),
        spacing=lf.spacing,
        scattered=lf.positions is not None,
        orders=test.orders,
        best=tuple(order for order in test.orders if order.group in test.best),
        factor=test.factor,
        verdict=verdict,
        reason=reason,
        disparities=disparity_range(lf, farthest=farthest) if in_focus else UNKNOWN,
        nearly_black=_listed(dim),
        brightness=(float(other_brightness.min()), float(other_brightness.max()))
        if other_brightness.size
        else (np.nan, np.nan),
    )


def combine_layout_words(first: Sequence[str], then: Sequence[str]) -> LayoutWords:
    """Return the layout keywords equal to applying two sets of them in turn."""
    flips = [word in first for word in ("flip_v", "flip_u")]
    if "swap_uv" in then:
        flips.reverse()
    settings = {
        "swap_uv": ("swap_uv" in first) != ("swap_uv" in then),
        "flip_v": flips[0] != ("flip_v" in then),
        "flip_u": flips[1] != ("flip_u" in then),
    }
    return tuple(word for word, is_set in settings.items() if is_set)


_NO_EVIDENCE = {
    "one view": "The view axes cannot be checked: there is only one view.",
    "no detail": "The view axes cannot be checked: the middle of the views has no detail.",
    "in focus": (
        "The view axes cannot be checked: the scene is nearly in focus at disparity 0, where every "
        f"order of views gives the same picture. {_MIRRORED}."
    ),
    "not in focus": (
        "No order of the view axes brings the scene into focus. Check the numbering of the views "
        "(pattern, views, order 'lawnmower'); the views may also be pure noise."
    ),
}


def _verdict(test: AxisTest) -> tuple[str, str]:
    if not test.orders:
        return "none", "no detail"
    groups = {order.group for order in test.orders}
    if test.best == groups:
        return "none", "in focus" if test.recorded >= _RECORDED else "not in focus"
    if test.orders[0].group not in test.best:
        return "wrong", ""
    return ("fits" if len(test.best) == 1 else "unclear"), ""


def _listed(views: np.ndarray[Any, Any]) -> tuple[View, ...]:
    return tuple((int(v), int(u)) for v, u in zip(*np.nonzero(views), strict=True))


def _keywords(keywords: LayoutWords) -> str:
    return ", ".join(f"{word}=True" for word in keywords) or "no words"


def _any(orders: Sequence[Order], spell: Callable[[LayoutWords], str]) -> str:
    """List orders with their disparities, shortest keywords first, without duplicates."""
    distinct: dict[tuple[int, float], Order] = {}
    for order in sorted(orders, key=lambda order: len(spell(order.keywords))):
        distinct.setdefault((order.group, order.disparity), order)
    return ", or ".join(f"{spell(o.keywords)} (at {o.disparity:+.2f})" for o in distinct.values())
