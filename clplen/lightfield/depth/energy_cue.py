"""Cue of energy: disparity of the sharpest plane at every pixel.

The sharpness is the local energy of detail of refocused pictures (`LocalEnergy`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps, launch_stretches, whole_taps
from clplen.lightfield.depth.cue import (
    BATCH_PLANES,
    Cue,
    Map,
    PeakTracker,
    depth_memory,
    nearest_zero,
    require_maps,
)
from clplen.lightfield.model.alpha_law import view_shifts
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.refocusing.focal_stacks import FocalStack, MemoryEstimate, stack_on_planes

Vector = np.ndarray[Any, np.dtype[np.float64]]

PICTURES = 32  # maximum planes in one pass over the light field

_HIGH_PASS = 1.5  # pixels: standard deviation of the high-pass filter
_WINDOW = 4.0  # pixels: Gaussian over which the energy is averaged
_VARIANCE, _FOURTH = 1 / 4, 1 / 16  # moments, in pixels, of the mean of two neighbours
NO_TAPS = np.array([1.0, 0.0, 0.0])


def energy_disparity(source: LightField | FocalStack, planes: Vector) -> tuple[Map, Map]:
    """Return the disparity of the highest local energy of detail, with confidence, per pixel.

    E_d = G_w * (R_d - G_s * R_d)^2, summed over the colours, with R_d the refocused picture and
    Gaussians of s = 1.5 and w = 4 pixels; `evening_taps` first blurs all R_d equally.
    """
    device = source.device
    shape = source.shape[1:] if isinstance(source, FocalStack) else source.shape[2:]
    size = (shape[0], shape[1])
    pictures = 0 if isinstance(source, FocalStack) else _stored_pictures(planes.size)
    require_maps(source, BATCH_PLANES + BATCH_PLANES + 7, pictures)
    gather = Smoother(gaussian_taps(_WINDOW), device=device)
    measure = LocalEnergy(_HIGH_PASS, shape, device=device)
    tracker = PeakTracker(size, device=device, start=nearest_zero(planes), capacity=BATCH_PLANES)
    energies = device.empty((BATCH_PLANES, *size), np.float32)
    for stack, first, values in _focused(source, planes):
        measure(energies, stack, start=first, count=values.size)
        gather(tracker.curve, energies, start=tracker.stored, count=values.size)
        tracker.add(values)
    return tracker.finish()


def energy_memory(source: SampledViews, planes: Vector) -> MemoryEstimate:
    """Estimate the memory of `energy_disparity`; its windows reach `ENERGY_REACH` pixels."""
    channels = (*source.shape, 1)[4]
    return depth_memory(
        "energy",
        source,
        planes,
        reach=ENERGY_REACH,
        floats=energy_floats(planes.size, channels),
        largest=min(PICTURES, planes.size) * channels,
    )


def energy_floats(planes: int, channels: int) -> int:
    """Return the temporary float32 values a pixel: focal stacks, energies, curves, maps."""
    return _stored_pictures(planes) * channels + 2 * min(BATCH_PLANES, planes) + 9


def _stored_pictures(planes: int) -> int:
    """Return the number of stack pictures that coexist on the device: up to two batches."""
    return min(PICTURES, planes) * (1 + (planes > PICTURES))


def _focused(
    source: LightField | FocalStack, planes: Vector
) -> Iterator[tuple[FocalStack, int, Vector]]:
    """Yield (stack, first picture, disparities), refocused in batches."""
    if isinstance(source, FocalStack):
        for index in np.unique(source.disparities, return_index=True)[1]:
            yield source, int(index), source.disparities[index : index + 1]
        return
    for start in range(0, planes.size, PICTURES):
        part = planes[start : start + PICTURES]
        stack = stack_on_planes(source, part, source.alpha(part), source.weights)
        for first in range(0, stack.disparities.size, BATCH_PLANES):
            yield stack, first, stack.disparities[first : first + BATCH_PLANES]


def stack_taps(stack: FocalStack, planes: slice) -> Vector:
    """Return `evening_taps` for pictures of a focal stack.

    Views shifted by whole pixels keep all detail and others lose some, so the sharpness of a stack
    has false peaks at whole disparities. With these taps the loss is equal on every plane, for any
    spectrum of picture and noise.
    """
    disparities = stack.disparities[planes]
    if stack.weights is None:
        return np.broadcast_to(NO_TAPS, (disparities.size, 2, 3))
    shift = view_shifts(stack.spacing, stack.weights.shape, disparities, positions=stack.positions)
    shares = [stack.weights.sum(axis=1), stack.weights.sum(axis=0)]
    if stack.positions is not None:
        shares = [stack.weights, stack.weights]
    taps = [
        [evening_taps(shift, share) for shift, share in zip(pair, shares, strict=True)]
        for pair in zip(*shift, strict=True)
    ]
    return np.array(taps)


def evening_taps(shift: Vector, weights: np.ndarray[Any, Any]) -> Vector:
    """Return taps that complete the interpolation blur of one axis to that of half a pixel.

    A fraction f of a pixel mixes the samples f and 1 - f away with weights 1 - f and f: variance
    a = f (1 - f), fourth moment a (1 - 3 a). The taps bring the second and fourth moments of the
    mean over the views to those of f = 1/2 (for independent steps m2 + n2 and
    m4 + 6 m2 n2 + n4). For symmetric views the transfer functions of all shifts then agree up to
    the fifth power of the frequency.
    """
    part = shift - np.floor(shift)
    variances = part * (1 - part)
    total = weights.sum(dtype=np.float64)
    variance = (variances * weights).sum() / total
    fourth = (variances * (1 - 3 * variances) * weights).sum() / total
    n2 = _VARIANCE - variance
    n4 = _FOURTH - fourth - 6 * variance * n2
    second = (n4 - n2) / 24
    first = n2 / 2 - 4 * second
    return np.array([1 - 2 * (first + second), first, second])


class LocalEnergy:
    """Energy of the detail of focal stacks, (R - G * R)^2, with G a Gaussian.

    `evening_taps` first blurs every picture to the interpolation loss of half a pixel; both
    filters are one. Pictures are reflected at the edges.
    """

    def __init__(
        self, sigma: float, shape: tuple[int, ...], *, device: Device, luma: bool = False
    ) -> None:
        self._size = (*shape, 1)[:3]
        self._device = device
        self._low = gaussian_taps(sigma)
        self._cached: tuple[FocalStack, cla.Array, cla.Array] | None = None
        self._defines: dict[str, Any] = {"CHANNELS": self._size[2]}
        self._defines |= {"LUMA": True} if luma and self._size[2] == 3 else {}

    def __call__(self, out: cla.Array, stack: FocalStack, *, start: int, count: int) -> None:
        """Compute the energies of some pictures of a stack."""
        ny, nx, channels = self._size
        radius = self._low.size - 1 + NO_TAPS.size - 1
        launch_stretches(
            self._device,
            ("detail.cl", "detail_energy"),
            (count, ny, nx * channels),
            (
                out,
                stack.data,
                *self._tables(stack),
                *(np.int32(n) for n in (radius, start, ny, nx)),
            ),
            halos=((NO_TAPS.size - 1) * channels, radius * channels, 0),
            channels=channels,
            **self._defines,
        )

    def _tables(self, stack: FocalStack) -> tuple[cla.Array, cla.Array]:
        """Return both filters of every picture, cached for the last stack."""
        cached = self._cached
        if cached is None or cached[0] is not stack:
            even = stack_taps(stack, slice(None))
            low = np.array([[_convolved(taps, self._low) for taps in plane] for plane in even])
            tables = [self._device.upload(whole_taps(taps, self._device)) for taps in (even, low)]
            cached = self._cached = (stack, tables[0], tables[1])
        return cached[1:]


def reach_of(sigma: float) -> int:
    """Return the number of pixels on every side that `LocalEnergy` depends on."""
    return int(gaussian_taps(sigma).size + NO_TAPS.size - 2)


def _convolved(a: Vector, b: Vector) -> Vector:
    """Convolve two symmetric filters, each by its taps at distance 0, 1, ...."""
    first, second = (np.concatenate((taps[:0:-1], taps)) for taps in (a, b))
    taps_of_both = np.convolve(first, second)
    return np.asarray(taps_of_both[taps_of_both.size // 2 :])


# Pixels of the sheared views around a pixel that its energy depends on.
ENERGY_REACH = reach_of(_HIGH_PASS) + gaussian_taps(_WINDOW).size - 1
CUE = Cue(energy_disparity, energy_memory)
