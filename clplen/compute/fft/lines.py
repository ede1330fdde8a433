"""Linear maps along one axis that a Fourier transform makes fast.

Every propagation is a few of them: zero padding and a transform, a convolution, a chirp-z
transform, one Fresnel step. `run` in blocks.py applies them to arrays.
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
    """n samples to m samples: multiply, place in a window, transform, multiply, cut out.

    Attributes
    ----------
    n, m : int
        Samples that go in and come out.
    length : int
        Of the window that is transformed, at least n and m.
    kind : {"none", "forward", "inverse", "convolve"}
        The transform: none, one DFT (the inverse with its factor 1/length), or a circular
        convolution: forward DFT, product with ``kernel``, inverse DFT.
    place, start : int
        Window index of the first sample that goes in, and of the first that comes out.
    pre, post : numpy.ndarray or None
        Complex factors of the n samples and of the m samples; None: 1.
    kernel : numpy.ndarray or None
        Spectrum of the convolution, complex, shape (length,).
    """

    n: int
    m: int
    length: int
    kind: Kind
    place: int = 0
    start: int = 0
    pre: Array | None = None
    kernel: Array | None = None
    post: Array | None = None

    def astype(self, dtype: np.dtype[Any]) -> Line:
        """The same map with tables of a complex dtype."""
        tables = {
            name: table.astype(dtype)
            for name in ("pre", "kernel", "post")
            if (table := getattr(self, name)) is not None
        }
        return replace(self, **tables)

    def adjoint(self) -> tuple[Line, float]:
        """The adjoint but for a factor, and the factor.

        The adjoint of a DFT is the inverse DFT times its length, and that of a circular
        convolution the one with the conjugate spectrum. A map that multiplies anyway takes the
        factor.
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
            place=self.start,
            start=self.place,
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
    """Maps of the rows' axis and of the columns' axis, each in the order in which it is applied.

    Attributes
    ----------
    y, x : tuple of Line
        Empty where nothing happens along an axis.
    """

    y: tuple[Line, ...] = ()
    x: tuple[Line, ...] = ()

    @classmethod
    def of(cls, lines: Sequence[Line]) -> Separable:
        """One map along y and one along x."""
        y, x = lines
        return cls((y,), (x,))

    def astype(self, dtype: np.dtype[Any]) -> Separable:
        """The same maps with tables of a complex dtype; a map that is repeated stays one."""
        made = {line: line.astype(dtype) for line in {*self.y, *self.x}}
        return Separable(tuple(made[a] for a in self.y), tuple(made[a] for a in self.x))

    def adjoint(self) -> tuple[Separable, float]:
        """The adjoint but for a factor, and the factor; a map that is repeated stays one."""
        made = {line: line.adjoint() for line in {*self.y, *self.x}}
        y, x = (tuple(made[one][0] for one in lines[::-1]) for lines in (self.y, self.x))
        return Separable(y, x), math.prod(made[one][1] for one in (*self.y, *self.x))

    def times(self, factor: float) -> Separable:
        """The same maps times a number, which the last one along an axis takes."""
        if factor == 1:
            return self
        name = "x" if self.x and self.x[-1].kind != "none" else "y"
        *before, last = getattr(self, name)
        post = np.ones(last.m, np.complex128) if last.post is None else last.post
        scaled = replace(last, post=post * factor)
        return replace(self, **{name: (*before, scaled)})

    def shape_after(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Shape that an array of a shape has afterwards."""
        ny, nx = shape
        return (self.y[-1].m if self.y else ny, self.x[-1].m if self.x else nx)

    def widest(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Longest window along each axis."""
        ny, nx = shape
        return (
            max((line.length for line in self.y), default=ny),
            max((line.length for line in self.x), default=nx),
        )


def adjoint_maps(into: Separable, back: Separable) -> tuple[Separable, Separable]:
    """The maps before and after a product, of the adjoint of a product between two maps."""
    before, one = back.adjoint()
    after, other = into.adjoint()
    factor = one * other
    if abs(factor - 1) < 1e-12:
        return before, after
    return (before, after.times(factor)) if after.x or after.y else (before.times(factor), after)


def still(n: int) -> Line:
    """Nothing happens: an axis of one sample, or one that waits for the other."""
    return Line(n, n, n, "none")


def padded_spectrum(n: int, length: int) -> Line:
    """Zero padding that keeps sample n//2 on sample length//2, and the DFT."""
    if n == length == 1:
        return still(1)
    return Line(n, length, length, "forward", place=length // 2 - n // 2)


def cropped_inverse(length: int, m: int) -> Line:
    """The inverse DFT, cut to m samples about sample length//2."""
    if m == length == 1:
        return still(1)
    return Line(length, m, length, "inverse", start=length // 2 - m // 2)


def convolution(n: int, m: int, kernel: Array) -> Line:
    """A circular convolution in a window about the central sample; ``kernel`` is its spectrum."""
    length = len(kernel)
    place, start = length // 2 - n // 2, length // 2 - m // 2
    return Line(n, m, length, "convolve", place=place, start=start, kernel=kernel)


def smooth_length(n: int) -> int:
    """The next length from n >= 1 on without prime factors above 7."""
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
    """A DFT of any step: out[p] = post[p] sum_q pre[q] in[q] exp(2 pi i step p q).

    p and q count from the central samples m//2 and n//2. Bluestein (1970), eq. 4, by way of
    2 p q = p^2 + q^2 - (p - q)^2, as a convolution.
    """
    q, p = np.arange(n) - n // 2, np.arange(m) - m // 2
    length = smooth_length(n + m - 1)
    apart = np.arange(length)
    apart = np.where(apart < m, apart, apart - length) + (n // 2 - m // 2)
    return Line(
        n,
        m,
        length,
        "convolve",
        pre=pre * _chirp(step, q),
        kernel=np.fft.fft(_chirp(-step, apart)),
        post=post * _chirp(step, p),
    )


def _chirp(step: float, index: Array) -> Array:
    turns = step / 2 * index.astype(np.float64) ** 2
    return np.exp(2j * np.pi * (turns - np.rint(turns)))
