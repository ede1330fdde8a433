"""Optical systems: a sequence of parts and distances along an axis."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from numbers import Real
from typing import Any, ClassVar, overload

from clplen import units
from clplen.checks import Aliasing, fits_float64, float64_array, is_finite
from clplen.compute.device import DeviceLike, as_device
from clplen.reprs import OneLine
from clplen.results import Plottable
from clplen.units import metres
from clplen.wave.field.field import Field, Grid, require_field, require_grid
from clplen.wave.field.intensity import (
    MeanIntensity,
    Object,
    PartialCoherence,
    average_of,
    check_averaging,
)
from clplen.wave.propagation.propagator import Propagator
from clplen.wave.systems.components import (
    ConvergingLight,
    Element,
    Lens,
    Part,
    label_of,
    length_of,
    require_positive,
    text_of,
)
from clplen.wave.systems.space import Space
from clplen.wave.systems.system_operator import SystemOperator, SystemPullback


@dataclass(frozen=True, init=False, repr=False)
class OpticalSystem(OneLine, Plottable):
    """Parts along an axis, in the order in which light passes them.

    Parameters
    ----------
    parts : iterable
        Parts: `Space`, `Lens`, `Stop`, `MicrolensArray`, `Element` or other objects with
        ``apply(field)``. A number is a distance in metres, a function Field -> Field an element; a
        system is replaced by its parts.

    Attributes
    ----------
    parts : tuple of Part
        Parts in order, including those of nested systems.

    Raises
    ------
    ValueError
        If there are no parts, or a distance is not finite.
    TypeError
        If an item is not a part.

    Examples
    --------
    >>> lens = clplen.wave.Lens(0.02, diameter=0.5e-3)
    >>> system = clplen.OpticalSystem([0.04, lens, 0.04])  # one to one
    >>> print(system)
    optical system of 3 parts, 80 mm long ...
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> hole = clplen.aperture(wave, 0.2e-3)
    >>> f"{system(hole).power() / hole.power():.2f} of the light reaches the image"
    '0.93 of the light reaches the image'
    """

    _figure: ClassVar[str] = "system"

    parts: tuple[Part, ...]

    def __init__(self, parts: Iterable[Any]) -> None:
        if not isinstance(parts, Iterable):
            raise TypeError(f"An optical system must be a sequence of parts, got {parts!r}.")
        members: list[Part] = []
        for number, part in enumerate(parts, 1):
            members.extend(part.parts if isinstance(part, OpticalSystem) else [_part(part, number)])
        if not members:
            raise ValueError("An optical system requires at least one part.")
        object.__setattr__(self, "parts", tuple(members))

    @overload
    def __call__(self, field: Field) -> Field: ...
    @overload
    def __call__(
        self, field: Object, *, coherence: PartialCoherence, **averaging: Any
    ) -> MeanIntensity: ...
    def __call__(
        self, field: Any, *, coherence: PartialCoherence | None = None, **averaging: Any
    ) -> Field | MeanIntensity:
        """Return the field (or each of a batch) behind the last part, or the mean intensity.

        Parameters
        ----------
        field : Field
            Field in front of the first part, shape (..., ny, nx); with ``coherence`` the
            transmission of an object, shape (ny, nx).
        coherence : Coherence, optional
            Light that illuminates the object.
        **averaging
            Arguments of `Coherence.average`, with ``coherence``: snapshots, rtol, region,
            checkpoint, progress and method.

        Returns
        -------
        Field
            Field behind the system, or a `MeanIntensity` with ``coherence``.

        Raises
        ------
        TypeError
            If options of an average are set without ``coherence``.
        """
        check_averaging(averaging, coherence, OpticalSystem.__call__, "OpticalSystem")
        if coherence is not None:
            return average_of(coherence)(self, field, **averaging)
        for _, _, behind in self.trace(field):
            field = behind
        return field

    def trace(self, field: Field) -> Iterator[tuple[float, Part, Field]]:
        """Yield the field behind each part in turn.

        Parameters
        ----------
        field : Field
            Field in front of the first part, shape (..., ny, nx).

        Yields
        ------
        z : float
            Position behind the part, in metres from the start.
        part : Part
            Part of the system.
        field : Field
            Field behind the part.

        Raises
        ------
        TypeError
            If ``field`` is not a `Field`.
        """
        if not isinstance(field, Field):
            raise TypeError(f"field must be a Field, got {type(field).__name__}.")
        for part, z in zip(self.parts, self.positions, strict=True):
            field = part.apply(field)
            yield z + length_of(part), part, field

    def operator(
        self, grid: Grid, *, wavelength: float, device: DeviceLike | None = None
    ) -> SystemOperator:
        """Return the system as a linear map of fields on a grid, with its adjoint.

        Parameters
        ----------
        grid : Grid
            Grid in front of the first part.
        wavelength : float
            Wavelength in metres.
        device : Device or str, optional
            Default ``Device.open()``.
        """
        require_grid(grid)
        return SystemOperator(self.parts, grid, float(float64_array(wavelength)), as_device(device))

    def adjoint(self, field: Field, *, grid: Grid | None = None) -> Field:
        """Apply the adjoint, <S u, v> = <u, S' v>, from the last part to the first.

        Parameters
        ----------
        field : Field
            Field behind the last part, shape (..., my, mx).
        grid : Grid, optional
            Grid in front of the first part; by default that of the field.

        Raises
        ------
        ShapeError
            If the system does not map that grid to the field's.
        TypeError
            If a part has no adjoint.
        """
        require_field(field)
        start = field.grid if grid is None else grid
        operator = self.operator(start, wavelength=field.wavelength, device=field.device)
        return operator.adjoint(field)

    def vjp(self, field: Field, *, parameters: Iterable[int] = ()) -> tuple[Field, SystemPullback]:
        """Return the field behind the system and its pullback; see `SystemOperator.vjp`."""
        require_field(field)
        operator = self.operator(field.grid, wavelength=field.wavelength, device=field.device)
        return operator.vjp(field, parameters=parameters)

    @property
    def positions(self) -> tuple[float, ...]:
        """Positions at which the parts begin, in metres from the start."""
        lengths = [length_of(part) for part in self.parts]
        return tuple(math.fsum(lengths[:index]) for index in range(len(lengths)))

    @property
    def length(self) -> float:
        """Length of the system in metres."""
        return math.fsum(length_of(part) for part in self.parts)

    def __len__(self) -> int:
        return len(self.parts)

    def __iter__(self) -> Iterator[Part]:
        return iter(self.parts)

    @overload
    def __getitem__(self, index: int) -> Part: ...
    @overload
    def __getitem__(self, index: slice) -> OpticalSystem: ...
    def __getitem__(self, index: int | slice) -> Part | OpticalSystem:
        return OpticalSystem(self.parts[index]) if isinstance(index, slice) else self.parts[index]

    def __add__(self, other: Any) -> OpticalSystem:
        return OpticalSystem([*self.parts, other])

    def __str__(self) -> str:
        wide = max(len(label_of(part)) for part in self.parts)
        count = f"{len(self)} part" + "s" * (len(self) > 1)
        lines = [f"optical system of {count}, {metres(self.length)} long"]
        lines.append(f"   no  {'part':<{wide}}  {'z':>8}")
        for number, (part, z) in enumerate(zip(self.parts, self.positions, strict=True), 1):
            value, unit = metres(z).split()
            row = f"  {number:>3}  {label_of(part):<{wide}}  {value:>8} {unit:<2}  {text_of(part)}"
            lines.append(row.rstrip())
        return "\n".join(lines)


def imaging_system(
    focal_length: float,
    *,
    diameter: float,
    magnification: float = 1.0,
    method: str = "auto",
    pad: float = 2,
    koehler: bool = False,
    aliasing: Aliasing = "raise",
) -> OpticalSystem:
    """Return a lens that images a plane: distance z1, lens, distance z2.

    With 1/f = 1/z1 + 1/z2 and M = z2/z1: z1 = f (1 + 1/M), z2 = f (1 + M); 2f and 2f by default.
    The point x of the object is imaged at -M x (Goodman 2005, section 5.3).

    Parameters
    ----------
    focal_length : float
        Focal length in metres, positive.
    diameter : float
        Diameter of the lens in metres; the window of the field must contain it.
    magnification : float
        Ratio M, positive: image height over object height; the image is upside down.
    method : str
        Method of both distances, as in `propagate`.
    pad : float
        Padding of both distances, as in `propagate`.
    koehler : bool
        True to illuminate the object by light that converges on the lens (`ConvergingLight`)
        instead of a plane wave, whose shadow of the object would have to fit through the lens.
    aliasing : {"raise", "warn", "allow"}
        Action if the phase of the lens or the light is undersampled, as in `thin_lens`.

    Returns
    -------
    OpticalSystem
        Space, lens and space, preceded by `ConvergingLight` if ``koehler``.

    Raises
    ------
    ValueError
        If the focal length, diameter or magnification is not positive.

    Examples
    --------
    >>> print(clplen.wave.imaging_system(0.1, diameter=500e-6, magnification=2.0))
    optical system of 3 parts, 450 mm long
       no  part          z
        1  space         0 m   150 mm, method auto
        2  lens        150 mm  f = 100 mm, D = 500 um, paraxial
        3  space       150 mm  300 mm, method auto
    """
    require_positive("The focal length of an imaging system", focal_length)
    units.FOCAL_LENGTH.check(focal_length, "The focal length of an imaging system")
    require_positive("The diameter of its lens", diameter)
    units.DIAMETER.check(diameter, "The diameter of its lens")
    if not (is_finite(magnification) and magnification > 0):
        raise ValueError(f"The magnification must be positive and finite, got {magnification!r}.")
    z1 = focal_length * (1 + 1 / magnification)
    z2 = focal_length * (1 + magnification)
    parts: list[Part] = [
        Space(z1, method=method, pad=pad),
        Lens(focal_length, diameter=diameter, aliasing=aliasing),
        Space(z2, method=method, pad=pad),
    ]
    return OpticalSystem([ConvergingLight(z1, aliasing=aliasing), *parts] if koehler else parts)


def _part(item: Any, number: int) -> Part:
    """Convert an item of a system to a part."""
    if isinstance(item, Real) and not isinstance(item, bool):
        if not fits_float64(item):
            raise ValueError(
                f"Part {number} of the system must be a finite distance in metres, got {item!r}."
            )
        return Space(float(item))
    if isinstance(item, Propagator):
        return Element(item, f"propagator ({item.method})", length=item.z)
    if isinstance(item, Part) and not isinstance(item, type):
        return item
    if callable(item) and not isinstance(item, type):
        return Element(item, getattr(item, "__name__", type(item).__name__))
    raise TypeError(
        f"Part {number} of the system must be a distance in metres, a function of a field, or an "
        f"object with apply(field), got {item!r}."
    )
