"""The transfer function of free space on a device: its band, its phase route, its samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyopencl.array as cla

from clplen.wave.phase import phasor, split

if TYPE_CHECKING:
    from clplen.compute.device import Device

EVANESCENT_REACH = 3  # wavelengths; farther on evanescent waves are below 1e-4
LARGEST_TABLE_RESIDUAL = 1.0  # turns; above, float32 tables lose more than 1e-5


@dataclass(frozen=True)
class Transfer:
    """What determines H(fx, fy) on a padded window.

    Attributes
    ----------
    shape : tuple of int
        (Ly, Lx) of the padded window.
    pitch : tuple of float
        (dy, dx) in metres.
    z, wavelength : float
        In metres.
    band : tuple of float
        Largest abs(fy), abs(fx) kept, in cycles a metre; infinite for no limit.
    """

    shape: tuple[int, int]
    pitch: tuple[float, float]
    z: float
    wavelength: float
    band: tuple[float, float]

    def last_index(self, axis: int) -> int:
        """Largest frequency index of an axis inside the band."""
        n, d = self.shape[axis], self.pitch[axis]
        if math.isinf(self.band[axis]):
            return n // 2
        # |f| < limit strictly; f = k/(n d)
        return min(n // 2, math.ceil(self.band[axis] * n * d) - 1)

    def residual_turns(self) -> float:
        """Rt = (z/lam) q^2/2 with q = 1 - sqrt(1 - s) at the corner of the band."""
        s = sum(
            (self.wavelength * self.last_index(a) / (self.shape[a] * self.pitch[a])) ** 2
            for a in (0, 1)
        )
        s = min(s, 1.0)
        q = s / (1 + math.sqrt(1 - s))
        return abs(self.z) / self.wavelength * q * q / 2

    def phase_route(self, device: Device) -> str:
        """ "tables", "fp64" or "twofloat": how a device forms the phase to 1e-5 rad."""
        if device.precision == "double" or self.residual_turns() <= LARGEST_TABLE_RESIDUAL:
            return "tables"
        return "fp64" if device.has_fp64 else "twofloat"

    def on_device(self, device: Device, phase: str) -> cla.Array:
        """One quadrant of H, complex, shape (Ly//2 + 1, Lx//2 + 1).

        Parameters
        ----------
        device : Device
        phase : {"tables", "fp64", "twofloat"}
        """
        ny, nx = (n // 2 + 1 for n in self.shape)
        fy, fx = (
            np.arange(n // 2 + 1) / (n * d) for n, d in zip(self.shape, self.pitch, strict=True)
        )
        tables = [phasor(-self.wavelength * self.z * f**2 / 2, device.complex) for f in (fx, fy)]
        squares = [split((self.wavelength * f) ** 2, device.real) for f in (fx, fy)]
        distance = split(self.z / self.wavelength, device.real)
        carrier = phasor(np.array([-self.z / self.wavelength]), device.complex)
        H = device.empty((ny, nx), device.complex)
        defines = {f"PHASE_{phase.upper()}": True, **device.wave_defines()}
        kernel = device.kernel("transfer.cl", "transfer", **defines)
        device.launch_rows(
            kernel,
            (ny, nx),
            H,
            *(device.upload(t) for t in tables),
            *(device.upload(s) for s in squares),
            distance,
            carrier.view(device.real),
            np.int32(self.last_index(1)),
            np.int32(self.last_index(0)),
            np.int32(ny),
            np.int32(nx),
        )
        return H


def blas_band(
    shape: tuple[int, int], pitch: tuple[float, float], z: float, wavelength: float
) -> tuple[float, float]:
    """Band limit per axis, (fy, fx), of the band-limited angular spectrum.

    f_lim = 1/(lam sqrt((2 df z)^2 + 1)), df = 1/W with W the padded window: Matsushima and
    Shimobaba (2009), eq. 13. Infinite on an axis of length 1 and at z = 0.
    """
    limits = []
    for n, d in zip(shape, pitch, strict=True):
        df = 1 / (n * d)
        free = n == 1 or z == 0
        limits.append(math.inf if free else 1 / (wavelength * math.hypot(2 * df * z, 1)))
    return (limits[0], limits[1])


def fully_sampled_distance(n: int, d: float, wavelength: float) -> float:
    """Largest abs(z) at which H is sampled over the whole band of one axis, in metres.

    z tan(asin(lam f_nyq)) <= W/2: the steepest phase of H then changes by at most pi a sample. On
    samples below lam/2 grazing waves are never sampled, but up to three wavelengths evanescent
    waves, which a band limit would drop, matter more: there it is 3 lam.
    """
    sine = wavelength / (2 * d)
    if n == 1:
        return math.inf
    if sine >= 1:
        return EVANESCENT_REACH * wavelength
    return n * d / 2 * math.sqrt(1 - sine**2) / sine
