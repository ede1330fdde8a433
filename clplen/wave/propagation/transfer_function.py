"""Factors of a 2-D spectrum on a device: the transfer function of free space, and that of its
sampled impulse response."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from clplen.compute.blocks import Spectrum, lanes_defines, window
from clplen.wave.field.phase_tables import phasor, split
from clplen.wave.propagation import sommerfeld

if TYPE_CHECKING:
    from clplen.compute.device import Device

Vector = np.ndarray[Any, Any]
Pair = tuple[float, float]

LARGEST_TABLE_RESIDUAL = 1.0  # turns; above, float32 tables lose more than 1e-5


class Factor(Protocol):
    """What a spectrum is multiplied by, before it is on a device."""

    def residual_turns(self) -> float:
        """Phase left to the device's precision beside 1-D tables made in double."""

    def phase_route(self, device: Device) -> str:
        """ "tables", "fp64" or "twofloat": how a device forms the phase."""

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """The samples, the phase formed as said."""

    def turned(self) -> Factor:
        """The same with x and y exchanged."""

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the spectrum."""

    @property
    def stored(self) -> tuple[int, int]:
        """Shape of the samples that are made."""

    @property
    def lit(self) -> Vector | None:
        """Which columns of those samples are not all zero, bool; None: all of them."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """H(fx, fy) = exp(i k z (sqrt(1 - s) - 1)), s = lam^2 (fx^2 + fy^2), times 1-D weights.

    Goodman (2005), eq. 3-66, without the carrier exp(ikz).

    Attributes
    ----------
    shape : tuple of int
        (my, mx) of the spectrum.
    frequencies, weights : tuple of numpy.ndarray
        Along y and x, float64, in cycles a metre: all of them, or of an FFT's those up to the
        middle, (my//2 + 1,) and (mx//2 + 1,), where H is even.
    z, wavelength : float
        In metres.
    """

    shape: tuple[int, int]
    frequencies: tuple[Vector, Vector]
    weights: tuple[Vector, Vector]
    z: float
    wavelength: float

    @property
    def stored(self) -> tuple[int, int]:
        """Shape of the samples that are made."""
        return (self.frequencies[0].size, self.frequencies[1].size)

    @property
    def lit(self) -> Vector | None:
        """Which columns of those samples are inside the band, bool; None: all of them."""
        lit = self.weights[1] != 0
        return None if lit.all() else lit

    def highest(self) -> Pair:
        """Largest abs(fy), abs(fx) of any weight, in cycles a metre."""
        y, x = (
            float(np.abs(f[w > 0]).max(initial=0.0))
            for f, w in zip(self.frequencies, self.weights, strict=True)
        )
        return (y, x)

    def _corner(self) -> float:
        """s at the corner of the band."""
        return sum((self.wavelength * f) ** 2 for f in self.highest())

    def residual_turns(self) -> float:
        """Rt = (z/lam) q^2/2 with q = 1 - sqrt(1 - s) at the corner of the band."""
        s = min(self._corner(), 1.0)
        q = s / (1 + math.sqrt(1 - s))
        return abs(self.z) / self.wavelength * q * q / 2

    def phase_route(self, device: Device) -> str:
        """ "tables", "fp64" or "twofloat": how a device forms the phase to 1e-5 rad.

        Less only at s = 1 within 1e-3, where waves graze.
        """
        if device.precision == "double" or self.residual_turns() <= LARGEST_TABLE_RESIDUAL:
            return "tables"
        return "fp64" if device.has_fp64 else "twofloat"

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """The samples on a device.

        Parameters
        ----------
        device : Device
        phase : {"tables", "fp64", "twofloat"}
        """
        (fy, fx), (wy, wx) = self.frequencies, self.weights
        tables = [phasor(-self.wavelength * self.z * f**2 / 2, device.complex) for f in (fx, fy)]
        squares = [split((self.wavelength * f) ** 2, device.real) for f in (fx, fy)]
        carrier = phasor(np.array([-self.z / self.wavelength]), device.complex)
        H = device.empty(self.stored, device.complex)
        smooth = phase == "tables" and self._corner() < 1
        defines = lanes_defines(device) if smooth else device.wave_defines()
        defines[f"PHASE_{phase.upper()}"] = True
        device.launch_rows(
            device.kernel("transfer.cl", "transfer", **defines),
            self.stored,
            H,
            *(device.upload(t) for t in tables),
            *(device.upload(s) for s in squares),
            *(device.upload(w.astype(device.real)) for w in (wx, wy)),
            split(self.z / self.wavelength, device.real),
            carrier.view(device.real),
            *(np.int32(n) for n in self.stored),
        )
        return Spectrum(H, self.shape)

    def turned(self) -> Transfer:
        """The same with x and y exchanged."""
        return replace(
            self,
            shape=self.shape[::-1],
            frequencies=self.frequencies[::-1],
            weights=self.weights[::-1],
        )


@dataclass(frozen=True, eq=False)
class Sommerfeld:
    """The DFT of the sampled Rayleigh-Sommerfeld kernel: see sommerfeld.py.

    Attributes
    ----------
    shape : tuple of int
        (my, mx) of the window.
    pitch : tuple of float
        (dy, dx) in metres.
    z, wavelength : float
        In metres.
    """

    shape: tuple[int, int]
    pitch: Pair
    z: float
    wavelength: float

    @property
    def stored(self) -> tuple[int, int]:
        """Shape of the samples that are kept: one quadrant."""
        return (self.shape[0] // 2 + 1, self.shape[1] // 2 + 1)

    @property
    def lit(self) -> None:
        """All columns."""

    def residual_turns(self) -> float:
        """Rk = (r_max - z)^2/(2 z lam) at the corner displacement."""
        return sommerfeld.kernel_residual_turns(self.shape, self.pitch, self.z, self.wavelength)

    def phase_route(self, device: Device) -> str:
        """ "tables", "fp64" or "twofloat": how a device forms the phase to 2.5e-5 rad."""
        return sommerfeld.kernel_phase_route(self.shape, self.pitch, self.z, self.wavelength, device)

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """The transform of the kernel's samples on a device.

        Parameters
        ----------
        device : Device
        phase : {"tables", "fp64", "twofloat"}
        """
        h = sommerfeld.impulse_response(
            self.shape, self.pitch, self.z, self.wavelength, device, phase
        )
        device.fft.forward(h, device)
        return Spectrum(window(h, self.stored, device, place=(0, 0)), self.shape)

    def turned(self) -> Sommerfeld:
        """The same with x and y exchanged."""
        return replace(self, shape=self.shape[::-1], pitch=self.pitch[::-1])


def made_for(factor: Factor, device: Device, phase: str) -> Spectrum:
    """A factor's samples in the order in which `run` of blocks.py reads them on a device.

    Parameters
    ----------
    factor : Factor
    device : Device
    phase : {"tables", "fp64", "twofloat"}
    """
    if device.fft.name == "vkfft":
        return factor.on_device(device, phase)
    values = factor.turned().on_device(device, phase).values
    return Spectrum(values, factor.shape, turned=True, lit=factor.lit)


def fft_frequencies(n: int, d: float) -> Vector:
    """Frequencies 0 ... n//2 of an FFT of n samples of pitch d, in cycles a metre."""
    return np.arange(n // 2 + 1) / (n * d)
