"""The Rayleigh-Sommerfeld kernel in a smooth window: a spectrum without grazing singularity.

H has a branch point at the grazing frequency 1/lam. Its inverse transform falls off so slowly that
no computation window keeps aliases clear of the output. The kernel is therefore multiplied by a
window that is 1 at all displacements of the output and falls smoothly to 0 beyond. The product has
a smooth spectrum and, sampled at a step of 1 over the window's width, is exact at every output
point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum, multiply_tables, window
from clplen.compute.fft.lines import smooth_length
from clplen.wave.propagation.band import AxisSpan
from clplen.wave.propagation.transfer_function import (
    kernel_samples,
    multiply_kernel_slope,
    residual_turns,
)

Vector = np.ndarray[Any, Any]
Pair = tuple[float, float]

STEEPNESS = 5.0  # of the taper: 0.5 erfc(5) = 8e-13 at its ends, as for a guard of 8
MIN_EVANESCENT = 1e-12  # amplitude of the weakest evanescent waves that are included


@dataclass(frozen=True, eq=False)
class KernelAxis:
    """Axis of a windowed kernel."""

    # frequencies k/width, k = -(m//2) ..., float64, shape (m,), in cycles per metre
    frequencies: Vector
    # displacements of the kernel's samples in circular order, shape (L,), L >= m, in metres
    displacements: Vector
    taper: Vector  # window of these samples, shape (L,)
    width: float  # of the computation window, in metres
    is_constant: bool = False  # True if the field does not vary along the axis

    @property
    def farthest(self) -> float:
        """Largest abs(displacement) in metres."""
        return float(np.abs(self.displacements).max())


def _fall_and_highest(span: AxisSpan) -> tuple[float, float]:
    """Return the width of the taper in metres and the highest frequency; see `kernel_axis`."""
    full_width = span.lit + span.output
    product = 2 * STEEPNESS**2 / math.pi
    steepest = 1 / span.wavelength
    fall = math.sqrt(product * full_width / 2 / steepest)
    reach = abs(span.offset) + full_width / 2 + fall
    steepest = span.geometric(reach)
    if span.wavelength * steepest > 0.5:
        # All propagating waves, and evanescent ones above MIN_EVANESCENT: their amplitude is
        # exp(-2 pi z sqrt(f^2 - 1/lam^2)).
        decay = -math.log(MIN_EVANESCENT) / (2 * math.pi * abs(span.z))
        steepest = math.hypot(1 / span.wavelength, decay)
    return fall, steepest + product / fall


def kernel_length(span: AxisSpan) -> float:
    """Return the minimum number of the kernel's samples along an axis."""
    if span.n == 1:
        return 1.0
    fall, highest = _fall_and_highest(span)
    return 2 * highest * (span.lit + span.output + 2 * fall) + 1


def kernel_axis(span: AxisSpan, limit: float) -> KernelAxis:
    """Return the sampling of an axis.

    The window is 1 over the displacements of the output and falls as 0.5 erfc over a width T on
    either side. It smooths the spectrum over frequencies d with T d = 2 k^2/pi, k = `STEEPNESS`,
    for which exp(-(pi T d/(2 k))^2) = exp(-k^2). T and d minimise the cost (w + 2 T)(F + d) with
    the width w of the output and the highest frequency F.
    """
    if span.n == 1:
        zero = np.zeros(1)
        return KernelAxis(zero, zero, np.ones(1), 1.0, is_constant=True)
    full_width = span.lit + span.output
    fall, highest = _fall_and_highest(span)
    width = full_width + 2 * fall
    count = smooth_length(2 * math.ceil(highest * width) + 1)
    retained = (
        min(count, 2 * math.floor(limit * width * (1 + 1e-12)) + 1) if limit < highest else count
    )
    shifts = np.fft.fftfreq(count) * width
    t = (np.abs(shifts) - full_width / 2) / fall
    taper = np.array([0.5 * math.erfc((2 * s - 1) * STEEPNESS) if s > 0 else 1.0 for s in t])
    frequencies = (np.arange(retained) - retained // 2) / width
    return KernelAxis(frequencies, span.offset + shifts, taper, width)


@dataclass(frozen=True, eq=False)
class WindowedKernel:
    """Spectrum of the windowed Rayleigh-Sommerfeld kernel, dimensionless."""

    axes: tuple[KernelAxis, KernelAxis]  # (y, x)
    z: float  # in metres
    wavelength: float
    is_slope: bool = False  # True for the derivative by z in this window, per metre

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the spectrum: numbers of frequencies along y and x."""
        return (self.axes[0].frequencies.size, self.axes[1].frequencies.size)

    @property
    def stored(self) -> tuple[int, int]:
        """Shape of the computed samples."""
        return (self.axes[0].displacements.size, self.axes[1].displacements.size)

    @property
    def lit(self) -> None:
        """None, since all columns are used."""

    def residual_turns(self) -> float:
        """Return Rk = (r_max - z)^2/(2 z lam) at the farthest displacement."""
        return residual_turns(sum(axis.farthest**2 for axis in self.axes), self.z, self.wavelength)

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """Return the spectrum on a device, in rising frequencies."""
        y, x = self.axes
        pitch = (y.width / y.displacements.size, x.width / x.displacements.size)
        dy, dx = (None if axis.is_constant else axis.displacements for axis in self.axes)
        h = kernel_samples(dy, dx, pitch, self.z, self.wavelength, device, phase)
        if self.is_slope:
            multiply_kernel_slope(h, dy, dx, self.z, self.wavelength, device)
        multiply_tables(h, _risen(y), _risen(x), device)
        device.fft.forward(h, device)
        values = h if self.shape == self.stored else window(h, self.shape, device)
        return Spectrum(values, self.shape)

    def turned(self) -> WindowedKernel:
        """Return the kernel with x and y exchanged."""
        return replace(self, axes=self.axes[::-1])


def _risen(axis: KernelAxis) -> Vector:
    """Return the taper times the wave that shifts frequency 0 to sample L//2 of the transform."""
    count = axis.displacements.size
    turns = (np.arange(count) * (count // 2) % count) / count
    return axis.taper * np.exp(2j * np.pi * turns)
