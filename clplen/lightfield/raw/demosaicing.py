"""Colours of a filter mosaic: views and sensor pictures of each colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage
from clplen.settings.declaration import setting_of
from clplen.settings.reading import ReadingSettings

Frame = np.ndarray[Any, np.dtype[np.float32]]
Tile = tuple[tuple[str, ...], ...]

COLOURS = "RGB"
_MIN_WHITE = 1e-5  # of the white level: lower than any lit view


def tile_of(bayer: str | Sequence[Sequence[str]]) -> Tile:
    """Return the tile of a red, green and blue mosaic, row by row, in capitals."""
    if isinstance(bayer, str):
        name = setting_of(ReadingSettings, "bayer").checked(bayer)
        return (name[0], name[1]), (name[2], name[3])
    rows = tuple(tuple(str(name).upper() for name in row) for row in bayer)
    filters = {name for row in rows for name in row}
    if len({len(row) for row in rows}) != 1 or filters != set(COLOURS):
        raise ValueError(
            "A mosaic must have the filters R, G and B in rows of one length, such as "
            f"('RG', 'GB'), got {tuple(bayer)!r}."
        )
    return rows


def scaled_colours(picture: Frame, tile: Tile, factors: Mapping[str, float]) -> Frame:
    """Multiply each colour of a mosaic by its factor."""
    out = picture.copy()
    for y, row in enumerate(tile):
        for x, colour in enumerate(row):
            out[y :: len(tile), x :: len(row)] *= np.float32(factors[colour])
    return out


def positions_of(tile: Tile, colour: str) -> list[tuple[int, int]]:
    """Return (y, x) of the pixels of a colour in a tile."""
    return [(y, x) for y, row in enumerate(tile) for x, name in enumerate(row) if name == colour]


def views_of_colours(
    picture: Frame,
    white: Frame,
    grid: LensletGrid,
    bayer: str | Sequence[Sequence[str]],
    *,
    device: Device,
) -> cla.Array:
    """Slice each colour separately, then fill gaps from the same view.

    A view has, at every lenslet, the colour of one pixel. Its other colours come from the same view
    of neighbouring lenslets, which mixes no directions. If these lack the colour too (lenslets an
    even integer of pixels apart), the nearest pixels of that colour under the lenslet are used.
    """
    shape, tile = grid.shape, tile_of(bayer)
    down, across = len(tile), len(tile[0])
    out = device.empty((*shape, 3), np.float32)
    for channel, colour in enumerate(COLOURS):
        positions = positions_of(tile, colour)
        parts = []
        for frame in (picture, white):
            sparse = np.zeros_like(frame)
            for y, x in positions:
                sparse[y::down, x::across] = frame[y::down, x::across]
            pictures = [(sparse, grid)]
            for y, x in (positions[0], positions[-1]):
                pixels = np.ascontiguousarray(frame[y::down, x::across])
                pictures.append((pixels, _every(grid, (y, x), (down, across))))
            parts.append(
                [
                    resample(device.upload(part), part_grid, device, interpolation="linear")
                    for part, part_grid in pictures
                ]
            )
        (raw, *near), (flat, *near_flat) = parts
        device.launch_rows(
            device.kernel("devignette.cl", "colours"),
            (shape[0] * shape[1], *shape[2:]),
            out,
            *(raw, flat, *near, *near_flat),
            np.float32(_MIN_WHITE),
            *(np.int32(n) for n in (*shape[2:], channel)),
        )
    return out


def _every(grid: LensletGrid, first: tuple[int, int], period: tuple[int, int]) -> LensletGrid:
    """Return the grid on every ``apart``-th pixel (y, x), from ``first`` on."""

    def shorter(step: tuple[float, float]) -> tuple[float, float]:
        return step[0] / period[0], step[1] / period[1]

    return replace(
        grid,
        first=shorter((grid.first[0] - first[0], grid.first[1] - first[1])),
        row_step=shorter(grid.row_step),
        column_step=shorter(grid.column_step),
        row_view_step=shorter(grid.row_view_step),
        column_view_step=shorter(grid.column_view_step),
    )


def bilinear_colours(picture: Frame, bayer: str | Sequence[Sequence[str]]) -> list[Frame]:
    """Interpolate red, green and blue bilinearly to every pixel: each (ny, nx), float32."""
    from scipy.ndimage import convolve1d

    tile = tile_of(bayer)
    down, across = (_triangle(n) for n in (len(tile), len(tile[0])))

    def spread(values: Frame) -> Frame:
        along = convolve1d(values, across, axis=1, mode="constant")
        return np.asarray(convolve1d(along, down, axis=0, mode="constant"))

    planes = []
    for colour in COLOURS:
        mask = np.zeros_like(picture)
        for y, x in positions_of(tile, colour):
            mask[y :: len(tile), x :: len(tile[0])] = 1
        planes.append(np.where(mask > 0, picture, spread(picture * mask) / spread(mask)))
    return planes


def demosaic(raw: RawImage) -> RawImage:
    """Interpolate all colours at each pixel of a raw image with colour filters.

    Missing colours are interpolated linearly on the sensor. `LightField.from_raw` does not need
    this picture, because it slices each colour separately without mixing directions. Rendering of
    focused cameras (`render_focused`) does.

    Parameters
    ----------
    raw : RawImage
        Raw image with a ``mosaic`` of the filters R, G and B.

    Returns
    -------
    RawImage
        Raw image, float32, shape (ny, nx, 3), less its black level.

    Raises
    ------
    ValueError
        If the raw image has no mosaic, or other filters.

    Examples
    --------
    >>> y, x = np.indices((45, 45))
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=3, fill="full")
    >>> pixels = clplen.cameras.PixelArray(filters=clplen.cameras.ColorFilterArray.bayer("RGGB"))
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.03, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=14, pixels=pixels
    ... )
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> clplen.lightfield.demosaic(raw).shape
    (42, 42)
    """
    if raw.mosaic is None:
        raise ValueError("This raw image has no colour filters, its ``mosaic`` is None.")
    planes = bilinear_colours(raw.above_black().to_numpy(), raw.mosaic)
    colours = raw.device.upload(np.ascontiguousarray(np.stack(planes, axis=-1)))
    return replace(raw, data=colours, mosaic=None, levels=None)


def _triangle(period: int) -> Frame:
    """Return weights up to a period of the tile on either side, 1 in the middle."""
    n = np.arange(1 - period, period)
    return np.asarray(1 - np.abs(n) / period, np.float32)
