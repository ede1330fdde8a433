"""Colours of a raw lenslet image behind a Bayer mosaic."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.calibration.sensor_frames import Frame, colour_places
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.raw_image import LensletGrid, RawImage

if TYPE_CHECKING:
    from clplen.compute.device import Device

COLOURS = "RGB"
_LEAST = 1e-5  # of the white level: less than any view has that a lenslet lights


def views_of_colours(
    picture: Frame, white: Frame, grid: LensletGrid, bayer: str, *, device: Device
) -> cla.Array:
    """Slice each colour by itself, then fill what it misses from the same view.

    A view holds, at every lenslet, the colour of the pixel that it hits. Its other colours come
    from the same view of the neighbouring lenslets, so that directions are not mixed; where those
    miss the colour too (lenslets a whole, even number of pixels apart), from the nearest pixels of
    that colour under the lenslet.

    Parameters
    ----------
    picture : numpy.ndarray
        Raw pixels, float32, shape (ny, nx).
    white : numpy.ndarray
        What every pixel would be in even light, positive; ones to keep the vignetting.
    grid : LensletGrid
    bayer : str
    device : Device

    Returns
    -------
    pyopencl.array.Array
        float32, shape (V, U, y, x, 3): ``picture`` over ``white``.
    """
    shape = grid.shape
    out = device.empty((*shape, 3), np.float32)
    for channel, colour in enumerate(COLOURS):
        places = [place for place, found in colour_places(bayer) if found == colour]
        parts = []
        for frame in (picture, white):
            alone = np.zeros_like(frame)
            for y, x in places:
                alone[y::2, x::2] = frame[y::2, x::2]
            slices = [_sliced_linear(alone, grid, device)]
            for y, x in (places[0], places[-1]):
                own = np.ascontiguousarray(frame[y::2, x::2])
                slices.append(_sliced_linear(own, _halved(grid, y, x), device))
            parts.append(slices)
        (raw, *near), (flat, *near_flat) = parts
        device.launch_rows(
            device.kernel("devignette.cl", "colours"),
            (shape[0] * shape[1], *shape[2:]),
            out,
            *(raw, flat, *near, *near_flat),
            np.float32(_LEAST),
            *(np.int32(n) for n in (*shape[2:], channel)),
        )
    return out


def _sliced_linear(frame: Frame, grid: LensletGrid, device: Device) -> cla.Array:
    raw = RawImage(device.upload(frame), device, float("nan"), grid, grid)
    return resample(raw, grid, linear=True)


def _halved(grid: LensletGrid, y: int, x: int) -> LensletGrid:
    """The same places among every second pixel, those from (y, x) on."""

    def half(step: tuple[float, float]) -> tuple[float, float]:
        return step[0] / 2, step[1] / 2

    return replace(
        grid,
        first=((grid.first[0] - y) / 2, (grid.first[1] - x) / 2),
        row_step=half(grid.row_step),
        column_step=half(grid.column_step),
        row_view_step=half(grid.row_view_step),
        column_view_step=half(grid.column_view_step),
    )


def bilinear_colours(picture: Frame, bayer: str) -> list[Frame]:
    """Red, green and blue at every pixel, bilinear: each (ny, nx), float32."""
    from scipy.ndimage import convolve1d

    weights = np.array([0.5, 1, 0.5], np.float32)

    def spread(values: Frame) -> Frame:
        across = convolve1d(values, weights, axis=1, mode="constant")
        return np.asarray(convolve1d(across, weights, axis=0, mode="constant"))

    planes = []
    for colour in COLOURS:
        there = np.zeros_like(picture)
        for (y, x), found in colour_places(bayer):
            if found == colour:
                there[y::2, x::2] = 1
        planes.append(np.where(there > 0, picture, spread(picture * there) / spread(there)))
    return planes
