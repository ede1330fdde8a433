"""An optical system as a linear map of fields on a grid, with its adjoint and gradients."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import DeviceLike, as_device, require_same_device
from clplen.compute.linear_map import Solvable
from clplen.errors import ShapeError
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.systems.components import Lens, Part, label_of
from clplen.wave.systems.space import Space


@dataclass(frozen=True, eq=False, repr=False)
class SystemGradient:
    """Gradients of a loss by the input of a system and by its parameters.

    Attributes
    ----------
    field : Field
        Gradient by the field in front of the system: dL/dRe u + i dL/dIm u.
    parameters : dict of int to dict
        Gradients by the requested parameters, by index of the part and name.

    Examples
    --------
    >>> wave = clplen.wave.plane_wave(clplen.Grid((32, 32), 10e-6), wavelength=500e-9)
    >>> system = clplen.OpticalSystem([clplen.wave.Lens(0.1, diameter=300e-6), 0.05])
    >>> image, pullback = system.vjp(wave, parameters=[1])
    >>> gradient = pullback(clplen.wave.intensity_gradient(image, np.ones(image.shape)))
    >>> gradient.field.shape, list(gradient.parameters[1])
    ((32, 32), ['z'])
    """

    field: Field
    parameters: dict[int, dict[str, Any]]

    def __repr__(self) -> str:
        parts = ", ".join(map(str, self.parameters)) or "no part"
        return f"<SystemGradient by a field {self.field.shape} and parameters of {parts}>"


class SystemOperator(Solvable):
    """Optical system for fields on a grid at a wavelength, returned by `OpticalSystem`.

    Parameters
    ----------
    parts : tuple of Part
        Parts in the order in which light passes them.
    grid : Grid
        Grid in front of the first part.
    wavelength : float
        Wavelength in metres.
    device : Device or str
        Device of the fields.

    Attributes
    ----------
    grids : tuple of Grid
        Grids in front of each part and behind the last.

    Examples
    --------
    >>> grid = clplen.Grid((32, 48), 10e-6)
    >>> system = clplen.OpticalSystem([clplen.wave.Lens(0.1, diameter=300e-6), 0.05])
    >>> operator = system.operator(grid, wavelength=500e-9)
    >>> matrix = operator.as_linear_operator()
    >>> matrix.shape
    (1536, 1536)
    >>> u, v = np.ones(1536, "c8"), np.linspace(0, 1, 1536).astype("c8")
    >>> bool(np.isclose(np.vdot(v, matrix @ u), np.vdot(matrix.H @ v, u), rtol=1e-5))
    True
    """

    def __init__(
        self, parts: tuple[Part, ...], grid: Grid, wavelength: float, device: DeviceLike
    ) -> None:
        self.parts, self.grid, self.wavelength = parts, grid, wavelength
        self.device = as_device(device, optional=False)
        grids = [grid]
        for part in parts:
            behind = grids[-1]
            if isinstance(part, Space):
                behind = part.plan(behind, wavelength, self.device).out_grid
            grids.append(behind)
        self.grids = tuple(grids)

    def __repr__(self) -> str:
        return (
            f"<SystemOperator of {len(self.parts)} parts, {self.in_shape} to {self.out_shape}, "
            f"{self.device.name}>"
        )

    def __call__(self, field: Field) -> Field:
        """Return the field behind the last part."""
        self._check(field, self.grid, "in front of")
        for part in self.parts:
            field = part.apply(field)
        return field

    def adjoint(self, field: Field) -> Field:
        """Apply the adjoint, from behind the last part to in front of the first.

        Parameters
        ----------
        field : Field
            Field on the last of ``grids``, shape (..., my, mx).

        Returns
        -------
        Field
            Field on the first grid, shape (..., ny, nx).

        Raises
        ------
        ShapeError
            If the grid or the wavelength differs.
        TypeError
            If a part has no adjoint.
        """
        self._check(field, self.grids[-1], "behind")
        for number in range(len(self.parts))[::-1]:
            field = self._adjoint_of(number, field)
        return field

    def vjp(self, field: Field, *, parameters: Iterable[int] = ()) -> tuple[Field, SystemPullback]:
        """Return the field behind the system and the pullback of gradients.

        Parameters
        ----------
        field : Field
            Field in front of the first part, shape (..., ny, nx).
        parameters : iterable of int
            Indices of the parts whose parameters have gradients, from 0.

        Returns
        -------
        Field
            Field behind the last part.
        SystemPullback
            Map from the gradient by that field; it stores a field for each of ``parameters``.

        Raises
        ------
        IndexError
            If an index is out of range.
        TypeError
            If a part has no parameters with gradients.
        """
        self._check(field, self.grid, "in front of")
        chosen = sorted({self._number(index) for index in parameters})
        fields: dict[int, Field] = {}
        for number, part in enumerate(self.parts):
            if number in chosen:
                fields[number] = field
            field = part.apply(field)
        return field, SystemPullback(self, fields)

    @property
    def in_shape(self) -> tuple[int, int]:
        """Shape (ny, nx) of the first grid."""
        return self.grids[0].shape

    @property
    def out_shape(self) -> tuple[int, int]:
        """Shape (my, mx) of the last grid."""
        return self.grids[-1].shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Dtype complex64, or complex128 on a device of double precision."""
        return self.device.complex

    def forward_data(self, data: cla.Array) -> cla.Array:
        """Apply the system to samples of the device, shape (..., ny, nx)."""
        return self(Field(data, self.grid, self.wavelength, self.device)).data

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """Apply `adjoint` to samples of the device, shape (..., my, mx)."""
        return self.adjoint(Field(data, self.grids[-1], self.wavelength, self.device)).data

    def _adjoint_of(self, number: int, field: Field) -> Field:
        part = self.parts[number]
        if isinstance(part, Space):
            return part.adjoint(field, self.grids[number])
        adjoint = getattr(part, "adjoint", None)
        if adjoint is None:
            raise TypeError(
                f"Part {number}, {label_of(part)}, has no adjoint; define adjoint(field)."
            )
        return replace(adjoint(field), grid=self.grids[number])

    def _number(self, number: int) -> int:
        count = len(self.parts)
        if not -count <= number < count:
            raise IndexError(f"parameters must be from 0 to {count - 1}, got {number}.")
        number %= count
        if not hasattr(self.parts[number], "gradient"):
            raise TypeError(
                f"Part {number}, {label_of(self.parts[number])}, has no parameters with gradients; "
                "remove it from parameters=, or define gradient(field, cotangent)."
            )
        return number

    def _check(self, field: Field, grid: Grid, where: str) -> None:
        require_field(field)
        require_same_device(field.device, self.device)
        if field.grid != grid or field.wavelength != self.wavelength:
            raise ShapeError(
                f"The field {where} the system must be on {grid} at {self.wavelength:g} m, got "
                f"{field.grid} at {field.wavelength:g} m."
            )


class SystemPullback:
    """Map from the gradient of a loss to gradients of a system, by `SystemOperator.vjp`.

    Parameters
    ----------
    operator : SystemOperator
        The system.
    fields : dict of int to Field
        Fields in front of the parts whose parameters have gradients.

    Examples
    --------
    >>> wave = clplen.wave.plane_wave(clplen.Grid((32, 32), 10e-6), wavelength=500e-9)
    >>> image, pullback = clplen.OpticalSystem([0.01]).vjp(wave, parameters=[0])
    >>> pullback.nbytes  # of the stored field
    8192
    >>> gradient = pullback(image)  # of the power, half of it
    >>> gradient.field.shape
    (32, 32)
    """

    def __init__(self, operator: SystemOperator, fields: dict[int, Field]) -> None:
        self._operator, self._fields = operator, fields

    def __repr__(self) -> str:
        return f"<SystemPullback through {len(self._operator.parts)} parts, {self.nbytes} bytes>"

    @property
    def nbytes(self) -> int:
        """Bytes of the stored fields on the device."""
        return sum(int(field.data.nbytes) for field in self._fields.values())

    def __call__(self, cotangent: Field) -> SystemGradient:
        """Return the gradients by the field in front and by the parameters.

        Parameters
        ----------
        cotangent : Field
            Gradient by the field behind the system, with its shape.
        """
        operator = self._operator
        operator._check(cotangent, operator.grids[-1], "behind")
        gradients: dict[int, dict[str, Any]] = {}
        for number in range(len(operator.parts))[::-1]:
            part: Any = operator.parts[number]
            if number in self._fields and isinstance(part, Lens):
                cotangent, gradients[number] = part.pullback(self._fields[number], cotangent)
                continue
            if number in self._fields:
                gradients[number] = part.gradient(self._fields[number], cotangent)
            cotangent = operator._adjoint_of(number, cotangent)
        return SystemGradient(cotangent, gradients)
