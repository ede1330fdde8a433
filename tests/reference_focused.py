"""Focused plenoptic cameras by rays, float64, apart from the package, and twins of its kernels.

`Rig.expose` follows rays back from the sensor: pixel -> a point of the lenslet that the pixel's
sub-image belongs to (a thin lens, sampled over its disc) -> the main lens' pupil, which stops them
-> the main lens' own picture, a plane or a slanted plane with a texture on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Texture = Callable[[Array, Array], Array]


def waves(seed: int, shortest: float, longest: float, count: int = 24) -> Texture:
    """A random sum of waves over (Y, X), between 0 and 1, periods log-uniform."""
    random = np.random.default_rng(seed)
    period = np.exp(random.uniform(np.log(shortest), np.log(longest), count))
    angle, phase = random.uniform(0, 2 * np.pi, (2, count))
    ky, kx = np.sin(angle) / period, np.cos(angle) / period

    def texture(y: Array, x: Array) -> Array:
        out = np.zeros(np.broadcast(y, x).shape)
        for a, b, c in zip(ky, kx, phase, strict=True):
            out += np.cos(2 * np.pi * (a * y + b * x) + c)
        return np.clip(0.5 + 0.5 * out / np.sqrt(2 * count), 0, 1)

    return texture


@dataclass(frozen=True)
class Rig:
    """A focused camera of unit pixels; lengths in pixels.

    ``base`` holds two lattice vectors (y, x) of the lenslets on the array, ``centre`` a lenslet,
    ``axis`` where the axis meets the sensor. ``b`` array to sensor, ``z2`` pupil to array.
    ``focal`` has one focal length a type; type of lenslet (i, j) = (i + 2 j) mod types, which on a
    hexagonal lattice of base (row, column) is the usual pattern of three.
    """

    shape: tuple[int, int]
    base: tuple[tuple[float, float], tuple[float, float]]
    centre: tuple[float, float]
    b: float
    z2: float
    focal: tuple[float, ...]
    lens_diameter: float
    pupil_diameter: float
    axis: tuple[float, float] | None = None

    @property
    def t(self) -> float:
        return self.b / self.z2

    def _axis(self) -> Array:
        return np.array(self.axis or ((self.shape[0] - 1) / 2, (self.shape[1] - 1) / 2))

    def lens(self, i: Array, j: Array) -> Array:
        """Centres of lenslets on the array, (..., 2)."""
        i, j = np.asarray(i)[..., None], np.asarray(j)[..., None]
        return np.array(self.centre) + i * np.array(self.base[0]) + j * np.array(self.base[1])

    def image(self, lens: Array) -> Array:
        """Centres of sub-images: chief rays through the lenslets' centres."""
        return self._axis() + (1 + self.t) * (lens - self._axis())

    def owner(self, y: Array, x: Array) -> tuple[Array, Array]:
        """The lenslet (i, j) whose sub-image has its centre nearest to a place on the sensor."""
        place = np.stack(np.broadcast_arrays(y, x), -1)
        on_array = self._axis() + (place - self._axis()) / (1 + self.t) - np.array(self.centre)
        low = np.floor(on_array @ np.linalg.inv(np.array(self.base)))
        best = np.full(place.shape[:-1], np.inf)
        i, j = np.zeros_like(best), np.zeros_like(best)
        for a in (0, 1):
            for b in (0, 1):
                off = on_array - (low + np.array([a, b])) @ np.array(self.base)
                far = (off**2).sum(-1)
                closer = far < best
                best = np.where(closer, far, best)
                i, j = np.where(closer, low[..., 0] + a, i), np.where(closer, low[..., 1] + b, j)
        return i.astype(int), j.astype(int)

    def kind(self, i: Array, j: Array) -> Array:
        return (i + 2 * j) % len(self.focal)

    def expose(
        self,
        texture: Texture,
        distance: float,
        slope: tuple[float, float] = (0.0, 0.0),
        *,
        fine: int = 2,
        rays: int = 9,
    ) -> Array:
        """The sensor's picture of a plane a(Y, X) = distance + slope (Y, X) before the array.

        (Y, X) from the axis; ``fine`` samples a pixel both ways, ``rays`` about the number of
        points of each lenslet's disc.
        """
        ny, nx = self.shape
        out = np.zeros(self.shape)
        side = np.arange(fine) / fine + 0.5 / fine - 0.5
        disc = _disc(rays) * self.lens_diameter / 2
        for dy in side:
            for dx in side:
                y, x = np.arange(ny)[:, None] + dy, np.arange(nx)[None, :] + dx
                i, j = self.owner(y, x)
                centre = self.lens(i, j) - self._axis()
                place = np.stack(np.broadcast_arrays(y, x), -1) - self._axis()
                power = 1 / np.array(self.focal)[self.kind(i, j)]
                for u in disc:
                    at = centre + u
                    # thin lens: slope after = slope before - u/f; light runs from pupil to sensor
                    before = (place - at) / self.b + u * power[..., None]
                    in_pupil = at - self.z2 * before
                    lit = (in_pupil**2).sum(-1) < (self.pupil_diameter / 2) ** 2
                    # at - zeta before = (Y, X), zeta = distance + slope (Y, X)
                    g = np.array(slope)
                    zeta = (distance + at @ g) / (1 + before @ g)
                    seen = at - zeta[..., None] * before
                    out += np.where(lit, texture(seen[..., 0], seen[..., 1]), 0)
        return out / (fine**2 * len(disc))

    def white(self, **more: int) -> Array:
        """The picture of an even, bright scene."""
        return self.expose(lambda y, x: np.ones(np.broadcast(y, x).shape), 10.0, **more)

    def m(self, place: Array, distance: float, slope: tuple[float, float]) -> Array:
        """b/a of what lies on the chief ray that meets the sensor at (y, x)."""
        chief = (np.asarray(place) - self._axis()) / (self.z2 + self.b)  # slope of the ray
        # at zeta before the array the ray is at chief (z2 - zeta)
        g = chief @ np.array(slope)
        zeta = (distance + self.z2 * g) / (1 + g)
        return self.b / zeta

    def picture(
        self, texture: Texture, y: Array, x: Array, distance: float, slope=(0.0, 0.0)
    ) -> Array:
        """The texture as seen from the pupil's middle, at places of chief rays on the sensor."""
        place = np.stack(np.broadcast_arrays(y[:, None], x[None, :]), -1)
        zeta = self.b / self.m(place, distance, slope)
        seen = (place - self._axis()) * ((self.z2 - zeta) / (self.z2 + self.b))[..., None]
        return texture(seen[..., 0], seen[..., 1])


def _disc(count: int) -> Array:
    """About ``count`` points evenly over the unit disc; the middle alone for 1."""
    if count == 1:
        return np.zeros((1, 2))
    k = np.arange(count) + 0.5
    radius, angle = np.sqrt(k / count), k * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.sin(angle), radius * np.cos(angle)], -1)


def keys(t: Array) -> Array:
    """Cubic convolution, a = -1/2 (Keys 1981, eq. 15)."""
    t = np.abs(t)
    near = (1.5 * t - 2.5) * t * t + 1
    far = ((-0.5 * t + 2.5) * t - 4) * t + 2
    return np.where(t < 1, near, np.where(t < 2, far, 0.0))


def triangle(t: Array) -> Array:
    return np.maximum(1 - np.abs(t), 0)


def sampled(raw: Array, place: Array, profile: Callable[[Array], Array] = keys) -> Array:
    """raw (ny, nx, c) at a place (y, x); pixels at the edge are repeated."""
    ny, nx = raw.shape[:2]
    low = np.floor(place).astype(int)
    total = 0.0
    for a in range(-1, 3):
        for b in range(-1, 3):
            w = profile(place[0] - low[0] - a) * profile(place[1] - low[1] - b)
            total = total + w * raw[np.clip(low[0] + a, 0, ny - 1), np.clip(low[1] + b, 0, nx - 1)]
    return total


@dataclass(frozen=True)
class Twin:
    """What focused_render.cl is given, in float64: places (n, 2) of lenslets with their kinds.

    ``missing`` (n, 2) are the points of the lattice round them where there is no lenslet.
    """

    raw: Array  # (ny, nx, c)
    places: Array
    kinds: Array
    missing: Array
    pitch: float
    pupil: float = 0.0
    view: tuple[float, float] = (0.0, 0.0)
    radius: float = 1e9
    ranges: tuple[tuple[float, float], ...] = ()
    white: Array | None = None
    profile: Callable[[Array], Array] = keys

    def _recorded(self, r: Array) -> bool:
        ny, nx = self.raw.shape[:2]
        return bool((r >= 0).all() and r[0] <= ny - 1 and r[1] <= nx - 1)

    def nearest(self, y: float, x: float, ratio: float) -> Array:
        """One sample from the sub-image nearest to it."""
        Y = np.array([y, x])
        q = Y + np.array(self.view) / ratio
        k = int(((self.places - q) ** 2).sum(1).argmin())
        s = self.places[k]
        r = s + ratio * (s - Y)
        nothing = ((self.missing - q) ** 2).sum(1).min() < ((s - q) ** 2).sum()
        if nothing or not self._recorded(r):
            return np.zeros(self.raw.shape[2])
        value = sampled(self.raw, r, self.profile)
        if self.white is None:
            return value
        level = sampled(self.white, r, self.profile)
        return np.where(level > 0, value / np.where(level > 0, level, 1), 0)

    def blend(self, y: float, x: float, ratio: float) -> Array:
        """The weighted mean over all sub-images that show the point."""
        Y = np.array([y, x])
        of_type = self._of_type(ratio)
        total, level = np.zeros(self.raw.shape[2]), np.zeros(self.raw.shape[2])
        for s, kind in zip(self.places, self.kinds, strict=True):
            d = ratio * (s - Y)
            w = _ramp(self.radius - np.hypot(*(d - np.array(self.view))))
            w *= _ramp(self.pitch / 2 - np.hypot(*d)) * of_type[kind]
            if w > 0 and self._recorded(s + d):
                total += w * sampled(self.raw, s + d, self.profile)
                level += w * (1 if self.white is None else sampled(self.white, s + d, self.profile))
        if not level[0] > 0:
            return self.nearest(y, x, ratio)
        return total / level

    def _of_type(self, ratio: float) -> Array:
        if not self.ranges:
            return np.ones(1)
        m = abs(ratio * (1 + self.pupil) + self.pupil)
        e = np.array([max(low - m, m - high, 0) for low, high in self.ranges])
        return np.maximum(1 - self.pitch * (e - e.min()), 0)


def _ramp(t: float) -> float:
    return float(np.clip(t + 0.5, 0, 1))


@dataclass(frozen=True)
class MatchTwin:
    """What focused_depth.cl compares, in float64: raw (ny, nx), places (lines, lenslets, 2)."""

    raw: Array
    places: Array
    kinds: Array  # (lines, lenslets), -1 for none
    window: float
    rim: float
    shrink: float

    def _ends(self, pair: Array, i: int, j: int) -> tuple[Array, Array] | None:
        lines, lenses = self.kinds.shape
        a, b = ((i + int(end[0]), j + int(end[1])) for end in (pair[:2], pair[2:]))
        for one in (a, b):
            if min(one) < 0 or one[0] >= lines or one[1] >= lenses or self.kinds[one] < 0:
                return None
        return self.places[a], self.places[b]

    def _lit(self, ratio: float) -> float:
        return max(self.rim - self.shrink * abs(ratio), 0)

    def _weights(self, off: Array, lit: float) -> tuple[Array, Array]:
        """Places d of a window, (n, 2), and their weights."""
        half = int(self.window)
        d = np.stack(np.mgrid[-half : half + 1, -half : half + 1], -1).reshape(-1, 2)
        far = np.maximum(((d - off) ** 2).sum(1), ((d + off) ** 2).sum(1))
        w = np.maximum(1 - (d**2).sum(1) / self.window**2, 0)
        return d, np.where(far < lit**2, w, 0)

    def _is_inside(self, place: Array) -> bool:
        half, (ny, nx) = int(self.window), self.raw.shape
        y, x = np.floor(place)
        return bool(y - half >= 1 and y + half < ny - 2 and x - half >= 1 and x + half < nx - 2)

    def _both(self, ends: tuple[Array, Array], ratio: float, profile: Callable) -> tuple:
        """Weights, A and B of a pair; None where a window leaves the sensor."""
        a, b = ends
        off = ratio * (b - a) / 2
        if not (self._is_inside(a - off) and self._is_inside(b + off)):
            return None
        d, w = self._weights(off, self._lit(ratio))
        return w, self._samples(a - off, d, profile), self._samples(b + off, d, profile)

    def _samples(self, place: Array, d: Array, profile: Callable) -> Array:
        """The picture at a place and whole pixels d from it."""
        low = np.floor(place).astype(int)
        total = np.zeros(len(d))
        for y in range(-1, 3):
            for x in range(-1, 3):
                w = profile(place[0] - low[0] - y) * profile(place[1] - low[1] - x)
                total += w * self.raw[low[0] + y + d[:, 0], low[1] + x + d[:, 1]]
        return total

    def cost(self, pairs: Array, ratio: float, noise: float, i: int, j: int) -> float:
        apart = both = seen = 0.0
        for pair in pairs:
            ends = self._ends(pair, i, j)
            found = None if ends is None else self._both(ends, ratio, triangle)
            if found is None or not found[0].sum() > 0:
                continue
            w, A, B = found
            apart += _scatter(w, A - B)
            both += _scatter(w, A) + _scatter(w, B)
            seen += w.sum()
        extra = 2 * noise * seen
        return (apart + extra) / (both + extra) if both + extra > 0 else 2.0

    def sums(self, pairs: Array, ratio: float, i: int, j: int, step: float = 1e-5) -> Array:
        """sum e e', e'^2, e^2, A^2 + B^2, w; e' by a central difference."""
        out = np.zeros(5)
        for pair in pairs:
            ends = self._ends(pair, i, j)
            if ends is None:
                continue
            off = ratio * (ends[1] - ends[0]) / 2
            if not np.hypot(*off) + self.window / 2 < self._lit(ratio):
                continue
            found = self._both(ends, ratio, keys)
            if found is None:
                continue
            w, A, B = found
            high, low = (self._both(ends, ratio + s, keys) for s in (step, -step))
            slope = ((high[1] - high[2]) - (low[1] - low[2])) / (2 * step)
            e = A - B
            mean = lambda v, w=w: (w * v).sum() / w.sum()  # noqa: E731
            out[0] += (w * (e - mean(e)) * (slope - mean(slope))).sum()
            out += [0, _scatter(w, slope), _scatter(w, e), _scatter(w, A) + _scatter(w, B), w.sum()]
        return out

    def refined(
        self, pairs: Array, ratio: float, rounds: int, most: float, i: int, j: int
    ) -> float:
        for _ in range(rounds):
            first, second = self.sums(pairs, ratio, i, j)[:2]
            if second > 0:
                ratio -= np.clip(first / second, -most, most)
        return ratio


def _scatter(w: Array, values: Array) -> float:
    mean = (w * values).sum() / w.sum()
    return float((w * (values - mean) ** 2).sum())
