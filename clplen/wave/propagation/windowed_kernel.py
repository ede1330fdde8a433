"""The Rayleigh-Sommerfeld kernel in a smooth window: a spectrum without grazing singularity.

H has a branch point at the grazing frequency 1/lam, so that its inverse transform falls off slowly
and no computation window keeps aliases clear of the output. The kernel times a window that is 1
wherever the output needs it and falls smoothly to 0 beyond has a smooth spectrum: sampled at a step
of one over the window's width it is exact at every output point.
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
LEFT = 1e-12  # of evanescent waves, beyond which they are left out


@dataclass(frozen=True, eq=False)
class KernelAxis:
    """One axis of a windowed kernel."""

    # of the spectrum, k/width for k = -(m//2) ..., float64, shape (m,), in cycles a metre
    frequencies: Vector
    # of the kernel's samples in circular order, shape (L,), L >= m, in metres
    displacements: Vector
    taper: Vector  # window of these samples, shape (L,)
    width: float  # of the computation window, in metres
    is_still: bool = False  # whether nothing varies along the axis

    @property
    def farthest(self) -> float:
        """Largest abs(displacement) in metres."""
        return float(np.abs(self.displacements).max())


def _fall_and_highest(span: AxisSpan) -> tuple[float, float]:
    """Width of the taper on either side in metres, highest frequency: see `kernel_axis`."""
    wanted = span.lit + span.wanted
    product = 2 * STEEPNESS**2 / math.pi
    steepest = 1 / span.wavelength
    fall = math.sqrt(product * wanted / 2 / steepest)
    reach = abs(span.offset) + wanted / 2 + fall
    steepest = span.geometric(reach)
    if span.wavelength * steepest > 0.5:
        # All that propagates, and evanescent waves while exp(-2 pi z sqrt(f^2 - 1/lam^2)) > LEFT.
        steepest = math.hypot(1 / span.wavelength, -math.log(LEFT) / (2 * math.pi * abs(span.z)))
    return fall, steepest + product / fall


def kernel_length(span: AxisSpan) -> float:
    """Least number of the kernel's samples along an axis, before any are made."""
    if span.n == 1:
        return 1.0
    fall, highest = _fall_and_highest(span)
    return 2 * highest * (span.lit + span.wanted + 2 * fall) + 1


def kernel_axis(span: AxisSpan, limit: float) -> KernelAxis:
    """How one axis is sampled.

    The window is 1 over the displacements that are wanted and falls by 0.5 erfc over a width T on
    either side. That smooths the spectrum over frequencies d with T d = 2 k^2/pi, k = `STEEPNESS`,
    where exp(-(pi T d/(2 k))^2) = exp(-k^2). T and d share the cost evenly: (w + 2 T)(F + d), w the
    width that is wanted, F the highest frequency.
    """
    if span.n == 1:
        still = np.zeros(1)
        return KernelAxis(still, still, np.ones(1), 1.0, is_still=True)
    wanted = span.lit + span.wanted
    fall, highest = _fall_and_highest(span)
    width = wanted + 2 * fall
    count = smooth_length(2 * math.ceil(highest * width) + 1)
    kept = min(count, 2 * math.floor(limit * width * (1 + 1e-12)) + 1) if limit < highest else count
    away = np.fft.fftfreq(count) * width
    t = (np.abs(away) - wanted / 2) / fall
    taper = np.array([0.5 * math.erfc((2 * one - 1) * STEEPNESS) if one > 0 else 1.0 for one in t])
    frequencies = (np.arange(kept) - kept // 2) / width
    return KernelAxis(frequencies, span.offset + away, taper, width)


@dataclass(frozen=True, eq=False)
class WindowedKernel:
    """The spectrum of the windowed Rayleigh-Sommerfeld kernel, dimensionless."""

    axes: tuple[KernelAxis, KernelAxis]  # (y, x)
    z: float  # in metres
    wavelength: float
    is_slope: bool = False  # whether it is the derivative by z in this window, per metre

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the spectrum: frequencies along y and x."""
        return (self.axes[0].frequencies.size, self.axes[1].frequencies.size)

    @property
    def stored(self) -> tuple[int, int]:
        """Shape of the samples that are made."""
        return (self.axes[0].displacements.size, self.axes[1].displacements.size)

    @property
    def lit(self) -> None:
        """All columns."""

    def residual_turns(self) -> float:
        """Rk = (r_max - z)^2/(2 z lam) at the farthest displacement."""
        return residual_turns(sum(axis.farthest**2 for axis in self.axes), self.z, self.wavelength)

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """The spectrum on a device, rising frequencies."""
        y, x = self.axes
        pitch = (y.width / y.displacements.size, x.width / x.displacements.size)
        dy, dx = (None if axis.is_still else axis.displacements for axis in self.axes)
        h = kernel_samples(dy, dx, pitch, self.z, self.wavelength, device, phase)
        if self.is_slope:
            multiply_kernel_slope(h, dy, dx, self.z, self.wavelength, device)
        multiply_tables(h, _risen(y), _risen(x), device)
        device.fft.forward(h, device)
        values = h if self.shape == self.stored else window(h, self.shape, device)
        return Spectrum(values, self.shape)

    def turned(self) -> WindowedKernel:
        """The same with x and y exchanged."""
        return replace(self, axes=self.axes[::-1])


def _risen(axis: KernelAxis) -> Vector:
    """The taper times the wave that puts frequency 0 on sample L//2 of the transform."""
    count = axis.displacements.size
    turns = (np.arange(count) * (count // 2) % count) / count
    return axis.taper * np.exp(2j * np.pi * turns)
