"""Parts of an optical system: immutable objects that act on a field."""

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
    """Part of an optical system: an object with a method ``apply``.

    The attribute ``label`` (a word for figures and tables), the method ``describe()`` (its details)
    and the attribute ``length`` (length along the axis in metres) are optional.

    Parameters
    ----------
    *args, **kwargs : object
        Arguments of the class that implements the protocol, which itself cannot be instantiated.

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
        """Return the field behind the part."""


@alias_argument(f="focal_length")
@dataclass(frozen=True)
class Lens:
    """Thin lens, by `thin_lens`.

    Parameters
    ----------
    focal_length : float
        Focal length in metres, not 0; negative diverges.
    diameter : float, optional
        Diameter of the circular aperture in metres; None: unbounded.
    form : {"paraxial", "stigmatic"}
        Form of the phase, as in `thin_lens`.
    aliasing : {"raise", "warn", "allow"}
        Action if the phase is undersampled, as in `thin_lens`.

    Raises
    ------
    ValueError
        If the focal length is 0 or NaN, the diameter not positive, or the form unknown.

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
            raise ValueError(f"focal_length must not be 0 or NaN, got {self.focal_length!r}.")
        units.WEAK_LENS.check(self.focal_length, "The focal length")
        if self.diameter is not None:
            require_positive("The diameter of a lens", self.diameter)
            units.DIAMETER.check(self.diameter, "The diameter of a lens")
        if self.form not in ("paraxial", "stigmatic"):
            raise ValueError(f"form must be 'paraxial' or 'stigmatic', got {self.form!r}.")

    def apply(self, field: Field) -> Field:
        """Return the field behind the lens.

        Warns
        -----
        SamplingWarning
            If the window of the field is smaller than the aperture of the lens.
        """
        if self.diameter is not None:
            _warn_if_cut(field.grid, self.diameter, (0.0, 0.0), "lens")
        return thin_lens(
            field, self.focal_length, diameter=self.diameter, form=self.form, aliasing=self.aliasing
        )

    def adjoint(self, field: Field) -> Field:
        """Return the adjoint of `apply`: the field behind a lens of the negative focal length."""
        return thin_lens(
            field, -self.focal_length, diameter=self.diameter, form=self.form, aliasing="allow"
        )

    def gradient(self, field: Field, cotangent: Field) -> dict[str, float]:
        """Return the gradient of a loss by "focal_length", per metre; see `thin_lens_gradient`."""
        return thin_lens_gradient(
            field, cotangent, self.focal_length, diameter=self.diameter, form=self.form
        )

    def pullback(self, field: Field, cotangent: Field) -> tuple[Field, dict[str, float]]:
        """Return `adjoint` of the gradient behind the lens, and `gradient`, computed from it."""
        before = self.adjoint(cotangent)
        slope = focal_length_slope(field, before, self.focal_length, self.form)
        return before, {"focal_length": slope}

    def describe(self) -> str:
        """Return focal length, diameter and form."""
        bound = "unbounded" if self.diameter is None else f"D = {metres(self.diameter)}"
        return f"f = {metres(self.focal_length)}, {bound}, {self.form}"


@dataclass(frozen=True)
class Stop:
    """Hard aperture, by `aperture`.

    Parameters
    ----------
    diameter : float
        Diameter of the circle or side of the square in metres.
    shape : {"circular", "square"}
        Shape of the aperture.
    centre : tuple of float
        Centre (y, x) in metres.
    edges : {"samples", "area", "pixels"}
        Transmission of samples on the rim, as in `aperture`.

    Raises
    ------
    ValueError
        If the diameter is not positive, the shape or edges unknown, or the centre not finite.

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
            raise ValueError(f"shape must be 'circular' or 'square', got {self.shape!r}.")
        if np.shape(self.centre) != (2,) or not np.isfinite(self.centre).all():
            raise ValueError(f"The centre of a stop must be (y, x) in metres, got {self.centre!r}.")
        check_edges(self.edges)
        object.__setattr__(self, "centre", (float(self.centre[0]), float(self.centre[1])))

    def apply(self, field: Field) -> Field:
        """Return the field behind the stop.

        Warns
        -----
        SamplingWarning
            If the window of the field is smaller than the aperture.
        """
        _warn_if_cut(field.grid, self.diameter, self.centre, "stop")
        return aperture(
            field, self.diameter, shape=self.shape, centre=self.centre, edges=self.edges
        )

    def adjoint(self, field: Field) -> Field:
        """Return the adjoint of `apply`: the field times the conjugate transmission."""
        return pointwise_adjoint(self.apply, field)

    def describe(self) -> str:
        """Return shape, diameter, edges other than "area", and a centre off the axis."""
        text = f"{self.shape}, D = {metres(self.diameter)}"
        if self.edges != "area":
            text += f", edges by {self.edges}"
        if self.centre == (0.0, 0.0):
            return text
        return f"{text}, centre (y, x) = ({metres(self.centre[0])}, {metres(self.centre[1])})"


@dataclass(frozen=True)
class ConvergingLight:
    """Illumination of a transparent object by a converging wave: u exp(-i pi r^2/(lam z)).

    The zero order of every object point passes through the axis at z (Goodman 2005, section 5.3.2).
    An imaging lens at this distance does not vignette the object.

    Parameters
    ----------
    z : float
        Distance of the focus in metres, positive.
    aliasing : {"raise", "warn", "allow"}
        Action if the phase is undersampled, as in `thin_lens`.

    Raises
    ------
    ValueError
        If the distance is not positive.

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
        """Return the illuminated object."""
        return thin_lens(field, self.z, aliasing=self.aliasing)

    def adjoint(self, field: Field) -> Field:
        """Return the adjoint of `apply`: the field in diverging light."""
        return thin_lens(field, -self.z, aliasing="allow")

    def gradient(self, field: Field, cotangent: Field) -> dict[str, float]:
        """Return the gradient of a loss by the distance of the focus, "z", per metre."""
        return {"z": thin_lens_gradient(field, cotangent, self.z)["focal_length"]}

    def describe(self) -> str:
        """Return the distance of the focus."""
        return f"focus {metres(self.z)} on"


@dataclass(frozen=True)
class Element:
    """Function of a field as a part of a system.

    Parameters
    ----------
    function : callable
        Map from a `Field` to a `Field`.
    name : str
        Label for figures and tables.
    length : float
        Length along the axis in metres.
    adjoint_function : callable, optional
        Adjoint of a linear ``function`` that does not change the grid, for gradients; a map from a
        `Field` to a `Field`.

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
        """Name of the element."""
        return self.name

    def apply(self, field: Field) -> Field:
        """Return the result of the function.

        Raises
        ------
        TypeError
            If the result is not a `Field`.
        """
        out = self.function(field)
        if not isinstance(out, Field):
            raise TypeError(
                f"The element {self.name!r} must return a Field, got {type(out).__name__}."
            )
        return out

    def adjoint(self, field: Field) -> Field:
        """Return the result of the adjoint function.

        Raises
        ------
        TypeError
            If the element has no adjoint function.
        """
        if self.adjoint_function is None:
            raise TypeError(
                f"The element {self.name!r} has no adjoint; set Element(adjoint_function=)."
            )
        return self.adjoint_function(field)

    def describe(self) -> str:
        """Return the length, or an empty string without a length."""
        return metres(self.length) if self.length else ""


def length_of(part: Part) -> float:
    """Return the length of a part along the axis in metres, 0 for a thin part."""
    return float(getattr(part, "length", 0.0))


def label_of(part: Part) -> str:
    """Return a part's ``label``, else the name of its class."""
    return str(getattr(part, "label", type(part).__name__))


def text_of(part: Part) -> str:
    """Return the text of a part's ``describe()``, else its repr."""
    describe = getattr(part, "describe", None)
    return repr(part) if describe is None else str(describe())


def require_positive(what: str, value: float) -> None:
    """Raise unless a length is positive and finite."""
    if not (is_finite(value) and value > 0):
        raise ValueError(f"{what} must be positive, in metres, got {value!r}.")


def _warn_if_cut(grid: Grid, diameter: float, centre: tuple[float, float], what: str) -> None:
    """Warn if the window is smaller than an opening by more than half a sample."""
    for axis, name in enumerate("yx"):
        n, pitch, origin = grid.shape[axis], grid.pitch[axis], grid.origin[axis]
        low, high = centre[axis] - diameter / 2 - origin, centre[axis] + diameter / 2 - origin
        allowed = pitch * (0.5 + 1e-6)
        first, last = -(n // 2 + 0.5) * pitch, (n - n // 2 - 0.5) * pitch
        if n == 1 or (low >= first - allowed and high <= last + allowed):
            continue
        needed = math.ceil(2 * max(-low, high) / pitch - 1e-6)
        warn_caller(
            f"The window of {metres(n * pitch)} along {name} is smaller than the {what} of "
            f"D = {metres(diameter)} and blocks its light; use at least {needed} samples of "
            f"{metres(pitch)} instead of {n}.",
            SamplingWarning,
        )
        return
