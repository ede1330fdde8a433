"""Factors of a 2-D spectrum on a device: transfer functions and sampled impulse responses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.checks import fits_float64
from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum, lanes_defines, multiplied, window
from clplen.wave.field.transmission import phasor, split

Shape = tuple[int, int]
Pair = tuple[float, float]
Vector = np.ndarray[Any, Any]

LARGEST_HANKEL = 1e8  # argument above which two asymptotic terms are exact in float64


def kernel_residual_turns(shape: Shape, pitch: Pair, z: float, wavelength: float) -> float:
    """Return Rk = (r_max - z)^2/(2 z lam), with r_max at the corner displacement of a window.

    It is the phase that tables of rho^2/(2 lam z) leave to the kernel, for abs(z) > 0.
    """
    rho2 = sum((n // 2 * d) ** 2 for n, d in zip(shape, pitch, strict=True))
    return residual_turns(rho2, z, wavelength)


def residual_turns(rho2: float, z: float, wavelength: float) -> float:
    """Return (r - z)^2/(2 z lam) at a squared displacement in square metres."""
    excess = rho2 / (math.sqrt(rho2 + z * z) + abs(z))
    return excess * excess / (2 * abs(z) * wavelength)


def impulse_response(
    shape: Shape,
    pitch: Pair,
    z: float,
    wavelength: float,
    device: Device,
    phase: str,
    *,
    slope: bool = False,
) -> cla.Array:
    """Return samples of the Rayleigh-Sommerfeld I kernel times the sample area, in circular order.

    It is h(x, y) dx dy with h = z/(2 pi r^2) (1/r - ik) exp(ik(r - z)) (Goodman 2005, eq. 3-43),
    without the carrier exp(ikz). An axis of length 1 has line sources:
    h = (i k z/(2 r)) H1(k r) exp(-ikz), H1 the Hankel function of the first kind and order 1.

    Notes
    -----
    The samples are aliased unless sin(theta)/lam at the largest displacement X of an axis is below
    its Nyquist frequency, with tan(theta) = X/abs(z).
    """
    _check(z, device, phase)
    if 1 in shape:
        line = _line_response(shape, pitch, abs(z), wavelength)
        samples = device.upload((line if z > 0 else line.conj()).astype(device.complex))
        if slope:
            y, x = (
                None if n == 1 else np.fft.fftfreq(n) * n * d
                for n, d in zip(shape, pitch, strict=True)
            )
            multiply_kernel_slope(samples, y, x, z, wavelength, device)
        return samples
    y, x = (np.arange(n // 2 + 1) * d for n, d in zip(shape, pitch, strict=True))
    quadrant = kernel_samples(y, x, pitch, z, wavelength, device, phase)
    if slope:
        multiply_kernel_slope(quadrant, y, x, z, wavelength, device)
    h = device.empty(shape, device.complex)
    kernel = device.kernel("sommerfeld.cl", "unfold", **_defines(device, phase))
    device.launch_rows(kernel, shape, h, quadrant, *shape)
    return h


def kernel_samples(
    y: Vector | None,
    x: Vector | None,
    pitch: Pair,
    z: float,
    wavelength: float,
    device: Device,
    phase: str,
) -> cla.Array:
    """Return h at any displacements, times the sample area; see `impulse_response`."""
    if y is None or x is None:
        line = line_samples(y, x, pitch, abs(z), wavelength)
        return device.upload((line if z > 0 else line.conj()).astype(device.complex))
    far = abs(z)
    tables = [phasor(v**2 / (2 * wavelength * far), device.complex) for v in (x, y)]
    squares = [split((v / far) ** 2, device.real) for v in (x, y)]
    h = device.empty((len(y), len(x)), device.complex)
    kernel = device.kernel("sommerfeld.cl", "sommerfeld", **_defines(device, phase))
    device.launch_rows(
        kernel,
        h.shape,
        h,
        *(device.upload(t) for t in tables),
        *(device.upload(s) for s in squares),
        split(far / wavelength, device.real),
        device.real.type(pitch[0] * pitch[1] / (wavelength * far)),
        device.real.type(math.copysign(1, z)),
        *h.shape,
    )
    return h


def _line_response(shape: Shape, pitch: Pair, z: float, wavelength: float) -> Vector:
    """Return h of line sources for z > 0 times the pitch of the other axis, complex128."""
    y, x = (
        None if n == 1 else np.arange(n // 2 + 1) * d for n, d in zip(shape, pitch, strict=True)
    )
    half = line_samples(y, x, pitch, z, wavelength).ravel()
    index = np.arange(max(shape))
    return half[np.minimum(index, index.size - index)].reshape(shape)


def line_samples(
    y: Vector | None, x: Vector | None, pitch: Pair, z: float, wavelength: float
) -> Vector:
    """Return h of line sources for z > 0 at displacements along an axis, complex128, (my, mx)."""
    if y is None and x is None:
        return np.ones((1, 1), complex)
    rho, d = (x, pitch[1]) if y is None else (y, pitch[0])
    assert rho is not None
    r = np.sqrt(rho**2 + z * z)
    k = 2 * np.pi / wavelength
    excess = phasor(rho**2 / (r + z) / wavelength, np.dtype(complex))
    h = 0.5j * k * z / r * _hankel(k * r) * excess * d
    return h[None] if y is None else h[:, None]


def _hankel(x: Vector) -> Vector:
    """Return H1(x) exp(-ix) for x > 0; above SciPy's range Abramowitz and Stegun 1964, 9.2.7."""
    series = np.sqrt(2 / (np.pi * x)) * np.exp(-0.75j * np.pi) * (1 + 0.375j / x)
    from scipy.special import hankel1e

    return np.where(x > LARGEST_HANKEL, series, hankel1e(1, np.minimum(x, LARGEST_HANKEL)))


def multiply_kernel_slope(
    h: cla.Array, y: Vector | None, x: Vector | None, z: float, wavelength: float, device: Device
) -> None:
    """Multiply samples of the Rayleigh-Sommerfeld I kernel in place by d(log h)/dz.

    h = z/(2 pi r^2) (1/r - ik) exp(ik(r - z)), or (i k z/(2 r)) H1(k r) exp(-ikz) for line sources.
    """
    far, k = abs(z), 2 * np.pi / wavelength
    rho2 = sum(
        (v**2).reshape((-1, 1) if axis == 0 else (1, -1))
        for axis, v in enumerate((y, x))
        if v is not None
    )
    r = np.sqrt(rho2 + far * far)
    turning = -1j * k * rho2 / (r * (r + far))  # i k (z/r - 1)
    if y is None or x is None:
        slope = 1 / far - 2 * far / r**2 + k * far / r * _hankel_ratio(k * r) - 1j * k
    else:
        slope = 1 / far - 2 * far / r**2 - far / (r**3 * (1 / r - 1j * k)) + turning
    slope = slope if z > 0 else -slope.conj()
    factors = device.upload(np.ascontiguousarray(slope, device.complex))
    multiplied(h, Spectrum(factors, (int(h.shape[0]), int(h.shape[1]))), device, copy=False)


def _hankel_ratio(x: Vector) -> Vector:
    """Return H0/H1 for x > 0; above SciPy's range Abramowitz and Stegun 1964, 9.2.7."""
    from scipy.special import hankel1e

    near = np.minimum(x, LARGEST_HANKEL)
    series = 1j * (1 - 0.5j / x)
    return np.where(x > LARGEST_HANKEL, series, hankel1e(0, near) / hankel1e(1, near))


def _defines(device: Device, phase: str) -> dict[str, Any]:
    return {f"PHASE_{phase.upper()}": True, **device.wave_defines()}


def _check(z: float, device: Device, phase: str) -> None:
    if not (fits_float64(z) and z != 0):
        raise ValueError(f"z must be finite and not 0 for the impulse response, got {z!r}.")
    routes = ["tables"]
    if device.precision == "single":
        routes += ["fp64", "twofloat"] if device.has_fp64 else ["twofloat"]
    if phase not in routes:
        raise ValueError(
            f"There is no phase route {phase!r} on {device.name} in {device.precision} precision; "
            f"use one of {', '.join(routes)}."
        )


class Factor(Protocol):
    """Factor of a spectrum, independent of a device."""

    def residual_turns(self) -> float:
        """Return the phase that 1-D tables in double precision leave to the kernel."""

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """Return the samples, with the phase computed by a route."""

    def turned(self) -> Factor:
        """Return the factor with x and y exchanged."""

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the spectrum."""

    @property
    def stored(self) -> tuple[int, int]:
        """Shape of the computed samples."""

    @property
    def lit(self) -> Vector | None:
        """Mask of columns that are not all zero, bool; None: all columns."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """Transfer function H = exp(i k z (sqrt(1 - s) - 1)), s = lam^2 (fx^2 + fy^2), times weights.

    Goodman (2005), eq. 3-66, without the carrier exp(ikz).
    """

    shape: tuple[int, int]  # (my, mx) of the spectrum
    # frequencies along y and x, float64, in cycles per metre: all, or for an even H those of an
    # FFT up to the middle, (my//2 + 1,) and (mx//2 + 1,)
    frequencies: tuple[Vector, Vector]
    weights: tuple[Vector, Vector]
    z: float  # in metres
    wavelength: float
    # True for the derivative by z at these frequencies and weights, per metre
    is_slope: bool = False

    @property
    def stored(self) -> tuple[int, int]:
        """Shape of the computed samples."""
        return (self.frequencies[0].size, self.frequencies[1].size)

    @property
    def lit(self) -> Vector | None:
        """Mask of columns inside the band, bool; None: all columns."""
        lit = self.weights[1] != 0
        return None if lit.all() else lit

    def highest(self) -> Pair:
        """Return the largest abs(fy), abs(fx) with a weight, in cycles per metre."""
        y, x = (
            float(np.abs(f[w > 0]).max(initial=0.0))
            for f, w in zip(self.frequencies, self.weights, strict=True)
        )
        return (y, x)

    def _corner(self) -> float:
        """Return s at the corner of the band."""
        return sum((self.wavelength * f) ** 2 for f in self.highest())

    def residual_turns(self) -> float:
        """Return Rt = (z/lam) q^2/2 with q = 1 - sqrt(1 - s) at the corner of the band."""
        s = min(self._corner(), 1.0)
        q = s / (1 + math.sqrt(1 - s))
        return abs(self.z) / self.wavelength * q * q / 2

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """Return the samples on a device."""
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
            *self.stored,
        )
        if self.is_slope:
            multiply_transfer_slope(H, self.frequencies, self.wavelength, device)
        return Spectrum(H, self.shape)

    def turned(self) -> Transfer:
        """Return the transfer function with x and y exchanged."""
        return replace(
            self,
            shape=self.shape[::-1],
            frequencies=self.frequencies[::-1],
            weights=self.weights[::-1],
        )


def multiply_transfer_slope(
    H: cla.Array, frequencies: tuple[Vector, Vector], wavelength: float, device: Device
) -> None:
    """Multiply transfer functions in place by d(log H)/dz."""
    fy, fx = frequencies
    squares = [device.upload(split((wavelength * f) ** 2, device.real)) for f in (fx, fy)]
    kernel = device.kernel("transfer_slope.cl", "transfer_slope", **device.wave_defines())
    k = device.real.type(2 * np.pi / wavelength)
    device.launch_rows(kernel, H.shape, H, *squares, k, *H.shape)


@dataclass(frozen=True, eq=False)
class Sommerfeld:
    """DFT of the sampled Rayleigh-Sommerfeld kernel; see sommerfeld.cl."""

    shape: tuple[int, int]  # (my, mx) of the window
    pitch: Pair  # (dy, dx) in metres
    z: float  # in metres
    wavelength: float
    is_slope: bool = False  # True for the derivative by z, per metre

    @property
    def stored(self) -> tuple[int, int]:
        """Shape of the stored quadrant."""
        return (self.shape[0] // 2 + 1, self.shape[1] // 2 + 1)

    @property
    def lit(self) -> None:
        """None, since all columns are used."""

    def residual_turns(self) -> float:
        """Return Rk = (r_max - z)^2/(2 z lam) at the corner displacement."""
        return kernel_residual_turns(self.shape, self.pitch, self.z, self.wavelength)

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """Return the transform of the kernel's samples on a device."""
        h = impulse_response(
            self.shape, self.pitch, self.z, self.wavelength, device, phase, slope=self.is_slope
        )
        device.fft.forward(h, device)
        return Spectrum(window(h, self.stored, device, offset=(0, 0)), self.shape)

    def turned(self) -> Sommerfeld:
        """Return the factor with x and y exchanged."""
        return replace(self, shape=self.shape[::-1], pitch=self.pitch[::-1])


def factor_on_device(factor: Factor, device: Device, phase: str) -> Spectrum:
    """Return a factor's samples on a device in the order of `run` of blocks.py."""
    if device.fft.name == "vkfft":
        return factor.on_device(device, phase)
    values = factor.turned().on_device(device, phase).values
    return Spectrum(values, factor.shape, turned=True, lit=factor.lit)


def fft_frequencies(n: int, d: float) -> Vector:
    """Return frequencies 0 ... n//2 of an FFT of n samples of pitch d, in cycles per metre."""
    return np.arange(n // 2 + 1) / (n * d)
