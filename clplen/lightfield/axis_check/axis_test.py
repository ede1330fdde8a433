"""Which order of its view axes brings a light field into focus."""

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
FARTHEST = 8.0  # furthest disparity that is tried

_SHARPER = 1.05  # times the other order's detail, and
_GAINED = 1.5  # times what the other gains over the picture as recorded,
_SURE = 0.25  # of one view's detail, or else
_ERRORS = 4.0  # standard errors of the difference over the blocks: no chance
_LUMA = (0.2126, 0.7152, 0.0722)  # Rec. ITU-R BT.709
_HIGH_PASS = 2.0  # pixels, as in sharpness_curve
_MOST_VIEWS = 10  # along an axis: the middle ones
_MOST_PIXELS = 384  # along an axis: the middle of the views
_BLOCK = 16  # pixels, which have one disparity in common
_STEP = 1 / 8
_BORDER = 6  # pixels beyond the largest shift
_SHARED = 1 / 3  # of a picture, that the outermost view moves at most
_AT_ONCE = 16  # planes of one stack
_AT_ENDS = 0.1  # of the detail: so much at the ends of the planes asks for more of them
_ROUNDING = 1e-12  # of the largest sample squared: less is no detail
_OUTER = (0.05, 0.95)  # of the detail, between which the disparities lie


@dataclass(frozen=True)
class Order:
    """One of the eight ways to take the view axes, applied to a light field as it is."""

    # swap_uv, flip_v, flip_u: Words of layout: axes swapped first, then the resulting ones reversed
    swap_uv: bool
    flip_v: bool
    flip_u: bool
    sharpness: float  # Detail of the sharpest plane of each block of pixels, over that of one view
    disparity: float  # Where the picture as a whole is sharpest, in pixels a view step
    # (low, high) disparity between which nine tenths of the detail are sharpest
    span: tuple[float, float]
    group: int  # Orders of one group cannot be told apart: reversing both axes mirrors disparities

    @property
    def words(self) -> tuple[str, ...]:
        """The words of layout that it takes."""
        return tuple(word for word in LAYOUT_WORDS if getattr(self, word))


@dataclass(frozen=True)
class AxisTest:
    """Made by `axis_test`."""

    orders: tuple[Order, ...]  # All eight, as read first; none where the views have no detail
    recorded: float  # Sharpness at disparity 0, which is that of every order
    # The groups than which none is clearly sharper; all of them where there is no evidence
    best: frozenset[int]
    factor: float  # Sharpness of the best group over that of the next; nan if there is only one


def axis_test(lf: LightField, *, farthest: float) -> AxisTest:
    """Refocus the middle of a light field in every order of its view axes."""
    data, weights, places = _middle(lf)
    pictures = _Pictures(lf, data, weights)
    one = pictures.of_one_view(places)
    if not one > _ROUNDING * float(np.abs(data).max()) ** 2:
        return AxisTest((), 0.0, frozenset(), math.nan)
    groups: list[tuple[Real, _Focus]] = []
    orders = []
    for words in product((False, True), (False, True), (False, True)):
        own = _reordered(places, *words)
        group, sign = _find(groups, own)
        if sign == 0:
            groups.append((own, pictures.focus(own, farthest)))
            sign = 1
        orders.append(groups[group][1].order(words, group, sign, one))
    focuses = [focus for _, focus in groups]
    best, factor = _compare(focuses, one)
    return AxisTest(tuple(orders), focuses[0].recorded / one, best, factor)


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
        """Share of the detail whose sharpest plane is the first or the last."""
        peaks = self.detail.argmax(axis=0)
        energy = self.detail.max(axis=0)
        return float(energy[(peaks == 0) | (peaks == len(self.planes) - 1)].sum() / energy.sum())

    def order(self, words: tuple[bool, bool, bool], group: int, sign: int, one: float) -> Order:
        curve = self.detail.mean(axis=1)
        i = int(curve.argmax())
        peak = self.planes[i]
        if 0 < i < len(curve) - 1:
            a, b, c = curve[i - 1 : i + 2]
            peak += _STEP * (a - c) / (2 * (a - 2 * b + c)) if a + c < 2 * b else 0
        low, high = self._span()
        span = (low, high) if sign > 0 else (0.0 - high, 0.0 - low)
        return Order(*words, self.sharpness / one, float(sign * peak) + 0.0, span, group)

    def _span(self) -> tuple[float, float]:
        peaks, energy = self.planes[self.detail.argmax(axis=0)], self.detail.max(axis=0)
        rising = np.argsort(peaks)
        part = np.cumsum(energy[rising]) / energy.sum()
        low, high = (int(np.searchsorted(part, share)) for share in _OUTER)
        return float(peaks[rising][low]), float(peaks[rising][min(high, len(peaks) - 1)])


class _Pictures:
    """Refocused pictures of grey views from places that are not theirs."""

    def __init__(self, lf: LightField, data: Any, weights: Any) -> None:
        self._device, self._data, self._weights = lf.device, lf.device.upload(data), weights
        self._measure = LocalEnergy(_HIGH_PASS, data.shape[2:], device=lf.device)
        self._energy = lf.device.empty((_AT_ONCE, *data.shape[2:]), np.float32)
        steps = _outermost(weights.shape)
        self._limit = search_limit(weights.shape, data.shape[2:])
        border = math.ceil(self._limit * steps) + _BORDER
        self._inside = tuple(
            slice(edge, n - edge) for n in data.shape[2:] for edge in [min(border, n // 4)]
        )

    def of_one_view(self, places: Real) -> float:
        """Detail of the view next to the middle, blurred like all pictures."""
        view = np.argmin(np.where(self._weights > 0, (places**2).sum(axis=-1), np.inf))
        alone = np.zeros_like(self._weights)
        alone.flat[view] = 1
        return float(self._detail(np.zeros_like(places), np.zeros(1), alone).mean())

    def focus(self, places: Real, farthest: float) -> _Focus:
        while True:
            farthest = min(farthest, self._limit)
            count = max(1, round(farthest / _STEP))
            planes = np.arange(-count, count + 1.0) * _STEP
            found = _Focus(planes, self._detail(places, planes, self._weights))
            if farthest >= self._limit or found.at_ends < _AT_ENDS:
                return found
            farthest *= 2

    def _detail(self, places: Real, planes: Real, weights: Any) -> Real:
        lf = LightField(
            self._data, self._device, None, weights.astype(np.float32), positions=places
        )
        blocks = []
        for first in range(0, len(planes), _AT_ONCE):
            some = planes[first : first + _AT_ONCE]
            stack = stack_on_planes(lf, some, lf.alpha(some), lf.weights)
            self._measure(self._energy, stack, start=0, count=stack.shape[0])
            for energy in self._device.download(self._energy)[: stack.shape[0]]:
                blocks.append(_in_blocks(energy[self._inside]))
        return np.array(blocks)


def _in_blocks(energy: Any) -> Real:
    """Means over blocks, one row of them."""
    ny, nx = (n // _BLOCK for n in energy.shape)
    if ny * nx == 0:
        return np.array([energy.mean(dtype=np.float64)])
    whole = energy[: ny * _BLOCK, : nx * _BLOCK].astype(np.float64)
    return whole.reshape(ny, _BLOCK, nx, _BLOCK).mean(axis=(1, 3)).ravel()


def _middle(lf: LightField) -> tuple[Any, Any, Real]:
    """(grey views, weights, places) of the middle of a light field."""
    V, U, ny, nx = lf.shape[:4]
    v, u = (slice((n - most) // 2, (n + most) // 2) for n, most in ((V, _odd(V)), (U, _odd(U))))
    y, x = (slice(max(0, (n - _MOST_PIXELS) // 2), (n + _MOST_PIXELS) // 2) for n in (ny, nx))
    if not lf.weights[v, u].any():
        v = u = slice(None)
    places = -unit_steps(lf)[v, u]
    weights = np.array(lf.weights[v, u])
    views = [(i, k) for i in range(V)[v] for k in range(U)[u]]
    grey = [
        grey_picture(lf.device.download(plane(lf.data, {0: i, 1: k}, (2, 3), lf.device))[y, x])
        for i, k in views
    ]
    return np.array(grey).reshape(*weights.shape, *grey[0].shape), weights, places


def _odd(n: int) -> int:
    """Views of an axis that are taken, as many on both sides of the middle."""
    return min(n, _MOST_VIEWS - (n - _MOST_VIEWS) % 2)


def search_limit(views: tuple[int, ...], size: tuple[int, ...]) -> float:
    """Largest disparity that is tried; at most a third of a picture in the outermost view."""
    return min(FARTHEST, _SHARED * min(size) / _outermost(views))


def _outermost(views: tuple[int, ...]) -> float:
    """View steps from the middle to the outermost view."""
    return max(max(views) - 1, 1) / 2


def grey_picture(picture: Any) -> Any:
    """Luma of three colours, or the mean of other channels."""
    if picture.ndim == 2:
        return picture
    share = _LUMA if picture.shape[2] == 3 else np.full(picture.shape[2], 1 / picture.shape[2])
    return picture @ np.array(share, np.float32)


def _reordered(places: Real, swap_uv: bool, flip_v: bool, flip_u: bool) -> Real:
    """Where the views would lie if the axes were read in another order."""
    own = places[..., ::-1] if swap_uv else places
    return own * np.array([-1 if flip_v else 1, -1 if flip_u else 1])


def _find(groups: list[tuple[Real, _Focus]], own: Real) -> tuple[int, int]:
    """(group, 1 or -1) of places that are there already or mirrored; (next one, 0) if not."""
    for group, (places, _) in enumerate(groups):
        for sign in (1, -1):
            if np.allclose(places, sign * own):
                return group, sign
    return len(groups), 0


def _compare(focuses: list[_Focus], one: float) -> tuple[frozenset[int], float]:
    """(groups that may be right, factor from the best to the next)."""
    best = max(focuses, key=lambda focus: focus.sharpness)
    alike = frozenset(
        group for group, focus in enumerate(focuses) if not _is_clear(best, focus, one)
    )
    if len(focuses) == 1:
        return alike, math.nan
    others = [focus.sharpness for group, focus in enumerate(focuses) if group not in alike]
    second = max(others) if others else sorted(focus.sharpness for focus in focuses)[-2]
    return alike, best.sharpness / second


def _is_clear(best: _Focus, other: _Focus, one: float) -> bool:
    """Whether one order is sharper than another and this is no chance."""
    more = best.detail.max(axis=0) - other.detail.max(axis=0)
    error = more.std() / math.sqrt(max(more.size - 1, 1))
    return (
        best.sharpness > _SHARPER * other.sharpness
        and best.sharpness - best.recorded > _GAINED * (other.sharpness - other.recorded)
        and (best.sharpness > _SURE * one or more.mean() > _ERRORS * error > 0)
    )
