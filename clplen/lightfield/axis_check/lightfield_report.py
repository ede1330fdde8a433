"""What a light field holds, and whether its view axes are read in the right order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.compute.device import DeviceLike
from clplen.lightfield.arrays.stored_samples import extremes
from clplen.lightfield.axis_check.axis_test import FARTHEST, AxisTest, Order, axis_test
from clplen.lightfield.axis_check.disparity_range import UNKNOWN, disparity_range
from clplen.lightfield.axis_check.view_brightness import nearly_black_views, relative_brightness
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import Spacing
from clplen.reprs import OneLine

View = tuple[int, int]
Words = tuple[str, ...]

_FARTHEST = 2.0  # disparity
_RECORDED = 0.5  # of one view's detail: what has more is in focus as it was recorded
_MIRRORED = (
    "Reversing both view axes only mirrors the disparities and cannot be seen without depth order"
)


@dataclass(frozen=True, repr=False)
class LightFieldReport(OneLine):
    """What `check_light_field` found.

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
        How many views have weight 0.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres.
    scattered : bool
        Whether the views have ``positions`` of their own.
    orders : tuple of Order
        The eight orders of the view axes, as read first; none where there is nothing to compare.
    best : tuple of Order
        The orders than which none is clearly sharper; all of them where nothing tells them apart.
    factor : float
        Sharpness of the best order over that of the next; nan without orders.
    verdict : {"fits", "wrong", "unclear", "none"}
        "fits": the light field as read, up to mirrored disparities, is the sharpest; "wrong":
        others are; "unclear": as sharp as others; "none": there is no evidence.
    reason : {"", "one view", "no detail", "in focus", "not in focus"}
        Why there is no evidence.
    disparities : tuple of float
        (low, high) between which 99 % of the pixels lie, by area, in pixels a view step; nan where
        the light field as read is not in focus, or where it is not known.
    nearly_black : tuple
        (v, u) of the views with a weight whose mean is below 2 % of the median of the views.
    brightness : tuple of float
        Mean of the darkest and of the brightest other view over that median; nan if all are black.

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

    def sentence(self, spelled: Callable[[Words], str] | None = None) -> str:
        """The verdict on the view axes.

        Parameters
        ----------
        spelled : callable, optional
            How words of layout are written: ("swap_uv", "flip_u") to text. By default as keywords
            of `read_lightfield`, for a light field that was read without any.

        Returns
        -------
        str
        """
        spell = spelled or _keywords
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
                f"sharp with {_any(self.best, spell)}."
            )
        else:
            others = [order for order in self.best if order.words not in ((), ("flip_v", "flip_u"))]
            text = (
                f"The view axes cannot be told: as sharp as they are read as with "
                f"{_any(others, spell)}."
            )
        if self.may_be_lawnmower:
            text += " Perhaps every other row of views is counted backwards (order 'lawnmower')."
        return f"{text} {_MIRRORED}."

    @property
    def factor_as_read(self) -> float:
        """Sharpness of the best order over that of the light field as read."""
        return self.best[0].sharpness / self.orders[0].sharpness if self.orders else float("nan")

    @property
    def may_be_lawnmower(self) -> bool:
        """Whether two orders that differ by one reversed axis are the sharpest alike."""
        groups = {order.group for order in self.best}
        swapped = {order.swap_uv for order in self.best}
        return len(groups) == 2 and len(swapped) == 1 and min(self.shape[:2]) > 1


def check_light_field(
    lf: LightField | ArrayLike, *, farthest: float = _FARTHEST, device: DeviceLike | None = None
) -> LightFieldReport:
    """Look at a light field: its samples, and which order of the view axes suits it.

    In each of the eight orders (axes swapped or not, each reversed or not) the middle of the light
    field, at most 10 x 10 views of 384 x 384 pixels, is refocused on many planes. What counts is
    the detail of each block of 16 pixels in its sharpest plane: in the right order every block has
    one, in a wrong one only what is in focus at disparity 0. An order is taken for the better one
    if it has 5 % more detail and gains half as much again over the picture as recorded, and this is
    no chance: in all a quarter of one view's detail, or four standard errors over the blocks.
    Reversing both axes only mirrors the disparities, nearer for farther, which no sharpness shows.

    The range of the disparities is that of a depth map of all of the views at reduced size.

    Parameters
    ----------
    lf : LightField or array_like
        The light field.
    farthest : float
        Planes from -farthest to farthest, in pixels a view step, are tried, and more, up to 8,
        while much of the detail is sharpest at an end.
    device : Device or str, optional
        Where an array goes; default ``Device.open()``. A light field brings its own.

    Returns
    -------
    Report
        What was found.

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
    if not 0 < farthest <= FARTHEST:
        raise ValueError(f"farthest lies above 0 and not above {FARTHEST:g}, not at {farthest!r}.")
    low, high = extremes(lf.data, lf.device)
    dark = (low == 0) & (high == 0)
    views = lf.shape[0] * lf.shape[1]
    brightness = relative_brightness(lf)
    dim = nearly_black_views(lf, brightness)
    even = brightness[(lf.weights > 0) & ~dim]
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
        brightness=(float(even.min()), float(even.max())) if even.size else (np.nan, np.nan),
    )


def combine_layout_words(first: Sequence[str], then: Sequence[str]) -> Words:
    """The words of layout that do what two sets of them do one after the other."""
    flips = [word in first for word in ("flip_v", "flip_u")]
    if "swap_uv" in then:
        flips.reverse()
    words = {
        "swap_uv": ("swap_uv" in first) != ("swap_uv" in then),
        "flip_v": flips[0] != ("flip_v" in then),
        "flip_u": flips[1] != ("flip_u" in then),
    }
    return tuple(word for word, holds in words.items() if holds)


_NO_EVIDENCE = {
    "one view": "There is one view only, so no order of views to check.",
    "no detail": "The view axes cannot be checked: the middle of the views has no detail.",
    "in focus": (
        "The view axes cannot be checked: the scene is nearly in focus at disparity 0, where every "
        f"order of views gives the same picture. {_MIRRORED}."
    ),
    "not in focus": (
        "No order of the view axes brings the scene into focus: perhaps the views are numbered in "
        "another way (pattern, views, order 'lawnmower'), or there is only noise."
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


def _keywords(words: Words) -> str:
    return ", ".join(f"{word}=True" for word in words) or "no words"


def _any(orders: Sequence[Order], spell: Callable[[Words], str]) -> str:
    """Orders with their disparities, the shortest words first, those that do the same once."""
    short: dict[tuple[int, float], Order] = {}
    for order in sorted(orders, key=lambda order: len(spell(order.words))):
        short.setdefault((order.group, order.disparity), order)
    return ", or ".join(f"{spell(o.words)} (at {o.disparity:+.2f})" for o in short.values())
