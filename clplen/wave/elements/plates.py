"""Plates as parts of an optical system, with gradients: pixels and Zernike polynomials."""

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
    plate_coordinates,
    plate_terms,
    zernike,
)
from clplen.wave.field.field import Field
from clplen.wave.field.field_gradients import transmission_gradient


@dataclass(frozen=True, eq=False, repr=False)
class PhasePlate(OneLine):
    """Plate of pixels with `transparency`: a diffractive element or spatial light modulator.

    Parameters
    ----------
    phase : array_like, optional
        Phase in radians, shape (y, x); positive retards as exp(+ikz) does. None: 0, with an
        amplitude.
    amplitude : array_like, optional
        Amplitude of equal shape, real or complex; None: 1 on the plate.
    pitch : float or tuple of float, optional
        Pitch of the pixels in metres, (dy, dx) or a single number, as in `transparency`. None: the
        pixels are the field's samples.
    centre : tuple of float
        Position (y, x) in metres of pixel [ny//2, nx//2]; requires a pitch.
    edges : {"samples", "area", "pixels"}, optional
        Sampling of the pixels, as in `transparency`.

    Attributes
    ----------
    phase, amplitude : numpy.ndarray or None
        Copies of the arguments.

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
    >>> gradient = plate.gradient(wave, cotangent)["phase"]  # of L = sum Re(u)
    >>> gradient.shape, bool(np.allclose(gradient, -np.sin(plate.phase), atol=1e-5))
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
        """Numbers of pixels (ny, nx)."""
        ny, nx = (self.amplitude if self.phase is None else self.phase).shape
        return int(ny), int(nx)

    def apply(self, field: Field) -> Field:
        """Return the field behind the plate.

        Raises
        ------
        ShapeError, ValueError
            In the cases of `transparency`.
        """
        return transparency(field, self.amplitude, phase=self.phase, **self._layout())

    def adjoint(self, field: Field) -> Field:
        """Return the field times the conjugate of the transmission."""
        phase = None if self.phase is None else -self.phase.astype(np.float64)
        amplitude = None if self.amplitude is None else np.conj(self.amplitude)
        return transparency(field, amplitude, phase=phase, **self._layout())

    def gradient(self, field: Field, cotangent: Field) -> dict[str, Array]:
        """Return the gradient of a loss with respect to every pixel.

        Parameters
        ----------
        field : Field
            Field in front of the plate, shape (..., ny, nx).
        cotangent : Field
            Gradient dL/dRe + i dL/dIm with respect to the field behind the plate, with the shape of
            ``field``.

        Returns
        -------
        dict of str to numpy.ndarray
            Gradients with the shape of the plate, summed over leading axes of the fields: "phase",
            per radian, float64, and "amplitude", float64 (complex128 for a complex amplitude).

        Raises
        ------
        ShapeError
            If the cotangent has another shape.
        """
        of_samples = field.device.download(transmission_gradient(field, cotangent))
        of_samples = of_samples.astype(np.complex128)
        of_pixels = sampled_picture_adjoint(of_samples, self.shape, field.grid, **self._layout())
        phasor = 1.0 if self.phase is None else np.exp(-1j * self.phase.astype(np.float64))
        of_amplitude = phasor * of_pixels
        if self.amplitude is None:
            return {"phase": of_amplitude.imag, "amplitude": of_amplitude.real}
        of_phase = (np.conj(self.amplitude) * of_amplitude).imag
        is_complex = np.iscomplexobj(self.amplitude)
        return {"phase": of_phase, "amplitude": of_amplitude if is_complex else of_amplitude.real}

    def describe(self) -> str:
        """Return the numbers of pixels, and their pitch if defined."""
        ny, nx = self.shape
        if self.pitch is None:
            return f"{ny} x {nx} pixels"
        dy, dx = np.broadcast_to(self.pitch, 2)
        return f"{ny} x {nx} pixels of {metres(float(dy))} x {metres(float(dx))}"

    def _layout(self) -> dict[str, Any]:
        return {"pitch": self.pitch, "centre": self.centre, "edges": self.edges}


@dataclass(frozen=True, repr=False)
class ZernikePlate(OneLine):
    """Plate of Zernike polynomials with `phase_plate`.

    Parameters
    ----------
    coefficients : mapping of int to float
        Coefficients: index j to metres of optical path, rms over the disc.
    diameter : float
        Diameter of the disc in metres.
    indexing : {"noll", "osa"}
        Meaning of j: see `noll` and `osa`.
    centre : tuple of float
        Centre (y, x) in metres.
    aliasing : {"raise", "warn", "allow"}
        Action on aliasing, as in `phase_plate`.

    Raises
    ------
    TypeError
        If ``coefficients`` is not a mapping.
    ValueError
        If an index does not exist, or a coefficient is not finite.

    Examples
    --------
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> plate = clplen.wave.ZernikePlate({1: 0.0, 4: 50e-9}, diameter=0.4e-3)
    >>> behind = plate.apply(wave)  # defocus of 0.1 waves rms
    >>> cotangent = clplen.Field.from_array(
    ...     1j * behind.to_numpy(), wave.grid, wavelength=500e-9)  # of the sum of all phases
    >>> gradient = plate.gradient(wave, cotangent)["coefficients"]
    >>> f"{gradient[1] * 500e-9 / (2 * np.pi):.0f} samples"  # of the disc with its rim
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
        """Return the field behind the plate.

        Raises
        ------
        SamplingError, ValueError
            In the cases of `phase_plate`.
        """
        return self._multiplied(field, 1)

    def adjoint(self, field: Field) -> Field:
        """Return the field times the conjugate of the transmission."""
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
        """Return the gradient of a loss with respect to the coefficients.

        Parameters
        ----------
        field : Field
            Field in front of the plate, shape (..., ny, nx).
        cotangent : Field
            Gradient dL/dRe + i dL/dIm with respect to the field behind the plate, with the shape of
            ``field``.

        Returns
        -------
        dict
            Gradient "coefficients": index j to the gradient per metre.

        Raises
        ------
        ShapeError
            If the cotangent has another shape.
        """
        behind = self.apply(field)
        of_log = field.device.download(transmission_gradient(behind, cotangent))
        on_plate, rho, theta = plate_coordinates(field.grid, self.diameter, self.centre)
        of_phase = of_log.imag[on_plate].astype(np.float64)
        orders, k = (noll if self.indexing == "noll" else osa), 2 * math.pi / field.wavelength
        gradients = {
            j: k * float((of_phase * zernike(*orders(j), rho, theta)).sum())
            for j in self.coefficients
        }
        return {"coefficients": gradients}

    def describe(self) -> str:
        """Return the coefficients and the diameter."""
        terms = ", ".join(f"Z{j} {metres(c)}" for j, c in self.coefficients.items())
        return f"{terms}, D = {metres(self.diameter)}"
