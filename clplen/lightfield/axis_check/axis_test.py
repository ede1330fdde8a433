"""Comparison of the orders of the view axes by the sharpness of refocused pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from clplen.lightfield.arrays.stored_samples import plane
from clplen.lightfield.depth.energy_cue import LocalEnergy
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import stack_on_planes

Real = np.ndarray[Any, np.dtype[np.float64]]

LAYOUT_WORDS = ("swap_uv", "flip_v", "flip_u")
MAX_DISPARITY = 8.0  # pixels a view step: largest disparity that is tested

_MIN_DETAIL_RATIO = 1.05  # times the detail of the other order, and
_MIN_GAIN_RATIO = 1.5  # times the gain of the other order over the picture as recorded,
_MIN_MEAN_GAIN = 0.25  # of the detail of one view, or else
_MIN_STANDARD_ERRORS = 4.0  # standard errors of the difference over the blocks
_LUMA = (0.2126, 0.7152, 0.0722)  # Rec. ITU-R BT.709
_HIGH_PASS = 2.0  # pixels, as in sharpness_curve
_MAX_VIEWS = 10  # along an axis, centred
_MAX_PIXELS = 384  # along an axis, centred
_BLOCK = 16  # pixels: side of a block, which is given one disparity
_STEP = 1 / 8  # pixels a view step between planes
_BORDER = 6  # pixels beyond the largest shift
_MAX_SHIFT = 1 / 3  # of a picture: largest shift of the outermost view
_STACK_PLANES = 16  # planes of one stack
# Of the detail: a larger share at the first and last planes extends the search
_MAX_END_SHARE = 0.1
_ROUNDING = 1e-12  # of the largest sample squared: detail below it is rounding
_DISPARITY_QUANTILES = (0.05, 0.95)  # quantiles of the detail between which the disparities lie


@dataclass(frozen=True)
class Order:
    """Reading of the view axes of a light field, out of eight."""

    # swap_uv, flip_v, flip_u: axes are swapped first, then reversed
    swap_uv: bool
    flip_v: bool
    flip_u: bool
    sharpness: float  # Detail of the sharpest plane of each block of pixels, relative to one view
    disparity: float  # Sharpest disparity of the whole picture, in pixels a view step
    # (low, high) disparity that encloses nine tenths of the sharpest detail
    span: tuple[float, float]
    group: int  # Shared by orders that differ by reversing both axes (mirrored disparities)

    @property
    def keywords(self) -> tuple[str, ...]:
        """Layout keywords of this order."""
        return tuple(word for word in LAYOUT_WORDS if getattr(self, word))


@dataclass(frozen=True)
class AxisTest:
    """Result of `axis_test`."""

    orders: tuple[Order, ...]  # All eight, unchanged order first; empty if the views have no detail
    recorded: float  # Sharpness at disparity 0, equal for every order
    # Groups that no other clearly exceeds in sharpness; all groups without evidence
    best: frozenset[int]
    factor: float  # Sharpness of the best group over the next; nan for a single group


def axis_test(lf: LightField, *, farthest: float) -> AxisTest:
    """Refocus the middle of a light field in every order of its view axes."""
    data, weights, positions = _middle(lf)
    pictures = _Pictures(lf, data, weights)
    reference = pictures.of_one_view(positions)
    if not reference > _ROUNDING * float(np.abs(data).max()) ** 2:
        return AxisTest((), 0.0, frozenset(), math.nan)
    groups: list[tuple[Real, _Focus]] = []
    orders = []
    for flags in product((False, True), (False, True), (False, True)):
        reordered = _reordered(positions, *flags)
        group, sign = _find(groups, reordered)
        if sign == 0:
            groups.append((reordered, pictures.focus(reordered, farthest)))
            sign = 1
        orders.append(groups[group][1].order(flags, group, sign, reference))
    focuses = [focus for _, focus in groups]
    best, factor = _compare(focuses, reference)
    return AxisTest(tuple(orders), focuses[0].recorded / reference, best, factor)


@dataclass(frozen=True)
class _Focus:
    """Detail of every block on every plane."""

    planes: Real
    detail: Real  # (planes, blocks)

    @property
    def sharpness(self) -> float:
        return float(self.detail.max(axis=0).mean())

    @property
    def recorded(self) -> float:
        return float(self.detail[np.abs(self.planes).argmin()].mean())

    @property
    def at_ends(self) -> float:
        """Share of the detail that is sharpest on the first or the last plane."""
        peaks = self.detail.argmax(axis=0)
        energy = self.detail.max(axis=0)
        return float(energy[(peaks == 0) | (peaks == len(self.planes) - 1)].sum() / energy.sum())

    def order(
        self, flags: tuple[bool, bool, bool], group: int, sign: int, reference: float
    ) -> Order:
        curve = self.detail.mean(axis=1)
        i = int(curve.argmax())
        peak = self.planes[i]
        if 0 < i < len(curve) - 1:
            a, b, c = curve[i - 1 : i + 2]
            peak += _STEP * (a - c) / (2 * (a - 2 * b + c)) if a + c < 2 * b else 0
        low, high = self._span()
        span = (low, high) if sign > 0 else (0.0 - high, 0.0 - low)
        return Order(*flags, self.sharpness / reference, float(sign * peak) + 0.0, span, group)

    def _span(self) -> tuple[float, float]:
        peaks, energy = self.planes[self.detail.argmax(axis=0)], self.detail.max(axis=0)
        rising = np.argsort(peaks)
        part = np.cumsum(energy[rising]) / energy.sum()
        low, high = (int(np.searchsorted(part, share)) for share in _DISPARITY_QUANTILES)
        return float(peaks[rising][low]), float(peaks[rising][min(high, len(peaks) - 1)])


class _Pictures:
    """Refocused pictures of grey views at freely chosen positions."""

    def __init__(self, lf: LightField, data: Any, weights: Any) -> None:
        self._device, self._data, self._weights = lf.device, lf.device.upload(data), weights
        self._measure = LocalEnergy(_HIGH_PASS, data.shape[2:], device=lf.device)
        self._energy = lf.device.empty((_STACK_PLANES, *data.shape[2:]), np.float32)
        steps = _outermost(weights.shape)
        self._limit = search_limit(weights.shape, data.shape[2:])
        border = math.ceil(self._limit * steps) + _BORDER
        self._inside = tuple(
            slice(edge, n - edge) for n in data.shape[2:] for edge in [min(border, n // 4)]
        )

    def of_one_view(self, positions: Real) -> float:
        """Return the detail of the view next to the middle, blurred like all pictures."""
        view = np.argmin(np.where(self._weights > 0, (positions**2).sum(axis=-1), np.inf))
        weights = np.zeros_like(self._weights)
        weights.flat[view] = 1
        return float(self._detail(np.zeros_like(positions), np.zeros(1), weights).mean())

    def focus(self, positions: Real, farthest: float) -> _Focus:
        while True:
            farthest = min(farthest, self._limit)
            count = max(1, round(farthest / _STEP))
            planes = np.arange(-count, count + 1.0) * _STEP
            focus = _Focus(planes, self._detail(positions, planes, self._weights))
            if farthest >= self._limit or focus.at_ends < _MAX_END_SHARE:
                return focus
            farthest *= 2

    def _detail(self, view_positions: Real, planes: Real, weights: Any) -> Real:
        lf = LightField(
            self._data, self._device, None, weights.astype(np.float32), positions=view_positions
        )
        blocks = []
        for first in range(0, len(planes), _STACK_PLANES):
            part = planes[first : first + _STACK_PLANES]
            stack = stack_on_planes(lf, part, lf.alpha(part), lf.weights)
            self._measure(self._energy, stack, start=0, count=stack.shape[0])
            for energy in self._device.download(self._energy)[: stack.shape[0]]:
                blocks.append(_in_blocks(energy[self._inside]))
        return np.array(blocks)


def _in_blocks(energy: Any) -> Real:
    """Return the means over blocks in one row."""
    ny, nx = (n // _BLOCK for n in energy.shape)
    if ny * nx == 0:
        return np.array([energy.mean(dtype=np.float64)])
    cropped = energy[: ny * _BLOCK, : nx * _BLOCK].astype(np.float64)
    return cropped.reshape(ny, _BLOCK, nx, _BLOCK).mean(axis=(1, 3)).ravel()


def _middle(lf: LightField) -> tuple[Any, Any, Real]:
    """Return the grey views, weights and positions of the middle of a light field."""
    V, U, ny, nx = lf.shape[:4]
    v, u = (slice((n - count) // 2, (n + count) // 2) for n, count in ((V, _odd(V)), (U, _odd(U))))
    y, x = (slice(max(0, (n - _MAX_PIXELS) // 2), (n + _MAX_PIXELS) // 2) for n in (ny, nx))
    if not lf.weights[v, u].any():
        v = u = slice(None)
    positions = -unit_steps(lf)[v, u]
    weights = np.array(lf.weights[v, u])
    views = [(i, k) for i in range(V)[v] for k in range(U)[u]]
    grey = [
        grey_picture(lf.device.download(plane(lf.data, {0: i, 1: k}, (2, 3), lf.device))[y, x])
        for i, k in views
    ]
    return np.array(grey).reshape(*weights.shape, *grey[0].shape), weights, positions


def _odd(n: int) -> int:
    """Return the number of views of an axis in use, symmetric about the middle."""
    return min(n, _MAX_VIEWS - (n - _MAX_VIEWS) % 2)


def search_limit(views: tuple[int, ...], size: tuple[int, ...]) -> float:
    """Return the largest disparity to test: at most a third of a picture in the outermost view."""
    return min(MAX_DISPARITY, _MAX_SHIFT * min(size) / _outermost(views))


def _outermost(views: tuple[int, ...]) -> float:
    """Return the view steps from the middle to the outermost view."""
    return max(max(views) - 1, 1) / 2


def grey_picture(picture: Any) -> Any:
    """Return the luma of three colours, or the mean of other channels."""
    if picture.ndim == 2:
        return picture
    share = _LUMA if picture.shape[2] == 3 else np.full(picture.shape[2], 1 / picture.shape[2])
    return picture @ np.array(share, np.float32)


def _reordered(positions: Real, swap_uv: bool, flip_v: bool, flip_u: bool) -> Real:
    """Return the positions of the views for another order of the axes."""
    axes = positions[..., ::-1] if swap_uv else positions
    return axes * np.array([-1 if flip_v else 1, -1 if flip_u else 1])


def _find(groups: list[tuple[Real, _Focus]], candidate: Real) -> tuple[int, int]:
    """Return (group, sign) of positions equal to a group's or mirrored, else (new group, 0)."""
    for group, (positions, _) in enumerate(groups):
        for sign in (1, -1):
            if np.allclose(positions, sign * candidate):
                return group, sign
    return len(groups), 0


def _compare(focuses: list[_Focus], reference: float) -> tuple[frozenset[int], float]:
    """Return (groups that may be right, sharpness of the best group over the next)."""
    best = max(focuses, key=lambda focus: focus.sharpness)
    candidates = frozenset(
        group for group, focus in enumerate(focuses) if not _is_clear(best, focus, reference)
    )
    if len(focuses) == 1:
        return candidates, math.nan
    others = [focus.sharpness for group, focus in enumerate(focuses) if group not in candidates]
    second = max(others) if others else sorted(focus.sharpness for focus in focuses)[-2]
    return candidates, best.sharpness / second


def _is_clear(best: _Focus, other: _Focus, reference: float) -> bool:
    """Return True if an order is significantly sharper than another."""
    gain = best.detail.max(axis=0) - other.detail.max(axis=0)
    error = gain.std() / math.sqrt(max(gain.size - 1, 1))
    return (
        best.sharpness > _MIN_DETAIL_RATIO * other.sharpness
        and best.sharpness - best.recorded > _MIN_GAIN_RATIO * (other.sharpness - other.recorded)
        and (
            best.sharpness > _MIN_MEAN_GAIN * reference
            or gain.mean() > _MIN_STANDARD_ERRORS * error > 0
        )
    )
