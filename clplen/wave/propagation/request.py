"""What is asked of a propagation, checked."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

from clplen.compute import lengths
from clplen.errors import SamplingError
from clplen.wave.field.arguments import is_finite
from clplen.wave.field.field import Grid
from clplen.wave.propagation.band import FAR_GUARD, GUARD, Band, Way, guarded_band

METHODS = (
    "auto",
    "as",
    "blas",
    "cblas",
    "rs",
    "fresnel-tf",
    "fresnel-ir",
    "fresnel-1fft",
    "fresnel-multistep",
)
SELF_PADDED = ("auto", "cblas", "rs")  # methods that size their own windows
FREE_GRID = ("auto", "cblas")  # methods that take any output grid
FARTHEST = 1e12  # metres
BORDER = 0.4  # of half the window, the taper of fresnel-multistep
_SAME = 1e-9  # of a pitch


@dataclass(frozen=True)
class Request:
    """Everything that determines a propagation; the key of its plan.

    Attributes
    ----------
    grid, out_grid : Grid
        ``out_grid`` is None where the method chooses.
    z, wavelength : float
        In metres.
    method : str
    pad, border : float
    guard : float or None
        In Fresnel widths; None: `widths`.
    support : tuple of float or None
        (y, x) widths that carry light, centred on the grid, in metres; None: the whole window.
    lens : float or None
        Focal length of a thin lens right before a fresnel-1fft, in metres.

    Raises
    ------
    ValueError
        For an unknown method or a number outside its range.
    SamplingError
        For an output grid that the method cannot give.
    """

    grid: Grid
    z: float
    wavelength: float
    method: str = "auto"
    pad: float = 2
    out_grid: Grid | None = None
    guard: float | None = None
    border: float = BORDER
    support: tuple[float, float] | None = None
    lens: float | None = None

    def __post_init__(self) -> None:
        _check_numbers(self)
        if self.lens is not None and self.method != "fresnel-1fft":
            raise ValueError(
                f"lens= is for method='fresnel-1fft', not {self.method!r}: put a thin_lens before "
                "the propagation."
            )
        self._check_out_grid()

    def _check_out_grid(self) -> None:
        out = self.out_grid
        if out is None or out == self.grid:
            return
        if self.method not in (*FREE_GRID, "fresnel-1fft"):
            raise SamplingError(
                f"method={self.method!r} keeps the grid of the field, {self.grid}, but {out} was "
                "asked for: method='cblas' gives any grid."
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

    def way(self, axis: int) -> Way:
        """Where light comes from and where it is wanted along an axis (0: y, 1: x)."""
        own, other = self.grid, self.target
        window = own.extent[axis]
        return Way(
            n=own.shape[axis],
            pitch=own.pitch[axis],
            z=self.z,
            wavelength=self.wavelength,
            lit=window if self.support is None else min(self.support[axis], window),
            wanted=other.extent[axis],
            offset=other.origin[axis] - own.origin[axis],
        )

    @property
    def bands(self) -> list[Band]:
        """The guarded band of each axis, (y, x)."""
        return [guarded_band(self.way(axis), self.widths) for axis in (0, 1)]

    @property
    def widths(self) -> float:
        """The guard; where none was given 6, or 8 where S^2 < 4 lam z, S the mean of both windows.

        There 6 Fresnel widths keep less than 180 dB, and the few more frequencies cost nothing.
        """
        if self.guard is not None:
            return self.guard
        ways = [self.way(axis) for axis in self.axes]
        far = any((way.lit + way.wanted) ** 2 < 16 * way.wavelength * abs(way.z) for way in ways)
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
    lengths.WAVELENGTH.check(r.wavelength, "The wavelength")
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
