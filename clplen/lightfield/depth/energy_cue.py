"""The cue of energy: disparity of the sharpest plane at every pixel, and the measure of sharpness.

The measure is the local energy of detail of refocused pictures (`LocalEnergy`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps, launch_stretches, whole_taps
from clplen.lightfield.depth.cue import (
    AT_ONCE,
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

PICTURES = 32  # planes in one pass over the light field, at most

_HIGH_PASS = 1.5  # pixels: what a wider Gaussian leaves is no detail
_WINDOW = 4.0  # pixels: Gaussian over which the energy is gathered
_VARIANCE, _FOURTH = 1 / 4, 1 / 16  # moments, in pixels, of the mean of two neighbours
NO_TAPS = np.array([1.0, 0.0, 0.0])


def energy_disparity(source: LightField | FocalStack, planes: Vector) -> tuple[Map, Map]:
    """Disparity of the highest local energy of detail at every pixel, and how sure that is.

    E_d = G_w * (R_d - G_s * R_d)^2, summed over the colours, with R_d the refocused picture and
    Gaussians of s = 1.5 and w = 4 pixels, each R_d first blurred alike (`evening_taps`).
    """
    device = source.device
    shape = source.shape[1:] if isinstance(source, FocalStack) else source.shape[2:]
    size = (shape[0], shape[1])
    pictures = 0 if isinstance(source, FocalStack) else _pictures_held(planes.size)
    require_maps(source, AT_ONCE + AT_ONCE + 7, pictures)
    gather = Smoother(gaussian_taps(_WINDOW), device=device)
    measure = LocalEnergy(_HIGH_PASS, shape, device=device)
    tracker = PeakTracker(size, device=device, start=nearest_zero(planes), most=AT_ONCE)
    energies = device.empty((AT_ONCE, *size), np.float32)
    for stack, first, values in _focused(source, planes):
        measure(energies, stack, start=first, count=values.size)
        gather(tracker.curve, energies, start=tracker.held, count=values.size)
        tracker.add(values)
    return tracker.finish()


def energy_memory(source: SampledViews, planes: Vector) -> MemoryEstimate:
    """What `energy_disparity` needs; its windows reach `ENERGY_REACH` pixels."""
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
    """Temporary float32 values a pixel: focal stacks, energies, curves and maps."""
    return _pictures_held(planes) * channels + 2 * min(AT_ONCE, planes) + 9


def _pictures_held(planes: int) -> int:
    """Pictures of the focal stacks that are on the device at a time: two stacks, in turn."""
    return min(PICTURES, planes) * (1 + (planes > PICTURES))


def _focused(
    source: LightField | FocalStack, planes: Vector
) -> Iterator[tuple[FocalStack, int, Vector]]:
    """(stack, first picture, disparities), a few refocused at a time."""
    if isinstance(source, FocalStack):
        for index in np.unique(source.disparities, return_index=True)[1]:
            yield source, int(index), source.disparities[index : index + 1]
        return
    for start in range(0, planes.size, PICTURES):
        some = planes[start : start + PICTURES]
        stack = stack_on_planes(source, some, source.alpha(some), source.weights)
        for first in range(0, stack.disparities.size, AT_ONCE):
            yield stack, first, stack.disparities[first : first + AT_ONCE]


def stack_taps(stack: FocalStack, planes: slice) -> Vector:
    """`evening_taps` of pictures of a focal stack.

    Views moved by whole pixels keep all their detail and others lose some, so that the sharpness
    of a focal stack has false peaks at whole disparities. After these taps every plane has
    lost the same, whatever the spectrum of the picture and its noise.
    """
    disparities = stack.disparities[planes]
    if stack.weights is None:
        return np.broadcast_to(NO_TAPS, (disparities.size, 2, 3))
    shift = view_shifts(stack.spacing, stack.weights.shape, disparities, positions=stack.positions)
    shares = [stack.weights.sum(axis=1), stack.weights.sum(axis=0)]
    if stack.positions is not None:
        shares = [stack.weights, stack.weights]
    taps = [
        [evening_taps(shift, share) for shift, share in zip(both, shares, strict=True)]
        for both in zip(*shift, strict=True)
    ]
    return np.array(taps)


def evening_taps(shift: Vector, weights: np.ndarray[Any, Any]) -> Vector:
    """Taps that, after the views' interpolation along one axis, blur as half a pixel does.

    A fraction f of a pixel mixes the samples f and 1 - f away with weights 1 - f and f: variance
    a = f (1 - f), fourth moment a (1 - 3 a). The taps bring the second and fourth moments of the
    mean over the views to those of f = 1/2 (for independent steps m2 + n2 and
    m4 + 6 m2 n2 + n4), so that, for views that lie symmetrically, the transfer functions
    of all shifts agree up to the fifth power of the frequency.
    """
    part = shift - np.floor(shift)
    spread = part * (1 - part)
    total = weights.sum(dtype=np.float64)
    variance = (spread * weights).sum() / total
    fourth = (spread * (1 - 3 * spread) * weights).sum() / total
    n2 = _VARIANCE - variance
    n4 = _FOURTH - fourth - 6 * variance * n2
    second = (n4 - n2) / 24
    first = n2 / 2 - 4 * second
    return np.array([1 - 2 * (first + second), first, second])


class LocalEnergy:
    """Energy of what a Gaussian takes away from the pictures of focal stacks, (R - G * R)^2.

    Every picture is first blurred until it has lost as much to interpolation as by half a pixel
    (`evening_taps`), which costs nothing here: both filters are one. Beyond the edges pictures are
    reflected.
    """

    def __init__(
        self, sigma: float, shape: tuple[int, ...], *, device: Device, luma: bool = False
    ) -> None:
        self._size = (*shape, 1)[:3]
        self._device = device
        self._low = gaussian_taps(sigma)
        self._known: tuple[FocalStack, cla.Array, cla.Array] | None = None
        self._defines: dict[str, Any] = {"CHANNELS": self._size[2]}
        self._defines |= {"LUMA": True} if luma and self._size[2] == 3 else {}

    def __call__(self, out: cla.Array, stack: FocalStack, *, start: int, count: int) -> None:
        """Energies of some pictures of a stack."""
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
        """Both filters of every picture, kept until another stack comes."""
        known = self._known
        if known is None or known[0] is not stack:
            even = stack_taps(stack, slice(None))
            low = np.array([[_convolved(taps, self._low) for taps in plane] for plane in even])
            tables = [self._device.upload(whole_taps(one, self._device)) for one in (even, low)]
            known = self._known = (stack, tables[0], tables[1])
        return known[1:]


def reach_of(sigma: float) -> int:
    """Pixels on every side that `LocalEnergy` depends on."""
    return int(gaussian_taps(sigma).size + NO_TAPS.size - 2)


def _convolved(a: Vector, b: Vector) -> Vector:
    """Taps at distance 0, 1, ... of one symmetric filter after another."""
    first, second = (np.concatenate((taps[:0:-1], taps)) for taps in (a, b))
    both = np.convolve(first, second)
    return np.asarray(both[both.size // 2 :])


# Pixels of the sheared views that an energy depends on, on every side.
ENERGY_REACH = reach_of(_HIGH_PASS) + gaussian_taps(_WINDOW).size - 1
CUE = Cue(energy_disparity, energy_memory)
