"""Neighbouring lenslets of a focused camera compared: costs of planes, and their refinement.

Pairs of neighbouring lenslets of one type see the points between them at places that lie ratio
times their distance nearer to, or farther from, one another than the centres: see kernels/
focused_depth.cl.
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
    Values,
    Whole,
    same_type_steps,
    white_level,
)
from clplen.lightfield.raw.raw_image import RawImage

Mask = np.ndarray[Any, np.dtype[np.bool_]]

_RIM = 1.0  # pixels at the border of a sub-image that are not used
_STEP = 0.75  # pixels between planes, of the farthest pair
_MIDDLE = 0.75  # pitches: how far the middle of a pair may lie from the lenslet
_MORE = 2.1  # times the nearest distance: pairs for the refinement
_FARTHEST = 4.0  # pitches, in which lenslets of one type are looked for
_ROUNDS = 5
_DIMMEST = 0.4  # abs(m): more rim than that is not left out
_WHITE = 0.2  # of the brightest: what is darker in a white image is divided by that
_NOISE = 0.004  # of the brightest pixels: texture below is none


@dataclass(frozen=True)
class Match:
    """What `Matcher.refined` leaves of each lenslet, shape (lines, lenslets).

    The ratio, and sum e^2, sum e'^2, sum A^2 + B^2 and sum w of focused_depth.cl.
    """

    ratio: Values
    apart: Values
    slope: Values
    both: Values
    weight: Values

    @property
    def score(self) -> Values:
        """0 where both sides agree, 1 where they have nothing in common."""
        return np.divide(
            self.apart, self.both, out=np.full_like(self.apart, 2.0), where=self.both > 0
        )

    @property
    def deviation(self) -> Values:
        """Standard deviation of the ratio, from the residuals."""
        under = self.weight * self.slope
        variance = np.divide(self.apart, under, out=np.full_like(under, np.inf), where=under > 0)
        return np.sqrt(variance)

    def where(self, keep: Mask, other: Match) -> Match:
        """This where ``keep`` is true, else the other."""
        pairs = zip(_fields(self), _fields(other), strict=True)
        return Match(*(np.where(keep, a, b) for a, b in pairs))


class Matcher:
    """Comparisons of all lenslets of one raw image with their neighbours.

    Attributes
    ----------
    step : float
        Largest change of the ratio in a round of refinement: a pixel for the nearest pairs.
    lit : tuple of float
        rim, shrink and least of the kernels: how far a sub-image is evenly lit.
    near, pairs : numpy.ndarray
        int32, shape (n, 4): pairs (i, j, i, j) of lenslets from a lenslet's own indices, those of
        the nearest distance, and those up to twice as far apart.
    """

    def __init__(
        self, raw: RawImage, geometry: FocusedGeometry, window: float, white: Any = None
    ) -> None:
        self.raw = raw if white is None else _evened(raw, white)
        self.geometry, self.window = geometry, window
        self.lit = (geometry.pitch / 2 - _RIM, *self._shrink(white is not None))
        steps = sorted(same_type_steps(geometry, _FARTHEST), key=self._length)
        if not steps:
            raise ValueError(
                "No two lenslets of one type lie near one another on the sensor: depth needs more."
            )
        nearest = self._length(steps[0])
        near = [step for step in steps if self._length(step) < 1.2 * nearest]
        self.near = self._pairs_of(near)
        self.pairs = self._pairs_of([s for s in steps if self._length(s) < _MORE * nearest])
        self.step = 1 / (max(map(self._length, near)) * geometry.pitch)
        self._tables = geometry.tables(raw.device)
        self._defines = {"CHANNELS": 3} if len(raw.data.shape) == 3 else {}

    def planes(self, low: float, high: float) -> Values:
        """Ratios to try, so near that a window of the nearest pairs moves by less than a pixel."""
        count = math.ceil((high - low) / (_STEP * self.step)) + 1
        return np.linspace(low, high, max(5, count))

    def costs(self, planes: Values) -> Values:
        """How far both sides are apart, over their texture, shape (n, lines, lenslets)."""
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
        """Gauss-Newton from a ratio of every lenslet, shape (lines, lenslets)."""
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
        """Pairs that each lenslet's pixels are part of: their errors are not independent."""
        ends = {tuple(end) for pair in self.pairs for end in (pair[:2], pair[2:])}
        return 2 * len(self.pairs) / len(ends)

    def worth(self, found: Match) -> Values:
        """How well a match fits, times how much of its texture is no noise: 0 to 1."""
        noise = 2 * self.noise * found.weight
        texture = found.both / (found.both + noise + np.finfo(np.float64).tiny)
        return np.clip(1 - found.score, 0, 1) * texture

    @cached_property
    def noise(self) -> float:
        """Variance of a pixel that counts as noise."""
        bright = float(np.quantile(self.raw.to_numpy()[::3, ::3], 0.99))
        return (_NOISE * bright) ** 2

    def _shrink(self, is_even: bool) -> tuple[float, float]:
        """shrink and least of the kernels."""
        if is_even:
            return 0.0, 0.0
        focused = [1 / (1 / low + 1 / high) * 2 for low, high in self.geometry.ranges if low > 0]
        if self.raw.camera is not None:
            focused.append(abs(float(self.raw.camera.m)))  # type: ignore[attr-defined]
        return self.geometry.pitch / 2, min(_DIMMEST, max(focused, default=0.0))

    def _length(self, step: tuple[int, int]) -> float:
        """Length in pitches."""
        base = np.array([self.geometry.first, self.geometry.second])
        return math.hypot(*(np.array(step) @ base)) / self.geometry.pitch

    def _pairs_of(self, steps: list[tuple[int, int]]) -> Whole:
        """Pairs of lenslets a step apart with their middle near the lenslet."""
        found = []
        for i, j in steps:
            n = abs(i) + abs(j) + 1
            for a, b in product(range(-n, n + 1), repeat=2):
                if self._length((2 * a + i, 2 * b + j)) / 2 < _MIDDLE:
                    found.append((a, b, a + i, b + j))
        return np.array(found, np.int32)

    def _sizes(self) -> tuple[Any, ...]:
        sizes = (*self.geometry.kinds.shape, *self.geometry.shape)
        return tuple(np.int32(n) for n in sizes)


def _evened(raw: RawImage, white: Any) -> RawImage:
    """The raw image divided by a white image, the mean of its colours."""
    level = white_level(raw, white)
    if level.ndim == 3:
        level = level.mean(2)
        level = level / level.max()
    level = np.maximum(level, np.float32(_WHITE))
    values = raw.to_numpy()
    values = values / (level[..., None] if values.ndim == 3 else level)
    return replace(raw, data=raw.device.upload(values))


def _fields(match: Match) -> tuple[Values, ...]:
    return match.ratio, match.apart, match.slope, match.both, match.weight
