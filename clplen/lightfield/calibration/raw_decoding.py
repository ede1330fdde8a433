"""From a raw frame, its Bayer mosaic and its lattice of lenslets to a light field."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen import units
from clplen.checks import is_integer, real_array
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import ShapeError, argument
from clplen.lightfield.calibration import sensor_frames
from clplen.lightfield.calibration.sensor_frames import Frame, Mosaic
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.colour_fit import fit_colours, noise_of
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.demosaicing import (
    COLOURS,
    Tile,
    bilinear_colours,
    scaled_colours,
    tile_of,
    views_of_colours,
)
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import RawImage, Spacing
from clplen.settings.declaration import setting_of
from clplen.settings.reading import ReadingSettings

_FLOOR = 0.05  # of the white image's bright pixels: what is darker is divided by that
_BRIGHT = 0.995  # quantile of the white image that counts as bright


@dataclass(frozen=True)
class _Pixels:
    """A cleaned frame, and what each of its pixels would be in even light (None: not known).

    Its red, green and blue pixels were multiplied by ``factors``.
    """

    picture: Frame
    white: Frame | None
    tile: Tile | None
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)


def decode_raw(
    raw: ArrayLike,
    lattice: Lattice,
    *,
    device: DeviceLike | None = None,
    white: ArrayLike | None = None,
    dark: ArrayLike | None = None,
    views: tuple[int, int] | None = None,
    step: float | None = None,
    devignette: bool | None = None,
    bayer: Mosaic | None = None,
    demosaic: str = "within",
    complete: bool = True,
    pixel_pitch: float | None = None,
    white_balance: tuple[float, float, float] | None = None,
    colour_matrix: ArrayLike | None = None,
) -> LightField:
    """Decode a raw lenslet frame.

    The dark frame is subtracted from both pictures; hot pixels of it and single saturated pixels
    are replaced by their neighbours (a saturated patch stays as it is). Every sub-image is sampled
    about its centre, along the lattice's own vectors, by separable cubic convolution (Keys 1981,
    eq. 15, a = -1/2), and divided by the white image, sampled in the same way. A view whose white
    level is below a twentieth of the brightest is divided by that.

    Rows (or columns) of a hexagonal lattice are interpolated to pixels that lie sqrt(3)/2 of the
    pitch apart both ways: that is dx = dy of the result.

    Parameters
    ----------
    raw : array_like
        Shape (ny, nx), as it lies on the sensor, real and finite.
    lattice : Lattice
        Of this camera, as `estimate_lattice` finds it on the white image.
    device : Device or str, optional
        Default ``Device.open()``.
    white, dark : array_like, optional
        White image and dark frame of the same shape.
    views : tuple of int, optional
        (V, U) samples of each sub-image; default its pitch in pixels, rounded. Fewer with
        ``step=1`` leave out the dark rim.
    step : float, optional
        Pixels a view; default pitch/V and pitch/U.
    devignette : bool, optional
        Whether to divide by the white image; default if there is one. The mean white level of each
        view, the brightest 1, is its weight then.
    bayer : {"RGGB", "BGGR", "GRBG", "GBRG"} or sequence of str, optional
        Colour filters of the pixels (0, 0), (0, 1), (1, 0), (1, 1); or the rows of another tile of
        R, G and B, such as ``("RRGG", "RRGG", "GGBB", "GGBB")`` of a quad Bayer mosaic.
    demosaic : {"within", "after", "before"}
        "within" fits each colour of a view by a quadratic to the pixels of that colour under the
        same lenslet, smoother where noise explains their differences; it mixes no lenslets.
        "after" slices each colour by itself and fills what it misses from the same view of
        neighbouring lenslets (linear interpolation), which mixes no directions; "before"
        interpolates the colours on the sensor first.
    complete : bool
        Whether to keep the largest rectangle of lenslets whose whole sub-image lies on the sensor;
        False keeps those whose centre does, and pixels off the sensor count 0.
    pixel_pitch : float, optional
        Of the sensor, in metres; the result then has dy and dx, with dv and du unknown (NaN).
    white_balance : tuple of float, optional
        Factors of red, green and blue, with ``bayer``.
    colour_matrix : array_like, optional
        Shape (3, 3), with ``bayer``: each ray's (red, green, blue) becomes ``colour_matrix @ rgb``,
        after the white balance. Takes a camera's colours to linear sRGB.

    Returns
    -------
    LightField
        Of float32, shape (V, U, y, x) or, with ``bayer``, (V, U, y, x, 3), in raw pixel order: it
        obeys L[v, u](y, x) = T(y + d (v - vc), x + d (u - uc)) with d larger for nearer objects.

    Raises
    ------
    ShapeError
        If the pictures and the lattice are of different shapes, or no lenslet fits.
    ValueError
        If a pixel is NaN or infinite, nothing repeated where the lattice was looked for, a word is
        out of range, or ``devignette=True`` comes without a white image.
    DeviceError
        If the light field is larger than the device's memory.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(64) / 10)  # lenslets 10 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> lattice = clplen.estimate_lattice(white)
    >>> lf = clplen.decode_raw(0.5 * white, lattice, white=white)
    >>> lf.shape, f"{np.median(lf.to_numpy()) / white.max():.2f}"
    ((10, 10, 5, 5), '0.50')
    """
    device = as_device(device)
    frame = sensor_frames.as_frame(raw, "raw frame")
    _check(views, step, bayer, demosaic, devignette, white, pixel_pitch)
    _check_balance(white_balance, bayer)
    matrix = _checked_matrix(colour_matrix, bayer)
    if not lattice.is_measured:
        raise ValueError(f"This lattice was not measured: {lattice.verdict}")
    lattice = _with_shape(lattice, frame.shape)
    divide = white is not None if devignette is None else devignette
    chosen = lattice.views() if views is None else (int(views[0]), int(views[1]))
    grid = lattice.grid(chosen, step=step, complete=complete, square=True)
    nbytes = decoding_bytes(grid, bayer=bayer, demosaic=demosaic, has_white=white is not None)
    device.require_memory(nbytes, "Decoding this light field")
    pixels = _cleaned(frame, white if divide else None, dark, bayer)
    if white_balance is not None and pixels.tile is not None:
        factors = dict(zip(COLOURS, white_balance, strict=True))
        balanced = scaled_colours(pixels.picture, pixels.tile, factors)
        pixels = replace(pixels, picture=balanced, factors=white_balance)
    kept = _raw_image(pixels.picture, grid, device, pixel_pitch, lattice)
    if bayer is None:
        data, level = _grey(kept, pixels, grid, device)
    else:
        data, level = _coloured(kept, pixels, grid, demosaic, matrix)
    weights = np.ones(grid.shape[:2], np.float32) if level is None else _weights(level, device)
    return LightField(data, device, kept.spacing, weights, raw=kept)


def decoding_bytes(
    grid: LensletGrid, *, bayer: Mosaic | None, demosaic: str, has_white: bool
) -> int:
    """Bytes of the arrays of views that decoding holds at once."""
    channels = (3 if has_white else 1) if bayer is None else 4 if demosaic == "within" else 10
    return 4 * channels * math.prod(grid.shape)


def _check(
    views: Any,
    step: Any,
    bayer: Mosaic | None,
    demosaic: str,
    devignette: Any,
    white: Any,
    pixel_pitch: Any,
) -> None:
    if views is not None and (len(views) != 2 or not all(is_integer(n) and n >= 1 for n in views)):
        raise ValueError(f"views is (V, U), two whole numbers from 1 on, not {views!r}.")
    if step is not None and not 0 < step < math.inf:
        raise ValueError(f"step is a positive number of pixels, not {step!r}.")
    if pixel_pitch is not None and not 0 < pixel_pitch < math.inf:
        raise ValueError(f"pixel_pitch is positive, in metres, not {pixel_pitch!r}.")
    units.PITCH.check(pixel_pitch or 0.0, "pixel_pitch")
    setting_of(ReadingSettings, "demosaic").checked(demosaic)
    if bayer is not None:
        tile_of(bayer)
    if devignette and white is None:
        raise ValueError(
            f"{argument('devignette', True)} divides by the white image: give {argument('white')}."
        )


def _check_balance(factors: Any, bayer: Mosaic | None) -> None:
    if factors is None:
        return
    if bayer is None:
        raise ValueError(f"white_balance is of colours: give {argument('bayer')} too.")
    values = real_array(factors, "factors", np.float64)
    if values.shape != (3,) or not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(
            f"white_balance is the factors of red, green and blue, three numbers above 0, not "
            f"{factors!r}."
        )


def _checked_matrix(matrix: Any, bayer: Mosaic | None) -> Frame | None:
    if matrix is None:
        return None
    if bayer is None:
        raise ValueError(f"colour_matrix mixes colours: give {argument('bayer')} too.")
    values = real_array(matrix, "A colour matrix", np.float64)
    if values.shape != (3, 3) or not np.isfinite(values).all():
        raise ValueError(f"colour_matrix has shape (3, 3) and is finite, not {matrix!r}.")
    return values.astype(np.float32)


def _mix_colours(data: cla.Array, matrix: Frame, device: Device) -> None:
    """Colours (..., 3) of a light field brought through a matrix, one row of views at a time."""
    for v in range(int(data.shape[0])):
        row = device.download(data[v])
        data[v].set(np.ascontiguousarray(row.reshape(-1, 3) @ matrix.T).reshape(row.shape))


def _with_shape(lattice: Lattice, shape: tuple[int, int]) -> Lattice:
    if lattice.shape is None:
        return replace(lattice, shape=shape)
    if lattice.shape != shape:
        raise ShapeError(
            f"The lattice is that of a picture of shape {lattice.shape}, the raw frame has shape "
            f"{shape}: give the lattice of this camera."
        )
    return lattice


def _cleaned(frame: Any, white: Any, dark: Any, bayer: Mosaic | None) -> _Pixels:
    """Dark frame off, bad pixels filled, the white image scaled to 1 where it is bright."""
    tile = None if bayer is None else tile_of(bayer)
    down, across = (1, 1) if tile is None else (len(tile), len(tile[0]))
    apart = math.lcm(down, across)
    hot = np.zeros(frame.shape, bool) if dark is None else sensor_frames.hot_pixels(dark)
    picture = sensor_frames.subtract_dark(frame, dark)
    picture = sensor_frames.fill_pixels(
        picture, hot | sensor_frames.saturated_pixels(frame), step=apart
    )
    if white is None:
        return _Pixels(picture, None, tile)
    flat = sensor_frames.as_frame(white, "white image")
    if flat.shape != frame.shape:
        raise ShapeError(
            f"The white image has shape {flat.shape}, the raw frame {frame.shape}: give the white "
            "image of this camera."
        )
    level = sensor_frames.fill_pixels(
        sensor_frames.subtract_dark(flat, dark),
        hot | sensor_frames.saturated_pixels(flat),
        step=apart,
    )
    for y, x in itertools.product(range(down), range(across)):
        level[y::down, x::across] /= _white_level(level[y::down, x::across])
    return _Pixels(picture, level, tile)


def _white_level(values: Frame) -> float:
    """The level of a white image where it is bright."""
    level = float(np.quantile(values[:: max(1, len(values) // 1024)], _BRIGHT))
    if not level > 0:
        raise ValueError("The white image is dark throughout: give the one of an even, lit scene.")
    return level


def _raw_image(
    picture: Frame, grid: LensletGrid, device: Device, pixel_pitch: float | None, lattice: Lattice
) -> RawImage:
    spacing: Spacing | None = None
    if pixel_pitch is not None:
        along, across = lattice.pitch
        if lattice.kind == "hexagonal":
            along = across = min(along, across)
        spacing = (math.nan, math.nan, across * pixel_pitch, along * pixel_pitch)
    pitch = math.nan if pixel_pitch is None else pixel_pitch
    return RawImage(device.upload(picture), device, pitch, grid, grid, spacing, lattice=lattice)


def _sliced(frame: Frame, grid: LensletGrid, device: Device) -> cla.Array:
    """Return the views of a frame."""
    return resample(device.upload(frame), grid, device)


def _grey(
    kept: RawImage, pixels: _Pixels, grid: LensletGrid, device: Device
) -> tuple[cla.Array, cla.Array | None]:
    """Views, and the white level of each of their samples."""
    data = resample(kept.data, grid, device)
    if pixels.white is None:
        return data, None
    level = _sliced(pixels.white, grid, device)
    even = device.empty(grid.shape, np.float32)
    divide_views(even, data, level, 1, 0, device)
    return even, level


def _coloured(
    kept: RawImage, pixels: _Pixels, grid: LensletGrid, demosaic: str, matrix: Frame | None
) -> tuple[cla.Array, cla.Array | None]:
    assert pixels.tile is not None
    if demosaic == "within":
        return _fitted(kept, pixels, pixels.tile, grid, matrix)
    data, level = _interpolated(pixels, pixels.tile, grid, demosaic, kept.device)
    if matrix is not None:
        _mix_colours(data, matrix, kept.device)
    return data, level


def _interpolated(
    pixels: _Pixels, bayer: Tile, grid: LensletGrid, demosaic: str, device: Device
) -> tuple[cla.Array, cla.Array | None]:
    white = np.ones_like(pixels.picture) if pixels.white is None else pixels.white
    level = None if pixels.white is None else _sliced(white, grid, device)
    if demosaic == "after":
        lit = np.maximum(white, np.float32(_FLOOR))
        return views_of_colours(pixels.picture, lit, grid, bayer, device=device), level
    data = device.empty((*grid.shape, 3), np.float32)
    planes = zip(
        bilinear_colours(pixels.picture, bayer), bilinear_colours(white, bayer), strict=True
    )
    for channel, (picture, flat) in enumerate(planes):
        views = _sliced(picture, grid, device)
        divide_views(data, views, _sliced(flat, grid, device), 3, channel, device)
    return data, level


def _fitted(
    kept: RawImage, pixels: _Pixels, bayer: Tile, grid: LensletGrid, matrix: Frame | None
) -> tuple[cla.Array, cla.Array | None]:
    device = kept.device
    white = np.ones_like(pixels.picture) if pixels.white is None else pixels.white
    flat = device.upload(white)
    # without a white image, nothing tells vignetting from noise
    green = 0.0 if pixels.white is None else noise_of(pixels.picture, pixels.white, bayer)
    noise = [green * factor / pixels.factors[1] for factor in pixels.factors]
    data = fit_colours(
        kept.data, flat, grid, bayer, noise=noise, floor=_FLOOR, device=device, matrix=matrix
    )
    if pixels.white is None:
        return data, None
    # the mean of a view is the same before its rows are interpolated, but at their ends
    return data, resample(flat, replace(grid, columns=None), device)


def white_samples(
    white: ArrayLike, dark: ArrayLike | None, grid: LensletGrid, device: Device
) -> cla.Array:
    """Views of a white image, 1 where it is bright, as `decode_raw` divides by them."""
    flat = sensor_frames.as_frame(white, "white image")
    level = _cleaned(flat, flat, dark, None).white
    assert level is not None
    return _sliced(level, grid, device)


def divide_views(
    out: cla.Array, views: cla.Array, level: cla.Array, channels: int, channel: int, device: Device
) -> None:
    """One channel of the light field: views over their white level."""
    V, U, ny, nx = (int(n) for n in views.shape)
    device.launch_rows(
        device.kernel("devignette.cl", "divide"),
        (V * U, ny, nx),
        *(out, views, level),
        np.float32(_FLOOR),
        *(np.int32(n) for n in (ny, nx, channels, channel)),
    )


def _weights(level: cla.Array, device: Device) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Mean white level of every view, the brightest 1."""
    rows = (device.download(level[v]) for v in range(int(level.shape[0])))  # no copy of all
    mean = np.maximum([row.mean(axis=(1, 2), dtype=np.float64) for row in rows], 0)
    return np.asarray(mean / mean.max(), np.float32)
