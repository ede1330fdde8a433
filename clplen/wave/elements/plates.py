"""Plates as parts of an optical system, with gradients: of pixels, and of Zernike polynomials."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

import numpy as np

from clplen.checks import Aliasing
from clplen.reprs import OneLine
from clplen.types import Array
from clplen.units import metres
from clplen.wave.elements.edges import Edges
from clplen.wave.elements.transparency import (
    picture_of,
    sampled_picture_adjoint,
    transparency,
)
from clplen.wave.elements.zernike import (
    noll,
    osa,
    phase_plate,
    plate_places,
    plate_terms,
    zernike,
)
from clplen.wave.field.field import Field
from clplen.wave.field.field_gradients import transmission_gradient


@dataclass(frozen=True, eq=False, repr=False)
class PhasePlate(OneLine):
    """A plate of pixels, by `transparency`: a diffractive element, a spatial light modulator.

    Parameters
    ----------
    phase : array_like, optional
        Shape (y, x), radians; positive retards as exp(+ikz) does. None: 0, with an amplitude.
    amplitude : array_like, optional
        Of the same shape, real or complex; None: 1 on the plate.
    pitch : float or tuple of float, optional
        Of the pixels in metres, (dy, dx) or one number, as in `transparency`; None: the plate lies
        on the field's own samples.
    centre : tuple of float
        (y, x) in metres of pixel [ny//2, nx//2]; needs a pitch.
    edges : {"samples", "area", "pixels"}, optional
        What a sample takes of the pixels, as in `transparency`.

    Attributes
    ----------
    phase, amplitude : numpy.ndarray or None
        As they were given.

    Raises
    ------
    ShapeError
        If phase and amplitude differ in shape.
    ValueError
        If both are None, or a value is not finite.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> r2 = grid.x**2 + grid.y[:, None] ** 2
    >>> plate = clplen.wave.PhasePlate(-np.pi * r2 / (500e-9 * 0.02))  # a lens of 20 mm
    >>> focus = clplen.OpticalSystem([plate, 0.02])(wave).intensity().to_numpy()
    >>> [int(i) for i in np.unravel_index(focus.argmax(), focus.shape)]
    [16, 16]
    >>> cotangent = clplen.Field.from_array(np.ones(grid.shape), grid, wavelength=500e-9)
    >>> found = plate.gradient(wave, cotangent)["phase"]  # of L = sum Re(u)
    >>> found.shape, bool(np.allclose(found, -np.sin(plate.phase), atol=1e-5))
    ((32, 32), True)
    """

    phase: Any = None
    _: KW_ONLY
    amplitude: Any = None
    pitch: float | tuple[float, float] | None = None
    centre: tuple[float, float] = (0.0, 0.0)
    edges: Edges | None = None
    label = "phase plate"

    def __post_init__(self) -> None:
        picture_of(self.amplitude, self.phase)
        for name in ("phase", "amplitude"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, np.array(value))

    @property
    def shape(self) -> tuple[int, int]:
        """Pixels (ny, nx)."""
        ny, nx = (self.amplitude if self.phase is None else self.phase).shape
        return int(ny), int(nx)

    def apply(self, field: Field) -> Field:
        """The field behind the plate.

        Raises
        ------
        ShapeError, ValueError
            As `transparency`.
        """
        return transparency(field, self.amplitude, phase=self.phase, **self._place())

    def adjoint(self, field: Field) -> Field:
        """The field times the conjugate of the transmission."""
        phase = None if self.phase is None else -self.phase.astype(np.float64)
        amplitude = None if self.amplitude is None else np.conj(self.amplitude)
        return transparency(field, amplitude, phase=phase, **self._place())

    def gradient(self, field: Field, cotangent: Field) -> dict[str, Array]:
        """The gradient of a loss with respect to every pixel.

        Parameters
        ----------
        field : Field
            In front of the plate, shape (..., ny, nx).
        cotangent : Field
            dL/dRe + i dL/dIm of the field behind the plate, of the shape of ``field``.

        Returns
        -------
        dict of str to numpy.ndarray
            "phase", per radian, float64, and "amplitude", float64, or complex128 where the
            amplitude is complex; of the shape of the plate, summed over leading axes of the fields.

        Raises
        ------
        ShapeError
            If the cotangent has another shape.
        """
        of_samples = field.device.download(transmission_gradient(field, cotangent))
        of_samples = of_samples.astype(np.complex128)
        of_pixels = sampled_picture_adjoint(of_samples, self.shape, field.grid, **self._place())
        phasor = 1.0 if self.phase is None else np.exp(-1j * self.phase.astype(np.float64))
        of_amplitude = phasor * of_pixels
        if self.amplitude is None:
            return {"phase": of_amplitude.imag, "amplitude": of_amplitude.real}
        of_phase = (np.conj(self.amplitude) * of_amplitude).imag
        is_complex = np.iscomplexobj(self.amplitude)
        return {"phase": of_phase, "amplitude": of_amplitude if is_complex else of_amplitude.real}

    def describe(self) -> str:
        """Pixels, and their pitch if it is given."""
        ny, nx = self.shape
        if self.pitch is None:
            return f"{ny} x {nx} pixels"
        dy, dx = np.broadcast_to(self.pitch, 2)
        return f"{ny} x {nx} pixels of {metres(float(dy))} x {metres(float(dx))}"

    def _place(self) -> dict[str, Any]:
        return {"pitch": self.pitch, "centre": self.centre, "edges": self.edges}


@dataclass(frozen=True, repr=False)
class ZernikePlate(OneLine):
    """A plate of Zernike polynomials, by `phase_plate`.

    Parameters
    ----------
    coefficients : mapping of int to float
        Index j to metres of optical path, rms over the disc.
    diameter : float
        Of the disc, in metres.
    indexing : {"noll", "osa"}
        What j counts: see `noll` and `osa`.
    centre : tuple of float
        (y, x) in metres.
    aliasing : {"raise", "warn", "allow"}
        As in `phase_plate`.

    Raises
    ------
    TypeError
        If ``coefficients`` is no mapping.
    ValueError
        For an index that does not exist, or a coefficient that is not finite.

    Examples
    --------
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> plate = clplen.wave.ZernikePlate({1: 0.0, 4: 50e-9}, diameter=0.4e-3)
    >>> behind = plate.apply(wave)  # defocus of 0.1 waves rms
    >>> cotangent = clplen.Field.from_array(
    ...     1j * behind.to_numpy(), wave.grid, wavelength=500e-9)  # of the sum of all phases
    >>> found = plate.gradient(wave, cotangent)["coefficients"]
    >>> f"{found[1] * 500e-9 / (2 * np.pi):.0f} samples"  # of the disc, those on its rim too
    '1345 samples'
    """

    coefficients: Mapping[int, float]
    _: KW_ONLY
    diameter: float
    indexing: Literal["noll", "osa"] = "noll"
    centre: tuple[float, float] = (0.0, 0.0)
    aliasing: Aliasing = "raise"
    label = "phase plate"

    def __post_init__(self) -> None:
        plate_terms(self.coefficients, self.indexing)
        object.__setattr__(self, "coefficients", dict(self.coefficients))

    def apply(self, field: Field) -> Field:
        """The field behind the plate.

        Raises
        ------
        SamplingError, ValueError
            As `phase_plate`.
        """
        return self._multiplied(field, 1)

    def adjoint(self, field: Field) -> Field:
        """The field times the conjugate of the transmission."""
        return self._multiplied(field, -1)

    def _multiplied(self, field: Field, sign: int) -> Field:
        return phase_plate(
            field,
            {j: sign * c for j, c in self.coefficients.items()},
            diameter=self.diameter,
            indexing=self.indexing,
            centre=self.centre,
            aliasing=self.aliasing,
        )

    def gradient(self, field: Field, cotangent: Field) -> dict[str, dict[int, float]]:
        """The gradient of a loss with respect to the coefficients.

        Parameters
        ----------
        field : Field
            In front of the plate, shape (..., ny, nx).
        cotangent : Field
            dL/dRe + i dL/dIm of the field behind the plate, of the shape of ``field``.

        Returns
        -------
        dict
            "coefficients": index j to the gradient per metre.

        Raises
        ------
        ShapeError
            If the cotangent has another shape.
        """
        behind = self.apply(field)
        of_log = field.device.download(transmission_gradient(behind, cotangent))
        on_plate, rho, theta = plate_places(field.grid, self.diameter, self.centre)
        of_phase = of_log.imag[on_plate].astype(np.float64)
        orders, k = (noll if self.indexing == "noll" else osa), 2 * math.pi / field.wavelength
        found = {
            j: k * float((of_phase * zernike(*orders(j), rho, theta)).sum())
            for j in self.coefficients
        }
        return {"coefficients": found}

    def describe(self) -> str:
        """Coefficients and diameter."""
        terms = ", ".join(f"Z{j} {metres(c)}" for j, c in self.coefficients.items())
        return f"{terms}, D = {metres(self.diameter)}"
