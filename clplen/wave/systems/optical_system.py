"""Optical systems: any sequence of parts and distances along one axis as one object."""

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
    """Parts along one axis, in the order in which a field meets them.

    Parameters
    ----------
    parts : iterable
        Of `Space`, `Lens`, `Stop`, `MicrolensArray`, `Element` or anything else with
        ``apply(field)``; a number is a distance in metres, a function Field -> Field an element, a
        system its parts.

    Attributes
    ----------
    parts : tuple of Part
        In order, those of systems among them one by one.

    Raises
    ------
    ValueError
        If there are no parts, or a distance is not finite.
    TypeError
        If something is no part.

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
            raise TypeError(f"An optical system is a sequence of parts, not {parts!r}.")
        members: list[Part] = []
        for number, part in enumerate(parts, 1):
            members.extend(part.parts if isinstance(part, OpticalSystem) else [_part(part, number)])
        if not members:
            raise ValueError("An optical system has at least one part; none was given.")
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
        """The field (or each of a batch) behind the last part, or the mean intensity there.

        Parameters
        ----------
        field : Field
            Shape (..., ny, nx), in front of the first part; with ``coherence`` the transmission of
            an object of shape (ny, nx).
        coherence : Coherence, optional
            The light that illuminates the object.
        **averaging
            With ``coherence``: snapshots, rtol, region, checkpoint, progress and method as in
            `Coherence.average`.

        Returns
        -------
        Field
            Or, with ``coherence``, a `MeanIntensity`.

        Raises
        ------
        TypeError
            For options of an average without ``coherence``.
        """
        check_averaging(averaging, coherence, OpticalSystem.__call__, "OpticalSystem")
        if coherence is not None:
            return average_of(coherence)(self, field, **averaging)
        for _, _, behind in self.trace(field):
            field = behind
        return field

    def trace(self, field: Field) -> Iterator[tuple[float, Part, Field]]:
        """The field behind each part in turn.

        Parameters
        ----------
        field : Field
            Shape (..., ny, nx), in front of the first part.

        Yields
        ------
        z : float
            Behind the part, in metres from the start.
        part : Part
        field : Field

        Raises
        ------
        TypeError
            If ``field`` is no `Field`.
        """
        if not isinstance(field, Field):
            raise TypeError(f"An optical system takes a Field, not {type(field).__name__}.")
        for part, z in zip(self.parts, self.positions, strict=True):
            field = part.apply(field)
            yield z + length_of(part), part, field

    def operator(
        self, grid: Grid, *, wavelength: float, device: DeviceLike | None = None
    ) -> SystemOperator:
        """The system as a linear map of fields on a grid, with its adjoint.

        Parameters
        ----------
        grid : Grid
            In front of the first part.
        wavelength : float
            In metres.
        device : Device or str, optional
            Default ``Device.open()``.
        """
        require_grid(grid)
        return SystemOperator(self.parts, grid, float(float64_array(wavelength)), as_device(device))

    def adjoint(self, field: Field, *, grid: Grid | None = None) -> Field:
        """The adjoint, <S u, v> = <u, S' v>, from behind the last part to before the first.

        Parameters
        ----------
        field : Field
            Behind the last part, shape (..., my, mx).
        grid : Grid, optional
            In front of the first part; by default that of the field.

        Raises
        ------
        ShapeError
            If the system maps that grid to another one than the field's.
        TypeError
            If a part has no adjoint.
        """
        require_field(field)
        start = field.grid if grid is None else grid
        own = self.operator(start, wavelength=field.wavelength, device=field.device)
        return own.adjoint(field)

    def vjp(self, field: Field, *, parameters: Iterable[int] = ()) -> tuple[Field, SystemPullback]:
        """The field behind the system, and what takes gradients back: see `SystemOperator.vjp`."""
        require_field(field)
        own = self.operator(field.grid, wavelength=field.wavelength, device=field.device)
        return own.vjp(field, parameters=parameters)

    @property
    def positions(self) -> tuple[float, ...]:
        """Where each part begins, in metres from the start."""
        lengths = [length_of(part) for part in self.parts]
        return tuple(math.fsum(lengths[:index]) for index in range(len(lengths)))

    @property
    def length(self) -> float:
        """From the start to the end in metres."""
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
    """Return one lens that images a plane: distance z1, lens, distance z2.

    With 1/f = 1/z1 + 1/z2 and M = z2/z1: z1 = f (1 + 1/M), z2 = f (1 + M); 2f and 2f unless told.
    The point x of the object is imaged at -M x (Goodman 2005, section 5.3).

    Parameters
    ----------
    focal_length : float
        In metres, positive.
    diameter : float
        Of the lens in metres. The window of the field must contain it.
    magnification : float
        Ratio M, positive: image height over object height; the image is upside down.
    method : str
        As in `propagate`, of both distances.
    pad : float
        As in `propagate`, of both distances.
    koehler : bool
        Whether the object is lit by light that converges on the lens (`ConvergingLight`) in place
        of a plane wave, whose shadow of the object would have to fit through the lens.
    aliasing : {"raise", "warn", "allow"}
        As in `thin_lens`, of the lens and the light.

    Returns
    -------
    OpticalSystem
        Of space, lens and space, with `ConvergingLight` before them if ``koehler``.

    Raises
    ------
    ValueError
        For a focal length, diameter or magnification that is not positive.

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
        raise ValueError(f"The magnification is positive and finite, not {magnification!r}.")
    z1 = focal_length * (1 + 1 / magnification)
    z2 = focal_length * (1 + magnification)
    parts: list[Part] = [
        Space(z1, method=method, pad=pad),
        Lens(focal_length, diameter=diameter, aliasing=aliasing),
        Space(z2, method=method, pad=pad),
    ]
    return OpticalSystem([ConvergingLight(z1, aliasing=aliasing), *parts] if koehler else parts)


def _part(item: Any, number: int) -> Part:
    """What was given for a part, as a part."""
    if isinstance(item, Real) and not isinstance(item, bool):
        if not fits_float64(item):
            raise ValueError(
                f"Part {number} of the system is a distance of {item!r}: a distance is one finite "
                "number of metres."
            )
        return Space(float(item))
    if isinstance(item, Propagator):
        return Element(item, f"propagator ({item.method})", length=item.z)
    if isinstance(item, Part) and not isinstance(item, type):
        return item
    if callable(item) and not isinstance(item, type):
        return Element(item, getattr(item, "__name__", type(item).__name__))
    raise TypeError(
        f"Part {number} of the system is {item!r}, which is neither a distance in metres, nor has "
        "it apply(field), nor is it a function of a field."
    )
