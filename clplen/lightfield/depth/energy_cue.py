"""The cue of sharpness: disparity of the sharpest plane at every pixel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.arrays.peaks import Map, PeakTracker
from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth.local_energy import LocalEnergy, reach_of
from clplen.lightfield.refocus.focal_stack import FocalStack, focal_stack

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField

Vector = np.ndarray[Any, np.dtype[np.float64]]

AT_ONCE = 8  # planes whose curve is held at a time
PICTURES = 32  # planes in one pass over the light field, at most

_HIGH_PASS = 1.5  # pixels: what a wider Gaussian leaves is no detail
_WINDOW = 4.0  # pixels: Gaussian over which the energy is gathered
REACH = reach_of(_HIGH_PASS) + gaussian_taps(_WINDOW).size - 1  # pixels that one depends on


def energy_disparity(source: LightField | FocalStack, planes: Vector) -> tuple[Map, Map]:
    """Disparity of the highest local energy of detail at every pixel, and how sure that is.

    E_d = G_w * (R_d - G_s * R_d)^2, the squares added over the colours, with R_d the picture
    refocused on disparity d and G Gaussians of s = 1.5 and w = 4 pixels: by Parseval the windowed
    spectral energy above a cut-off. First every R_d is blurred until it has lost as much to
    interpolation as a shift of half a pixel loses (`evening_taps`), or else whole disparities
    would be preferred. The peak is refined by the parabola through the highest plane and its two
    neighbours.

    Parameters
    ----------
    source : LightField or FocalStack
    planes : numpy.ndarray
        Disparities, rising, at least three; those of a stack are its own.

    Returns
    -------
    tuple of numpy.ndarray
        (disparity, confidence), float32, shape (y, x).

    Raises
    ------
    DeviceError
        If what is needed is larger than the device's memory.
    """
    device = source.device
    shape = source.shape[1:] if isinstance(source, FocalStack) else source.shape[2:]
    size = (shape[0], shape[1])
    pictures = min(PICTURES, planes.size) * (1 + (planes.size > PICTURES))  # two stacks, in turn
    pictures = 0 if isinstance(source, FocalStack) else pictures
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


def nearest_zero(planes: Vector) -> float:
    """The plane nearest to the focus as recorded: what is found where nothing can be."""
    return float(planes[np.argmin(np.abs(planes))])


def require_maps(source: LightField | FocalStack, maps: int, pictures: int) -> None:
    """Refuse more float32 maps (y, x) and pictures (y, x[, c]) than the device's memory holds."""
    before = 1 if isinstance(source, FocalStack) else 2
    ny, nx, colours = (*source.shape[before:], 1)[:3]
    nbytes = 4 * ny * nx * (maps + pictures * colours) + source.data.nbytes
    source.device.require_memory(nbytes, "This depth map with its source")


def _focused(
    source: LightField | FocalStack, planes: Vector
) -> Iterator[tuple[FocalStack, int, Vector]]:
    """(stack, first picture, disparities), a few refocused at a time."""
    if isinstance(source, FocalStack):
        for index in np.unique(source.disparities, return_index=True)[1]:
            yield source, int(index), source.disparities[index : index + 1]
        return
    for start in range(0, planes.size, PICTURES):
        stack = focal_stack(source, disparities=planes[start : start + PICTURES])
        for first in range(0, stack.disparities.size, AT_ONCE):
            yield stack, first, stack.disparities[first : first + AT_ONCE]
