"""Derivatives by the distance: of transfer functions, of sampled kernels, of Fresnel's factors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum, multiplied
from clplen.compute.fft.lines import Line, Separable
from clplen.types import Array
from clplen.wave.field.transmission import split

LARGEST_HANKEL = 1e8  # argument; above, two terms of the asymptotic series are exact in float64


def multiply_transfer_slope(
    H: cla.Array, frequencies: tuple[Array, Array], wavelength: float, device: Device
) -> None:
    """Transfer functions times the derivative of their logarithm by z, in place."""
    fy, fx = frequencies
    squares = [device.upload(split((wavelength * f) ** 2, device.real)) for f in (fx, fy)]
    kernel = device.kernel("transfer_slope.cl", "transfer_slope", **device.wave_defines())
    k = device.real.type(2 * np.pi / wavelength)
    device.launch_rows(kernel, H.shape, H, *squares, k, *(np.int32(n) for n in H.shape))


def multiply_kernel_slope(
    h: cla.Array, y: Array | None, x: Array | None, z: float, wavelength: float, device: Device
) -> None:
    """Samples of the Rayleigh-Sommerfeld I kernel times the derivative of their logarithm by z.

    Of h = z/(2 pi r^2) (1/r - ik) exp(ik(r - z)), in place; of line sources,
    h = (i k z/(2 r)) H1(k r) exp(-ikz).
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


def _hankel_ratio(x: Array) -> Array:
    """H0/H1 for x > 0: Abramowitz and Stegun 1964, 9.2.7, where SciPy gives up."""
    from scipy.special import hankel1e

    near = np.minimum(x, LARGEST_HANKEL)
    series = 1j * (1 - 0.5j / x)
    return np.where(x > LARGEST_HANKEL, series, hankel1e(0, near) / hankel1e(1, near))


def fresnel_slopes(
    into: Separable, pitch: tuple[float, float], wavelength: float
) -> list[Separable]:
    """The terms whose sum is the derivative of convolutions with exp(-i pi lam z f^2) by z."""
    terms = []
    for name, d in (("y", pitch[0]), ("x", pitch[1])):
        (line,) = getattr(into, name)
        if line.kind == "convolve":
            terms.append(replace(into, **{name: (_sloped(line, d, wavelength),)}))
    return terms


def _sloped(line: Line, d: float, wavelength: float) -> Line:
    f = np.fft.fftfreq(line.length, d)
    assert line.kernel is not None
    return replace(line, kernel=line.kernel * (-1j * np.pi * wavelength * f**2))
