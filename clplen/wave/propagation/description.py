"""Description of a propagation independent of a device: request, method and cost.

All methods share the description: maps along the axes, a factor, and maps back.
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
FARTHEST = units.DISTANCE.max_length  # largest distance in metres
BORDER = 0.4  # width of the taper of fresnel-multistep relative to half the window
_PITCH_TOLERANCE = 1e-9  # relative tolerance of equal pitches and centres
ANY_DISTANCE = (0.0, math.inf)  # interval of methods that are sampled at every distance


@dataclass(frozen=True)
class Request:
    """Arguments of a propagation; the key of its plan."""

    grid: Grid
    z: float  # in metres
    wavelength: float  # in metres
    method: str = "auto"
    pad: float = 2
    out_grid: Grid | None = None  # None: chosen by the method
    guard: float | None = None  # in Fresnel widths; None: `widths`
    border: float = BORDER
    # widths (y, x) of the light, centred on the grid, in metres; None: the full window
    support: tuple[float, float] | None = None
    lens: float | None = None  # focal length in metres of a thin lens in front of a fresnel-1fft

    def __post_init__(self) -> None:
        _check_numbers(self)
        if self.lens is not None and self.method != "fresnel-1fft":
            raise ValueError(
                f"{argument('lens')} requires {argument('method', 'fresnel-1fft')}, got "
                f"{self.method!r}; apply thin_lens before the propagation."
            )
        self._check_out_grid()

    def _check_out_grid(self) -> None:
        out = self.out_grid
        if out is None or out == self.grid:
            return
        if self.method not in FREE_GRID:
            raise SamplingError(
                f"{argument('method', self.method)} requires the grid of the field, {self.grid}, "
                f"as output, got {out}; {argument('method', 'cblas')} supports any grid."
            )
        for n, m, axis in zip(self.grid.shape, out.shape, "yx", strict=True):
            if n == 1 and m != 1:
                raise SamplingError(
                    f"The output grid must have a single sample along {axis}, as {self.grid} has, "
                    f"got {m}."
                )

    @property
    def target(self) -> Grid:
        """Output grid; by default the input grid."""
        return self.grid if self.out_grid is None else self.out_grid

    @property
    def is_aligned(self) -> bool:
        """True if the output has the pitch and the centre of the input."""
        source, other = self.grid, self.target
        return all(
            n == 1
            or (
                abs(a - b) <= _PITCH_TOLERANCE * a / max(n, m)
                and abs(c - e) <= _PITCH_TOLERANCE * a
            )
            for n, m, a, b, c, e in zip(
                source.shape,
                other.shape,
                source.pitch,
                other.pitch,
                source.origin,
                other.origin,
                strict=True,
            )
        )

    def span(self, axis: int) -> AxisSpan:
        """Return the input and output widths along an axis (0: y, 1: x)."""
        source, other = self.grid, self.target
        return AxisSpan(
            n=source.shape[axis],
            pitch=source.pitch[axis],
            z=self.z,
            wavelength=self.wavelength,
            lit=self._lit(axis),
            output=other.extent[axis],
            offset=other.origin[axis] - source.origin[axis],
            across=self._displacements(1 - axis),
        )

    def _lit(self, axis: int) -> float:
        window = self.grid.extent[axis]
        return window if self.support is None else min(self.support[axis], window)

    def _displacements(self, axis: int) -> tuple[float, float]:
        """Return the smallest and largest abs of displacements along an axis."""
        if self.grid.shape[axis] == 1:
            return (0.0, 0.0)
        offset = abs(self.target.origin[axis] - self.grid.origin[axis])
        half = (self._lit(axis) + self.target.extent[axis]) / 2
        return (max(offset - half, 0.0), offset + half)

    @property
    def bands(self) -> list[Band]:
        """Guarded bands of the axes, (y, x)."""
        return [guarded_band(self.span(axis), self.widths) for axis in (0, 1)]

    @property
    def widths(self) -> float:
        """Guard in Fresnel widths, by default 6, or 8 for S^2 < 4 lam z (S: mean window).

        At these distances 6 widths have less than 180 dB, and more frequencies are cheap.
        """
        if self.guard is not None:
            return self.guard
        spans = [self.span(axis) for axis in self.axes]
        far = any(
            (span.lit + span.output) ** 2 < 16 * span.wavelength * abs(span.z) for span in spans
        )
        return FAR_GUARD if far else GUARD

    @property
    def axes(self) -> tuple[int, ...]:
        """Axes along which the field varies."""
        return tuple(axis for axis in (0, 1) if self.grid.shape[axis] > 1)


def _check_numbers(r: Request) -> None:
    if not isinstance(r.grid, Grid):
        raise TypeError(f"grid must be a Grid, got {type(r.grid).__name__}.")
    if r.out_grid is not None and not isinstance(r.out_grid, Grid):
        raise TypeError(
            f"out_grid must be a Grid, such as Grid((ny, nx), pitch), got {r.out_grid!r}."
        )
    if r.method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {r.method!r}.")
    if not is_finite(r.z):
        raise ValueError(f"z must be a finite number of metres, got {r.z!r}.")
    if abs(r.z) > FARTHEST:
        raise ValueError(f"z must be at most {FARTHEST:g} m, got {r.z!r}.")
    if not (is_finite(r.wavelength) and r.wavelength > 0):
        raise ValueError(f"wavelength must be positive, in metres, got {r.wavelength!r}.")
    units.WAVELENGTH.check(r.wavelength, "The wavelength")
    if not (is_finite(r.pad) and r.pad >= 1):
        raise ValueError(f"pad must be at least 1 and finite, got {r.pad!r}.")
    if r.guard is not None and not (is_finite(r.guard) and r.guard >= 0):
        raise ValueError(f"guard must be a number of Fresnel widths, at least 0, got {r.guard!r}.")
    if not (is_finite(r.border) and 0 <= r.border < 1):
        raise ValueError(f"border must be a fraction of half the window, 0 to 1, got {r.border!r}.")
    if r.support is not None and not all(is_finite(s) and s > 0 for s in r.support):
        raise ValueError(f"support must be positive widths (y, x) in metres, got {r.support!r}.")
    if r.lens is not None and not (isinstance(r.lens, Real) and r.lens == r.lens and r.lens != 0):
        raise ValueError(f"lens must not be 0 or NaN, got {r.lens!r}.")


def padded_length(n: int, pad: float) -> int:
    """Return the length of a padded window: exactly round(pad n), n for n = 1."""
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
    """Return a validated request; a single ``support`` applies to both axes."""
    if support is not None:
        if np.shape(support) not in ((), (2,)):
            raise ValueError(f"support must be one width or (y, x), in metres, got {support!r}.")
        both = np.broadcast_to(float64_array(support), (2,))
        support = (float(both[0]), float(both[1]))
    distance = z.item() if isinstance(z, np.ndarray) and z.ndim == 0 else z
    distance = float(float64_array(distance)) if isinstance(distance, Real) else distance
    return Request(grid, distance, wavelength, method, pad, out_grid, guard, border, support, lens)


@dataclass(frozen=True, eq=False)
class Description:
    """Description of a propagation, independent of a device."""

    request: Request
    method: str  # selected method
    kind: Kind  # type of the sums
    route: str  # description of the sums
    into: Separable  # maps before the factor
    back: Separable = field(default_factory=Separable)  # maps after the factor; may be empty
    factor: Factor | None = None
    why: str = "asked for"  # inequality that selected the method
    sampled: str = "nothing"  # sampled quantity: transfer function, kernel or chirp
    phase_step: float = 0.0  # its largest phase step per sample over pi; aliased above 1
    valid: tuple[float, float] = ANY_DISTANCE  # range of abs(z) in metres without aliasing
    # used band ((fy low, fy high), (fx low, fx high)) in cycles per metre; None: all
    used: tuple[tuple[float, float], tuple[float, float]] | None = None
    own_grid: Grid | None = None  # grid of the result if the method chooses it
    warning: str = ""  # problem of the sampling and its remedy; empty if there is none
    # True if the result would be useless: the warning is then an error
    is_refused: bool = False
    # (into, back) of each term of a sum, the first as ``into`` and ``back``; empty: no sum
    terms: tuple[tuple[Separable, Separable], ...] = ()

    @property
    def out_grid(self) -> Grid:
        """Grid of the result."""
        return self.own_grid or self.request.target

    @property
    def band(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Used band ((fy low, fy high), (fx low, fx high)) in cycles per metre."""
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
        into = self.into.widest(shape)
        back = self.back.widest(self.into.shape_after(shape))
        return (max(into[0], back[0]), max(into[1], back[1]))

    @property
    def work_samples(self) -> int:
        """Samples of the work space of a field, besides input and output."""
        (ny, _), (my, mx) = self.request.grid.shape, self.into.shape_after(self.request.grid.shape)
        rows = max(ny, self.out_grid.shape[0]) if self.factor is not None else ny
        return max(rows, my if self.factor is None else 0) * max(mx, self.out_grid.shape[1])


def exceeds_energy(r: Request) -> bool:
    """Return True if a sample of the kernel gives more than all light: d^2 > lam z, or z < d."""
    if not r.axes:
        return False
    shares = [r.grid.pitch[axis] / math.sqrt(r.wavelength * abs(r.z)) for axis in r.axes]
    near = math.hypot(1, r.wavelength / (2 * math.pi * r.z))  # of 1/r - ik over k
    return max(*shares, math.prod(shares) * near) > 1


def flops(description: Description) -> float:
    """Return the operations of the Fourier transforms of a field, 5 L log2 L each.

    Zero rows of padded windows are not transformed: the lines along x have the input's rows, and
    the lines back along x only the output's. The transfer function is computed once per plan and
    not counted. VkFFT transforms some of the zero rows, too.
    """
    ny, _ = description.request.grid.shape
    _, mx = description.into.shape_after(description.request.grid.shape)
    across = ny * _transforms(description.into.x) + mx * _transforms(description.into.y)
    operations = (
        across
        + mx * _transforms(description.back.y)
        + description.out_grid.shape[0] * _transforms(description.back.x)
    )
    return operations * max(1, len(description.terms))


def samples_held(description: Description) -> int:
    """Return the complex samples of a plan, its work space and the result of a field."""
    if description.kind == "nothing":
        return 0
    stored = factor_samples(description)
    result = math.prod(description.out_grid.shape)
    return stored + table_samples(description) + 2 * description.work_samples + result


def factor_samples(description: Description) -> int:
    """Return the complex samples of the factors of a plan."""
    if description.factor is None:
        return 0
    return math.prod(description.factor.stored) * max(1, len(description.terms))


def least_samples(r: Request) -> int:
    """Return the minimum of complex samples of a request, known before a plan is made."""
    (ny, nx), (my, mx) = r.grid.shape, r.target.shape
    length = nx if nx == 1 or r.method in SELF_PADDED else round(r.pad * nx)
    return max(my * mx, ny * length)


def table_samples(description: Description) -> int:
    """Return the complex samples of the 1-D tables of all maps, without repetitions."""
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
    """Return the operations of the transforms of a line of samples."""
    each = {"none": 0, "forward": 1, "inverse": 1, "convolve": 2}
    return sum(each[line.kind] * 5 * line.length * math.log2(line.length) for line in lines)
