"""Parts of an optical system: frozen data that act on a field."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from numbers import Real
from operator import attrgetter
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from clplen import units
from clplen.checks import Aliasing, alias_argument, is_finite
from clplen.errors import SamplingWarning, warn_caller
from clplen.units import metres
from clplen.wave.elements.edges import Edges, check_edges
from clplen.wave.elements.hard_apertures import aperture
from clplen.wave.elements.lens import (
    Form,
    focal_length_slope,
    thin_lens,
    thin_lens_gradient,
)
from clplen.wave.field.adjoints import pointwise_adjoint
from clplen.wave.field.field import Field, Grid

Shape = Literal["circular", "square"]


@runtime_checkable
class Part(Protocol):
    """Anything with ``apply``; ``label``, ``describe()`` and ``length`` are used where it has them.

    ``label`` is a word for figures and tables, ``describe()`` the words beside it, ``length`` what
    the part takes of the axis in metres.

    Parameters
    ----------
    *args, **kwargs : object
        Of the class that fulfils the protocol; the protocol itself is not made.

    Examples
    --------
    >>> class Prism:
    ...     label = "prism"
    ...     def apply(self, field):
    ...         return clplen.wave.tilt(field, (0.0, 0.01))
    >>> isinstance(Prism(), clplen.wave.Part), isinstance(clplen.wave.Lens(0.1), clplen.wave.Part)
    (True, True)
    """

    def apply(self, field: Field) -> Field:
        """The field behind the part."""


@alias_argument(f="focal_length")
@dataclass(frozen=True)
class Lens:
    """A thin lens, by `thin_lens`.

    Parameters
    ----------
    focal_length : float
        In metres, not 0; negative diverges.
    diameter : float, optional
        Of its circular aperture in metres; None: unbounded.
    form : {"paraxial", "stigmatic"}
        As in `thin_lens`.
    aliasing : {"raise", "warn", "allow"}
        What to do when its phase is sampled too coarsely, as in `thin_lens`.

    Raises
    ------
    ValueError
        For a focal length of 0 or NaN, a diameter that is not positive, or another form.

    Examples
    --------
    >>> lens = clplen.wave.Lens(0.1, diameter=500e-6)
    >>> lens.describe()
    'f = 100 mm, D = 500 um, paraxial'
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> focus = clplen.OpticalSystem([lens, 0.1])(wave).intensity().to_numpy()
    >>> [int(i) for i in np.unravel_index(focus.argmax(), focus.shape)]
    [32, 32]
    """

    focal_length: float
    _: KW_ONLY
    diameter: float | None = None
    form: Form = "paraxial"
    aliasing: Aliasing = "raise"
    label = "lens"
    f = property(attrgetter("focal_length"), doc="Focal length in metres.")

    def __post_init__(self) -> None:
        if (
            not isinstance(self.focal_length, Real)
            or self.focal_length != self.focal_length
            or self.focal_length == 0
        ):
            raise ValueError(f"The focal length is not 0, in metres; got {self.focal_length!r}.")
        units.WEAK_LENS.check(self.focal_length, "The focal length")
        if self.diameter is not None:
            require_positive("The diameter of a lens", self.diameter)
            units.DIAMETER.check(self.diameter, "The diameter of a lens")
        if self.form not in ("paraxial", "stigmatic"):
            raise ValueError(f"A lens is 'paraxial' or 'stigmatic', not {self.form!r}.")

    def apply(self, field: Field) -> Field:
        """The field behind the lens.

        Warns
        -----
        SamplingWarning
            If the window of the field cuts the aperture of the lens.
        """
        if self.diameter is not None:
            _warn_if_cut(field.grid, self.diameter, (0.0, 0.0), "lens")
        return thin_lens(
            field, self.focal_length, diameter=self.diameter, form=self.form, aliasing=self.aliasing
        )

    def adjoint(self, field: Field) -> Field:
        """The adjoint of `apply`: the lens of the negative focal length."""
        return thin_lens(
            field, -self.focal_length, diameter=self.diameter, form=self.form, aliasing="allow"
        )

    def gradient(self, field: Field, cotangent: Field) -> dict[str, float]:
        """The gradient of a loss by "focal_length", per metre: see `thin_lens_gradient`."""
        return thin_lens_gradient(
            field, cotangent, self.focal_length, diameter=self.diameter, form=self.form
        )

    def pullback(self, field: Field, cotangent: Field) -> tuple[Field, dict[str, float]]:
        """`adjoint` of the gradient behind the lens and `gradient`, which is made of it."""
        before = self.adjoint(cotangent)
        slope = focal_length_slope(field, before, self.focal_length, self.form)
        return before, {"focal_length": slope}

    def describe(self) -> str:
        """Focal length, diameter and form."""
        bound = "unbounded" if self.diameter is None else f"D = {metres(self.diameter)}"
        return f"f = {metres(self.focal_length)}, {bound}, {self.form}"


@dataclass(frozen=True)
class Stop:
    """A hard aperture, by `aperture`.

    Parameters
    ----------
    diameter : float
        Of the circle, or side of the square, in metres.
    shape : {"circular", "square"}
        Of the opening.
    centre : tuple of float
        (y, x) in metres.
    edges : {"samples", "area", "pixels"}
        As in `aperture`.

    Raises
    ------
    ValueError
        For a diameter that is not positive, another shape or other edges, or a centre that is not
        finite.

    Examples
    --------
    >>> stop = clplen.wave.Stop(400e-6)
    >>> stop.describe()
    'circular, D = 400 um'
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> f"{stop.apply(wave).to_numpy().real.sum() * 1e-4 / (np.pi / 4 * 0.4**2):.4f} of the disc"
    '1.0000 of the disc'
    """

    diameter: float
    _: KW_ONLY
    shape: Shape = "circular"
    centre: tuple[float, float] = (0.0, 0.0)
    edges: Edges = "area"
    label = "stop"

    def __post_init__(self) -> None:
        require_positive("The diameter of a stop", self.diameter)
        units.DIAMETER.check(self.diameter, "The diameter of a stop")
        if self.shape not in ("circular", "square"):
            raise ValueError(f"A stop is 'circular' or 'square', not {self.shape!r}.")
        if np.shape(self.centre) != (2,) or not np.isfinite(self.centre).all():
            raise ValueError(f"The centre of a stop is (y, x) in metres, not {self.centre!r}.")
        check_edges(self.edges)
        object.__setattr__(self, "centre", (float(self.centre[0]), float(self.centre[1])))

    def apply(self, field: Field) -> Field:
        """The field behind the stop.

        Warns
        -----
        SamplingWarning
            If the window of the field cuts the opening.
        """
        _warn_if_cut(field.grid, self.diameter, self.centre, "stop")
        return aperture(
            field, self.diameter, shape=self.shape, centre=self.centre, edges=self.edges
        )

    def adjoint(self, field: Field) -> Field:
        """The adjoint of `apply`: the field times the conjugate transmission."""
        return pointwise_adjoint(self.apply, field)

    def describe(self) -> str:
        """Shape, diameter, edges unless by area and, off the axis, the centre."""
        text = f"{self.shape}, D = {metres(self.diameter)}"
        if self.edges != "area":
            text += f", edges by {self.edges}"
        if self.centre == (0.0, 0.0):
            return text
        return f"{text}, centre (y, x) = ({metres(self.centre[0])}, {metres(self.centre[1])})"


@dataclass(frozen=True)
class ConvergingLight:
    """Lights a transparent object by a converging wave: u exp(-i pi r^2/(lam z)).

    The zero order of every object point then goes through the axis at z (Goodman 2005, section
    5.3.2): with the lens of an imaging system there, the lens does not vignette the object.

    Parameters
    ----------
    z : float
        Distance of the focus in metres, positive.
    aliasing : {"raise", "warn", "allow"}
        As in `thin_lens`.

    Raises
    ------
    ValueError
        For a distance that is not positive.

    Examples
    --------
    >>> light = clplen.wave.ConvergingLight(0.2)
    >>> light.describe()
    'focus 200 mm on'
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> focus = clplen.OpticalSystem([light, 0.2])(wave).intensity().to_numpy()
    >>> [int(i) for i in np.unravel_index(focus.argmax(), focus.shape)]
    [32, 32]
    """

    z: float
    _: KW_ONLY
    aliasing: Aliasing = "raise"
    label = "converging light"

    def __post_init__(self) -> None:
        require_positive("The distance of the focus", self.z)

    def apply(self, field: Field) -> Field:
        """The lit object."""
        return thin_lens(field, self.z, aliasing=self.aliasing)

    def adjoint(self, field: Field) -> Field:
        """The adjoint of `apply`: light that diverges as it converged."""
        return thin_lens(field, -self.z, aliasing="allow")

    def gradient(self, field: Field, cotangent: Field) -> dict[str, float]:
        """The gradient of a loss by the distance of the focus, "z", per metre."""
        return {"z": thin_lens_gradient(field, cotangent, self.z)["focal_length"]}

    def describe(self) -> str:
        """Where the light converges."""
        return f"focus {metres(self.z)} on"


@dataclass(frozen=True)
class Element:
    """Any function of a field as a part.

    Parameters
    ----------
    function : callable
        Takes a `Field` and returns one.
    name : str
        A word for figures and tables.
    length : float
        What it takes of the axis in metres.
    adjoint_function : callable, optional
        The adjoint of a linear ``function`` that keeps the grid, for gradients; takes a `Field` and
        returns one.

    Examples
    --------
    >>> prism = clplen.wave.Element(lambda field: clplen.wave.tilt(field, (0.0, 0.01)), "prism")
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> prism.label, prism.apply(wave).shape
    ('prism', (64, 64))
    """

    function: Callable[[Field], Field]
    name: str
    _: KW_ONLY
    length: float = 0.0
    adjoint_function: Callable[[Field], Field] | None = None

    @property
    def label(self) -> str:
        """The name."""
        return self.name

    def apply(self, field: Field) -> Field:
        """What the function returns.

        Raises
        ------
        TypeError
            If that is no `Field`.
        """
        out = self.function(field)
        if not isinstance(out, Field):
            raise TypeError(f"The element {self.name!r} returns a Field, not {type(out).__name__}.")
        return out

    def adjoint(self, field: Field) -> Field:
        """What the adjoint function returns.

        Raises
        ------
        TypeError
            If there is none.
        """
        if self.adjoint_function is None:
            raise TypeError(
                f"The element {self.name!r} is a function without an adjoint: give "
                "Element(adjoint_function=), too."
            )
        return self.adjoint_function(field)

    def describe(self) -> str:
        """Its length, if any."""
        return metres(self.length) if self.length else ""


def length_of(part: Part) -> float:
    """What a part takes of the axis in metres, 0 for what lies in one plane."""
    return float(getattr(part, "length", 0.0))


def label_of(part: Part) -> str:
    """Return a part's ``label``, else the name of its class."""
    return str(getattr(part, "label", type(part).__name__))


def text_of(part: Part) -> str:
    """Return what a part's ``describe()`` says, else its repr."""
    describe = getattr(part, "describe", None)
    return repr(part) if describe is None else str(describe())


def require_positive(what: str, value: float) -> None:
    """Refuse a length that is not positive and finite."""
    if not (is_finite(value) and value > 0):
        raise ValueError(f"{what} is positive, in metres, not {value!r}.")


def _warn_if_cut(grid: Grid, diameter: float, centre: tuple[float, float], what: str) -> None:
    """Warn where the window is smaller than an opening by more than half a sample."""
    for axis, name in enumerate("yx"):
        n, pitch, origin = grid.shape[axis], grid.pitch[axis], grid.origin[axis]
        low, high = centre[axis] - diameter / 2 - origin, centre[axis] + diameter / 2 - origin
        allowed = pitch * (0.5 + 1e-6)
        first, last = -(n // 2 + 0.5) * pitch, (n - n // 2 - 0.5) * pitch
        if n == 1 or (low >= first - allowed and high <= last + allowed):
            continue
        needed = math.ceil(2 * max(-low, high) / pitch - 1e-6)
        warn_caller(
            f"The window of {metres(n * pitch)} along {name} cuts the {what} of "
            f"D = {metres(diameter)}, so that the window decides which light passes: take at least "
            f"{needed} samples of {metres(pitch)} for {n}.",
            SamplingWarning,
        )
        return
