"""Matching of neighbouring lenslets of a focused camera: costs of planes and refinement.

Neighbouring lenslets of one type see the points between them at positions shifted, relative to the
centres, by ratio times their distance: see kernels/focused_depth.cl.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from clplen.lightfield.focused.focused_geometry import (
    FocusedGeometry,
    Integers,
    Values,
    same_type_steps,
    white_level,
)
from clplen.lightfield.raw.raw_image import RawImage

Mask = np.ndarray[Any, np.dtype[np.bool_]]

_RIM = 1.0  # pixels excluded at the border of a sub-image
_STEP = 0.75  # pixels between planes, for the farthest pair
_MAX_MIDDLE_DISTANCE = 0.75  # pitches: maximum distance of a pair's middle from the lenslet
_MAX_DISTANCE_RATIO = 2.1  # times the nearest distance: maximum for pairs of the refinement
_MAX_PITCHES = 4.0  # pitches: search radius for lenslets of one type
_ROUNDS = 5
_MAX_RIM_M = 0.4  # abs(m): largest rim that is excluded
_MIN_WHITE = 0.2  # of the brightest: floor of a white image
_NOISE = 0.004  # of the brightest pixels: texture below is noise


@dataclass(frozen=True)
class Match:
    """Refined match of each lenslet, arrays of shape (lines, lenslets).

    The ratio, and sum e^2, sum e'^2, sum A^2 + B^2 and sum w of focused_depth.cl.
    """

    ratio: Values
    difference: Values
    slope: Values
    energy: Values
    weight: Values

    @property
    def score(self) -> Values:
        """Normalised mismatch: 0 for equal sides, 1 for unrelated ones."""
        return np.divide(
            self.difference,
            self.energy,
            out=np.full_like(self.difference, 2.0),
            where=self.energy > 0,
        )

    @property
    def deviation(self) -> Values:
        """Standard deviation of the ratio, from the residuals."""
        under = self.weight * self.slope
        variance = np.divide(
            self.difference, under, out=np.full_like(under, np.inf), where=under > 0
        )
        return np.sqrt(variance)

    def where(self, keep: Mask, other: Match) -> Match:
        """Return this match where ``keep`` is true, else the other."""
        pairs = zip(_fields(self), _fields(other), strict=True)
        return Match(*(np.where(keep, a, b) for a, b in pairs))


class Matcher:
    """Comparison of all lenslets of one raw image with their neighbours.

    Attributes
    ----------
    step : float
        Largest change of the ratio in an iteration: a pixel for the nearest pairs.
    lit : tuple of float
        Kernel arguments rim, shrink and least: the evenly lit part of a sub-image.
    near, pairs : numpy.ndarray
        Pairs (i, j, i, j) of lenslets relative to a lenslet's indices, int32, shape (n, 4): the
        nearest pairs, and pairs up to twice as far apart.
    """

    def __init__(
        self, raw: RawImage, geometry: FocusedGeometry, window: float, white: Any = None
    ) -> None:
        self.raw = raw if white is None else _divide_by_white(raw, white)
        self.geometry, self.window = geometry, window
        self.lit = (geometry.pitch / 2 - _RIM, *self._shrink(white is not None))
        steps = sorted(same_type_steps(geometry, _MAX_PITCHES), key=self._length)
        if not steps:
            raise ValueError(
                "Depth needs lenslets of one type near each other, and this sensor has none."
            )
        nearest = self._length(steps[0])
        near = [step for step in steps if self._length(step) < 1.2 * nearest]
        self.near = self._pairs_of(near)
        self.pairs = self._pairs_of(
            [s for s in steps if self._length(s) < _MAX_DISTANCE_RATIO * nearest]
        )
        self.step = 1 / (max(map(self._length, near)) * geometry.pitch)
        self._tables = geometry.tables(raw.device)
        self._defines = {"CHANNELS": 3} if len(raw.data.shape) == 3 else {}

    def planes(self, low: float, high: float) -> Values:
        """Return the ratios to test, in steps of less than a pixel for the nearest pairs."""
        count = math.ceil((high - low) / (_STEP * self.step)) + 1
        return np.linspace(low, high, max(5, count))

    def costs(self, planes: Values) -> Values:
        """Return the mismatch of pairs relative to their texture, shape (n, lines, lenslets)."""
        device, shape = self.raw.device, self.geometry.kinds.shape
        cost = device.empty((len(planes), *shape), np.float32)
        device.launch(
            device.kernel("focused_depth.cl", "match", **self._defines),
            (math.prod(shape),),
            *(cost, self.raw.data, *self._tables, device.upload(self.near)),
            device.upload(planes.astype(np.float32)),
            *(np.int32(n) for n in (len(self.near), len(planes))),
            *self._sizes(),
            *(np.float32(n) for n in (self.window, *self.lit, self.noise)),
        )
        return device.download(cost).astype(np.float64)

    def refined(self, start: Values, *, rounds: int = _ROUNDS) -> Match:
        """Refine a ratio of every lenslet, shape (lines, lenslets), by Gauss-Newton."""
        device, shape = self.raw.device, self.geometry.kinds.shape
        out = device.empty((*shape, 5), np.float32)
        device.launch(
            device.kernel("focused_depth.cl", "refine", **self._defines),
            (math.prod(shape),),
            *(out, self.raw.data, *self._tables, device.upload(self.pairs)),
            device.upload(start.astype(np.float32)),
            *(np.int32(n) for n in (len(self.pairs), rounds)),
            *self._sizes(),
            *(np.float32(n) for n in (self.window, *self.lit, self.step)),
        )
        return Match(*np.moveaxis(device.download(out).astype(np.float64), -1, 0))

    @cached_property
    def redundancy(self) -> float:
        """Number of pairs that use each pixel; their errors are not independent."""
        ends = {tuple(end) for pair in self.pairs for end in (pair[:2], pair[2:])}
        return 2 * len(self.pairs) / len(ends)

    def quality(self, match: Match) -> Values:
        """Return the quality of a match, 0 to 1: agreement times share of texture above noise."""
        noise = 2 * self.noise * match.weight
        texture = match.energy / (match.energy + noise + np.finfo(np.float64).tiny)
        return np.clip(1 - match.score, 0, 1) * texture

    @cached_property
    def noise(self) -> float:
        """Variance of a pixel's noise."""
        bright = float(np.quantile(self.raw.to_numpy()[::3, ::3], 0.99))
        return (_NOISE * bright) ** 2

    def _shrink(self, is_even: bool) -> tuple[float, float]:
        """Return the kernel arguments shrink and least."""
        if is_even:
            return 0.0, 0.0
        focused = [1 / (1 / low + 1 / high) * 2 for low, high in self.geometry.ranges if low > 0]
        if self.raw.camera is not None:
            focused.append(abs(float(self.raw.camera.m)))  # type: ignore[attr-defined]
        return self.geometry.pitch / 2, min(_MAX_RIM_M, max(focused, default=0.0))

    def _length(self, step: tuple[int, int]) -> float:
        """Return the length of a step in pitches."""
        base = np.array([self.geometry.first, self.geometry.second])
        return math.hypot(*(np.array(step) @ base)) / self.geometry.pitch

    def _pairs_of(self, steps: list[tuple[int, int]]) -> Integers:
        """Return pairs of lenslets a step apart with their middle near the lenslet."""
        pairs = []
        for i, j in steps:
            n = abs(i) + abs(j) + 1
            for a, b in product(range(-n, n + 1), repeat=2):
                if self._length((2 * a + i, 2 * b + j)) / 2 < _MAX_MIDDLE_DISTANCE:
                    pairs.append((a, b, a + i, b + j))
        return np.array(pairs, np.int32)

    def _sizes(self) -> tuple[Any, ...]:
        sizes = (*self.geometry.kinds.shape, *self.geometry.shape)
        return tuple(np.int32(n) for n in sizes)


def _divide_by_white(raw: RawImage, white: Any) -> RawImage:
    """Divide the raw image by a white image, averaged over its colours."""
    level = white_level(raw, white)
    if level.ndim == 3:
        level = level.mean(2)
        level = level / level.max()
    level = np.maximum(level, np.float32(_MIN_WHITE))
    values = raw.to_numpy()
    values = values / (level[..., None] if values.ndim == 3 else level)
    return replace(raw, data=raw.device.upload(values))


def _fields(match: Match) -> tuple[Values, ...]:
    return match.ratio, match.difference, match.slope, match.energy, match.weight
