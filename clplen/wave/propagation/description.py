"""A propagation before it is on a device: what is asked for, how it is done, what it costs.

One description serves every method: maps along the axes, a factor in between, maps back.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, Literal

import numpy as np

from clplen import units
from clplen.checks import float64_array, is_finite
from clplen.compute.fft.lines import Line, Separable
from clplen.errors import SamplingError, argument
from clplen.wave.field.field import Grid
from clplen.wave.propagation.band import FAR_GUARD, GUARD, AxisSpan, Band, guarded_band
from clplen.wave.propagation.transfer_function import Factor

METHODS = (
    "auto",
    "as",
    "blas",
    "cblas",
    "rs",
    "one-step",
    "fresnel-tf",
    "fresnel-ir",
    "fresnel-1fft",
    "fresnel-multistep",
)
SELF_PADDED = ("auto", "cblas", "rs", "one-step")  # methods that size their own windows
FREE_GRID = ("auto", "cblas", "rs", "one-step", "fresnel-1fft")  # methods that take any output grid
FARTHEST = units.DISTANCE.max_length
BORDER = 0.4  # of half the window, the taper of fresnel-multistep
_SAME = 1e-9  # of a pitch
ANY_DISTANCE = (0.0, math.inf)  # interval of a method that is sampled at every distance


@dataclass(frozen=True)
class Request:
    """Everything that determines a propagation; the key of its plan."""

    grid: Grid
    z: float  # in metres
    wavelength: float  # in metres
    method: str = "auto"
    pad: float = 2
    out_grid: Grid | None = None  # None: the method chooses
    guard: float | None = None  # in Fresnel widths; None: `widths`
    border: float = BORDER
    # (y, x) widths that carry light, centred on the grid, in metres; None: the whole window
    support: tuple[float, float] | None = None
    lens: float | None = None  # focal length of a thin lens right before a fresnel-1fft, in metres

    def __post_init__(self) -> None:
        _check_numbers(self)
        if self.lens is not None and self.method != "fresnel-1fft":
            raise ValueError(
                f"{argument('lens')} is for {argument('method', 'fresnel-1fft')}, not "
                f"{self.method!r}: put a thin_lens before the propagation."
            )
        self._check_out_grid()

    def _check_out_grid(self) -> None:
        out = self.out_grid
        if out is None or out == self.grid:
            return
        if self.method not in FREE_GRID:
            raise SamplingError(
                f"{argument('method', self.method)} keeps the grid of the field, {self.grid}, but "
                f"{out} was asked for: {argument('method', 'cblas')} gives any grid."
            )
        for n, m, axis in zip(self.grid.shape, out.shape, "yx", strict=True):
            if n == 1 and m != 1:
                raise SamplingError(
                    f"Nothing varies along {axis} in {self.grid}, but {m} samples were asked for "
                    "along it: give the output grid one sample there."
                )

    @property
    def target(self) -> Grid:
        """The output grid; the input's where none was asked for."""
        return self.grid if self.out_grid is None else self.out_grid

    @property
    def is_aligned(self) -> bool:
        """Whether the output has the pitch and the centre of the input."""
        own, other = self.grid, self.target
        return all(
            n == 1 or (abs(a - b) <= _SAME * a / max(n, m) and abs(c - e) <= _SAME * a)
            for n, m, a, b, c, e in zip(
                own.shape,
                other.shape,
                own.pitch,
                other.pitch,
                own.origin,
                other.origin,
                strict=True,
            )
        )

    def span(self, axis: int) -> AxisSpan:
        """Where light comes from and where it is wanted along an axis (0: y, 1: x)."""
        own, other = self.grid, self.target
        return AxisSpan(
            n=own.shape[axis],
            pitch=own.pitch[axis],
            z=self.z,
            wavelength=self.wavelength,
            lit=self._lit(axis),
            wanted=other.extent[axis],
            offset=other.origin[axis] - own.origin[axis],
            across=self._displacements(1 - axis),
        )

    def _lit(self, axis: int) -> float:
        window = self.grid.extent[axis]
        return window if self.support is None else min(self.support[axis], window)

    def _displacements(self, axis: int) -> tuple[float, float]:
        """Smallest and largest abs of a sideways displacement that is wanted along an axis."""
        if self.grid.shape[axis] == 1:
            return (0.0, 0.0)
        offset = abs(self.target.origin[axis] - self.grid.origin[axis])
        half = (self._lit(axis) + self.target.extent[axis]) / 2
        return (max(offset - half, 0.0), offset + half)

    @property
    def bands(self) -> list[Band]:
        """The guarded band of each axis, (y, x)."""
        return [guarded_band(self.span(axis), self.widths) for axis in (0, 1)]

    @property
    def widths(self) -> float:
        """The guard; where none was given 6, or 8 where S^2 < 4 lam z, S the mean of both windows.

        There 6 Fresnel widths keep less than 180 dB, and the few more frequencies cost nothing.
        """
        if self.guard is not None:
            return self.guard
        spans = [self.span(axis) for axis in self.axes]
        far = any(
            (span.lit + span.wanted) ** 2 < 16 * span.wavelength * abs(span.z) for span in spans
        )
        return FAR_GUARD if far else GUARD

    @property
    def axes(self) -> tuple[int, ...]:
        """The axes along which something varies."""
        return tuple(axis for axis in (0, 1) if self.grid.shape[axis] > 1)


def _check_numbers(r: Request) -> None:
    if not isinstance(r.grid, Grid):
        raise TypeError(f"The grid of a propagation is a Grid, not a {type(r.grid).__name__}.")
    if r.out_grid is not None and not isinstance(r.out_grid, Grid):
        raise TypeError(
            f"out_grid is a Grid, as Grid((ny, nx), pitch) makes it, not {r.out_grid!r}."
        )
    if r.method not in METHODS:
        raise ValueError(f"There is no method {r.method!r}; use one of {', '.join(METHODS)}.")
    if not is_finite(r.z):
        raise ValueError(f"The distance z is one finite number of metres, not {r.z!r}.")
    if abs(r.z) > FARTHEST:
        raise ValueError(f"The distance z is at most {FARTHEST:g} m, not {r.z!r}.")
    if not (is_finite(r.wavelength) and r.wavelength > 0):
        raise ValueError(f"The wavelength is positive, in metres, not {r.wavelength!r}.")
    units.WAVELENGTH.check(r.wavelength, "The wavelength")
    if not (is_finite(r.pad) and r.pad >= 1):
        raise ValueError(f"pad is at least 1 and finite, not {r.pad!r}.")
    if r.guard is not None and not (is_finite(r.guard) and r.guard >= 0):
        raise ValueError(f"guard is a number of Fresnel widths, at least 0, not {r.guard!r}.")
    if not (is_finite(r.border) and 0 <= r.border < 1):
        raise ValueError(f"border is a fraction of half the window, 0 to 1, not {r.border!r}.")
    if r.support is not None and not all(is_finite(s) and s > 0 for s in r.support):
        raise ValueError(f"support is positive widths (y, x) in metres, not {r.support!r}.")
    if r.lens is not None and not (isinstance(r.lens, Real) and r.lens == r.lens and r.lens != 0):
        raise ValueError(f"The focal length lens= is not 0, in metres; got {r.lens!r}.")


def padded_length(n: int, pad: float) -> int:
    """Length of a padded window: exactly round(pad n), n for n = 1."""
    return n if n == 1 else round(pad * n)


Kind = Literal["nothing", "fft", "chirp-z", "separable", "series"]


def request(
    grid: Grid,
    z: Any,
    wavelength: float,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
    guard: float | None = None,
    border: float = BORDER,
    *,
    support: float | tuple[float, float] | None = None,
    lens: float | None = None,
) -> Request:
    """A checked request, a ``support`` of one number being that of both axes."""
    if support is not None:
        if np.shape(support) not in ((), (2,)):
            raise ValueError(f"support is one width or (y, x), in metres, not {support!r}.")
        both = np.broadcast_to(float64_array(support), (2,))
        support = (float(both[0]), float(both[1]))
    distance = z.item() if isinstance(z, np.ndarray) and z.ndim == 0 else z
    distance = float(float64_array(distance)) if isinstance(distance, Real) else distance
    return Request(grid, distance, wavelength, method, pad, out_grid, guard, border, support, lens)


@dataclass(frozen=True, eq=False)
class Description:
    """A propagation before it is on a device."""

    request: Request
    method: str  # the one that is taken
    kind: Kind  # how the sums are done
    route: str  # the same in words
    into: Separable  # before the factor
    back: Separable = field(default_factory=Separable)  # after it; empty where there is none
    factor: Factor | None = None
    why: str = "asked for"  # the inequality that decided
    sampled: str = "nothing"  # what has to be sampled: the transfer function, a kernel, a chirp
    phase_step: float = 0.0  # its largest phase step a sample, divided by pi: sampled up to 1
    valid: tuple[float, float] = ANY_DISTANCE  # abs(z) in metres between which it is sampled
    # ((fy low, fy high), (fx low, fx high)) that is used, in cycles a metre; None: all
    used: tuple[tuple[float, float], tuple[float, float]] | None = None
    own_grid: Grid | None = None  # of the result, where the method chooses it
    warning: str = ""  # what is wrong with the sampling and what to do; empty where nothing is
    # whether it is so wrong that no plan is made: the warning is the error's sentence
    is_refused: bool = False
    # (into, back) of every term of a sum, the first as ``into`` and ``back``; empty: no sum
    terms: tuple[tuple[Separable, Separable], ...] = ()

    @property
    def out_grid(self) -> Grid:
        """Grid of the result."""
        return self.own_grid or self.request.target

    @property
    def band(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """((fy low, fy high), (fx low, fx high)) that is used, in cycles a metre."""
        if self.used is not None:
            return self.used
        grid = self.request.grid
        y, x = (
            (0.0, 0.0) if n == 1 else (-1 / (2 * d), 1 / (2 * d))
            for n, d in zip(grid.shape, grid.pitch, strict=True)
        )
        return (y, x)

    @property
    def window(self) -> tuple[int, int]:
        """Samples of the computation window."""
        shape = self.request.grid.shape
        there = self.into.widest(shape)
        back = self.back.widest(self.into.shape_after(shape))
        return (max(there[0], back[0]), max(there[1], back[1]))

    @property
    def work_samples(self) -> int:
        """Samples that one field needs beside input and output."""
        (ny, _), (my, mx) = self.request.grid.shape, self.into.shape_after(self.request.grid.shape)
        rows = max(ny, self.out_grid.shape[0]) if self.factor is not None else ny
        return max(rows, my if self.factor is None else 0) * max(mx, self.out_grid.shape[1])


def outshines(r: Request) -> bool:
    """Whether one sample of the kernel gives more light than there is: d^2 > lam z, or at z < d."""
    if not r.axes:
        return False
    shares = [r.grid.pitch[axis] / math.sqrt(r.wavelength * abs(r.z)) for axis in r.axes]
    near = math.hypot(1, r.wavelength / (2 * math.pi * r.z))  # of 1/r - ik over k
    return max(*shares, math.prod(shares) * near) > 1


def flops(description: Description) -> float:
    """Operations of the Fourier transforms of one field, 5 L log2 L each.

    Zero rows of padded windows are not transformed: the lines along x on the input's rows, those
    along y on what that gives, and back along x on the rows that are kept. A transfer function is
    made once for a plan and not counted; VkFFT transforms some of the zero rows, too.
    """
    ny, _ = description.request.grid.shape
    _, mx = description.into.shape_after(description.request.grid.shape)
    across = ny * _transforms(description.into.x) + mx * _transforms(description.into.y)
    one = (
        across
        + mx * _transforms(description.back.y)
        + description.out_grid.shape[0] * _transforms(description.back.x)
    )
    return one * max(1, len(description.terms))


def samples_held(description: Description) -> int:
    """Complex samples that one field needs beside itself: the plan, work space and the result."""
    if description.kind == "nothing":
        return 0
    stored = factor_samples(description)
    result = math.prod(description.out_grid.shape)
    return stored + table_samples(description) + 2 * description.work_samples + result


def factor_samples(description: Description) -> int:
    """Complex samples of the factors that a plan holds."""
    if description.factor is None:
        return 0
    return math.prod(description.factor.stored) * max(1, len(description.terms))


def least_samples(r: Request) -> int:
    """Complex samples that any way of doing a request holds, known before a plan is made."""
    (ny, nx), (my, mx) = r.grid.shape, r.target.shape
    length = nx if nx == 1 or r.method in SELF_PADDED else round(r.pad * nx)
    return max(my * mx, ny * length)


def table_samples(description: Description) -> int:
    """Complex samples of the 1-D tables of all maps; what is repeated counts once."""
    ways = description.terms or ((description.into, description.back),)
    maps = [lines for into, back in ways for lines in (into.y, into.x, back.y, back.x)]
    each = {line for lines in maps for line in lines} if description.terms else None
    return sum(
        table.size
        for lines in (maps if each is None else [tuple(each)])
        for line in set(lines)
        for table in (line.pre, line.kernel, line.post)
        if table is not None
    )


def _transforms(lines: Iterable[Line]) -> float:
    """Operations of the transforms of one line of samples."""
    each = {"none": 0, "forward": 1, "inverse": 1, "convolve": 2}
    return sum(each[line.kind] * 5 * line.length * math.log2(line.length) for line in lines)
