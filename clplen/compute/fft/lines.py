"""Linear maps along an axis that a Fourier transform makes fast.

A propagation consists of a few such maps: zero padding and a transform, a convolution, a chirp-z
transform, a Fresnel step. `run` in blocks.py applies them to arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from clplen.types import Array

Kind = Literal["none", "forward", "inverse", "convolve"]


@dataclass(frozen=True, eq=False)
class Line:
    """Map from n to m samples: multiply, place in a window, transform, multiply, crop.

    Attributes
    ----------
    n, m : int
        Numbers of input and output samples.
    length : int
        Length of the transformed window, at least n and m.
    kind : {"none", "forward", "inverse", "convolve"}
        Transform: none, a DFT (the inverse has the factor 1/length), or a circular convolution
        (forward DFT, product with ``kernel``, inverse DFT).
    offset, start : int
        Window index of the first input sample, and of the first output sample.
    pre, post : numpy.ndarray or None
        Complex factors of the input samples and of the output samples; None: 1.
    kernel : numpy.ndarray or None
        Spectrum of the convolution, complex, shape (length,).
    """

    n: int
    m: int
    length: int
    kind: Kind
    offset: int = 0
    start: int = 0
    pre: Array | None = None
    kernel: Array | None = None
    post: Array | None = None

    def astype(self, dtype: np.dtype[Any]) -> Line:
        """Return the map with its tables in a complex dtype."""
        tables = {
            name: table.astype(dtype)
            for name in ("pre", "kernel", "post")
            if (table := getattr(self, name)) is not None
        }
        return replace(self, **tables)

    def adjoint(self) -> tuple[Line, float]:
        """Return the adjoint up to a factor, and the factor.

        The adjoint of a DFT is the inverse DFT times its length; that of a circular convolution has
        the conjugate spectrum. A map with output factors absorbs the factor.
        """
        kinds: dict[Kind, Kind] = {"forward": "inverse", "inverse": "forward"}
        pre, kernel, post = (
            None if table is None else table.conj() for table in (self.pre, self.kernel, self.post)
        )
        turned = Line(
            self.m,
            self.n,
            self.length,
            kinds.get(self.kind, self.kind),
            offset=self.start,
            start=self.offset,
            pre=post,
            kernel=kernel,
            post=pre,
        )
        powers = {"forward": 1, "inverse": -1}
        factor = float(self.length) ** powers.get(self.kind, 0)
        if turned.post is None:
            return turned, factor
        return replace(turned, post=turned.post * factor), 1.0


@dataclass(frozen=True, eq=False)
class Separable:
    """Maps of the rows' axis and of the columns' axis, each in the order of their application.

    Attributes
    ----------
    y, x : tuple of Line
        Maps of the axis; empty if the axis is unchanged.
    """

    y: tuple[Line, ...] = ()
    x: tuple[Line, ...] = ()

    @classmethod
    def of(cls, lines: Sequence[Line]) -> Separable:
        """Return a separable map of a line along y and a line along x."""
        y, x = lines
        return cls((y,), (x,))

    def astype(self, dtype: np.dtype[Any]) -> Separable:
        """Return the maps with tables in a complex dtype; repeated maps stay identical."""
        converted = {line: line.astype(dtype) for line in {*self.y, *self.x}}
        return Separable(tuple(converted[a] for a in self.y), tuple(converted[a] for a in self.x))

    def adjoint(self) -> tuple[Separable, float]:
        """Return the adjoint up to a factor, and the factor; repeated maps stay identical."""
        adjoints = {line: line.adjoint() for line in {*self.y, *self.x}}
        y, x = (tuple(adjoints[line][0] for line in lines[::-1]) for lines in (self.y, self.x))
        return Separable(y, x), math.prod(adjoints[line][1] for line in (*self.y, *self.x))

    def times(self, factor: float) -> Separable:
        """Return the maps times a number, which the last map along an axis absorbs."""
        if factor == 1:
            return self
        name = "x" if self.x and self.x[-1].kind != "none" else "y"
        *before, last = getattr(self, name)
        post = np.ones(last.m, np.complex128) if last.post is None else last.post
        scaled = replace(last, post=post * factor)
        return replace(self, **{name: (*before, scaled)})

    def shape_after(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Return the shape of an array after the maps."""
        ny, nx = shape
        return (self.y[-1].m if self.y else ny, self.x[-1].m if self.x else nx)

    def widest(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Return the longest window along each axis."""
        ny, nx = shape
        return (
            max((line.length for line in self.y), default=ny),
            max((line.length for line in self.x), default=nx),
        )


def adjoint_maps(into: Separable, back: Separable) -> tuple[Separable, Separable]:
    """Return the maps before and after the product in the adjoint of map, product, map."""
    before, back_factor = back.adjoint()
    after, into_factor = into.adjoint()
    factor = back_factor * into_factor
    if abs(factor - 1) < 1e-12:
        return before, after
    return (before, after.times(factor)) if after.x or after.y else (before.times(factor), after)


def identity(n: int) -> Line:
    """Return the identity: for an axis of one sample, or while only the other axis changes."""
    return Line(n, n, n, "none")


def padded_spectrum(n: int, length: int) -> Line:
    """Return zero padding that keeps sample n//2 on sample length//2, and the DFT."""
    if n == length == 1:
        return identity(1)
    return Line(n, length, length, "forward", offset=length // 2 - n // 2)


def cropped_inverse(length: int, m: int) -> Line:
    """Return the inverse DFT, cropped to m samples about sample length//2."""
    if m == length == 1:
        return identity(1)
    return Line(length, m, length, "inverse", start=length // 2 - m // 2)


def convolution(n: int, m: int, kernel: Array) -> Line:
    """Return a circular convolution about the central sample; ``kernel`` is its spectrum."""
    length = len(kernel)
    offset, start = length // 2 - n // 2, length // 2 - m // 2
    return Line(n, m, length, "convolve", offset=offset, start=start, kernel=kernel)


def smooth_length(n: int) -> int:
    """Return the smallest length >= n >= 1 without prime factors above 7."""
    best = 1 << (n - 1).bit_length()
    sevens = 1
    while sevens < best:
        fives = sevens
        while fives < best:
            odd = fives
            while odd < best:
                best = min(best, odd << (-(-n // odd) - 1).bit_length())
                odd *= 3
            fives *= 5
        sevens *= 7
    return best


def chirp_z(n: int, m: int, step: float, *, pre: Array, post: Array) -> Line:
    """Return a DFT of any step: out[p] = post[p] sum_q pre[q] in[q] exp(2 pi i step p q).

    p and q count from the central samples m//2 and n//2. The convolution follows Bluestein (1970),
    eq. 4, with 2 p q = p^2 + q^2 - (p - q)^2.
    """
    q, p = np.arange(n) - n // 2, np.arange(m) - m // 2
    length = smooth_length(n + m - 1)
    distance = np.arange(length)
    distance = np.where(distance < m, distance, distance - length) + (n // 2 - m // 2)
    return Line(
        n,
        m,
        length,
        "convolve",
        pre=pre * _chirp(step, q),
        kernel=np.fft.fft(_chirp(-step, distance)),
        post=post * _chirp(step, p),
    )


def _chirp(step: float, index: Array) -> Array:
    turns = step / 2 * index.astype(np.float64) ** 2
    return np.exp(2j * np.pi * (turns - np.rint(turns)))
