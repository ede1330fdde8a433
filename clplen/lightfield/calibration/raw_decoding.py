"""Decoding of a raw frame with its Bayer mosaic and lattice into a light field."""

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

_FLOOR = 0.05  # of the white level of bright pixels: lower levels are raised to it
_BRIGHT = 0.995  # quantile of the white image that defines its bright level


@dataclass(frozen=True)
class _Pixels:
    """A cleaned frame with the flat of each pixel, None if unknown.

    The red, green and blue pixels of ``picture`` were multiplied by ``factors``.
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

    The dark frame is subtracted from both pictures. Its hot pixels and single saturated pixels
    are replaced by their neighbours; saturated patches stay. Each sub-image is sampled about its
    centre along the lattice vectors by separable cubic convolution (Keys 1981, eq. 15, a = -1/2),
    and divided by the white image sampled likewise. White levels below a twentieth of the brightest
    are raised to it.

    Rows (or columns) of a hexagonal lattice are interpolated to square pixels of sqrt(3)/2 times
    the pitch, dx = dy of the result.

    Parameters
    ----------
    raw : array_like
        Raw frame in sensor orientation, shape (ny, nx), real and finite.
    lattice : Lattice
        Lattice of this camera, from `estimate_lattice` of the white image.
    device : Device or str, optional
        Device; default ``Device.open()``.
    white, dark : array_like, optional
        White image and dark frame of equal shape.
    views : tuple of int, optional
        Samples (V, U) of each sub-image; default the pitch in pixels, rounded. Fewer samples with
        ``step=1`` leave out the dark rim.
    step : float, optional
        Pixels a view; default pitch/V and pitch/U.
    devignette : bool, optional
        True to divide by the white image, the default if it is present. The weight of a view is
        then its mean white level, 1 for the brightest.
    bayer : {"RGGB", "BGGR", "GRBG", "GBRG"} or sequence of str, optional
        Colour filters of the pixels (0, 0), (0, 1), (1, 0), (1, 1), or the rows of another tile of
        R, G and B, such as ``("RRGG", "RRGG", "GGBB", "GGBB")`` of a quad Bayer mosaic.
    demosaic : {"within", "after", "before"}
        Method of colour interpolation. "within" fits a quadratic to the pixels of each colour
        under a lenslet, smoother where noise explains their differences; it mixes no lenslets.
        "after" slices each colour, then fills gaps from the same view of neighbouring lenslets
        (linear interpolation); it mixes no directions. "before" interpolates the colours on the
        sensor first.
    complete : bool
        True to keep the largest rectangle of lenslets with complete sub-images; False to keep all
        lenslets whose centre is on the sensor, with pixels off the sensor set to 0.
    pixel_pitch : float, optional
        Pixel pitch of the sensor in metres; sets dy and dx of the result (dv and du stay NaN).
    white_balance : tuple of float, optional
        Factors of red, green and blue; requires ``bayer``.
    colour_matrix : array_like, optional
        Matrix of shape (3, 3), from camera colours to linear sRGB, applied to the (red, green,
        blue) of each ray after the white balance; requires ``bayer``.

    Returns
    -------
    LightField
        Light field of float32, shape (V, U, y, x) or, with ``bayer``, (V, U, y, x, 3), in raw pixel
        order: L[v, u](y, x) = T(y + d (v - vc), x + d (u - uc)) with d larger for nearer objects.

    Raises
    ------
    ShapeError
        If the pictures and the lattice differ in shape, or no lenslet fits.
    ValueError
        If a pixel is NaN or infinite, the lattice was not measured, an option is invalid, or
        ``devignette=True`` has no white image.
    DeviceError
        If the light field exceeds the device's memory.

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
        raise ValueError(f"lattice must be a measured one: {lattice.verdict}")
    lattice = _with_shape(lattice, frame.shape)
    divide = white is not None if devignette is None else devignette
    view_counts = lattice.views() if views is None else (int(views[0]), int(views[1]))
    grid = lattice.grid(view_counts, step=step, complete=complete, square=True)
    nbytes = decoding_bytes(grid, bayer=bayer, demosaic=demosaic, has_white=white is not None)
    device.require_memory(nbytes, "Decoding this light field")
    pixels = _cleaned(frame, white if divide else None, dark, bayer)
    if white_balance is not None and pixels.tile is not None:
        factors = dict(zip(COLOURS, white_balance, strict=True))
        balanced = scaled_colours(pixels.picture, pixels.tile, factors)
        pixels = replace(pixels, picture=balanced, factors=white_balance)
    cleaned_raw = _raw_image(pixels.picture, grid, device, pixel_pitch, lattice)
    if bayer is None:
        data, level = _grey(cleaned_raw, pixels, grid, device)
    else:
        data, level = _coloured(cleaned_raw, pixels, grid, demosaic, matrix)
    weights = np.ones(grid.shape[:2], np.float32) if level is None else _weights(level, device)
    return LightField(data, device, cleaned_raw.spacing, weights, raw=cleaned_raw)


def decoding_bytes(
    grid: LensletGrid, *, bayer: Mosaic | None, demosaic: str, has_white: bool
) -> int:
    """Return the bytes of the arrays of views that coexist during decoding."""
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
        raise ValueError(f"views must be (V, U), two integers of at least 1, got {views!r}.")
    if step is not None and not 0 < step < math.inf:
        raise ValueError(f"step must be a positive number of pixels, got {step!r}.")
    if pixel_pitch is not None and not 0 < pixel_pitch < math.inf:
        raise ValueError(f"pixel_pitch must be positive, in metres, got {pixel_pitch!r}.")
    units.PITCH.check(pixel_pitch or 0.0, "pixel_pitch")
    setting_of(ReadingSettings, "demosaic").checked(demosaic)
    if bayer is not None:
        tile_of(bayer)
    if devignette and white is None:
        raise ValueError(
            f"{argument('devignette', True)} needs a white image; pass {argument('white')}."
        )


def _check_balance(factors: Any, bayer: Mosaic | None) -> None:
    if factors is None:
        return
    if bayer is None:
        raise ValueError(f"white_balance needs colour filters; pass {argument('bayer')} too.")
    values = real_array(factors, "factors", np.float64)
    if values.shape != (3,) or not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(
            f"white_balance must be three positive factors of red, green and blue, got {factors!r}."
        )


def _checked_matrix(matrix: Any, bayer: Mosaic | None) -> Frame | None:
    if matrix is None:
        return None
    if bayer is None:
        raise ValueError(f"colour_matrix needs colour filters; pass {argument('bayer')} too.")
    values = real_array(matrix, "A colour matrix", np.float64)
    if values.shape != (3, 3) or not np.isfinite(values).all():
        raise ValueError(f"colour_matrix must be finite with shape (3, 3), got {matrix!r}.")
    return values.astype(np.float32)


def _mix_colours(data: cla.Array, matrix: Frame, device: Device) -> None:
    """Multiply the colours (..., 3) of a light field by a matrix, one row of views at a time."""
    for v in range(int(data.shape[0])):
        row = device.download(data[v])
        data[v].set(np.ascontiguousarray(row.reshape(-1, 3) @ matrix.T).reshape(row.shape))


def _with_shape(lattice: Lattice, shape: tuple[int, int]) -> Lattice:
    if lattice.shape is None:
        return replace(lattice, shape=shape)
    if lattice.shape != shape:
        raise ShapeError(
            f"raw must have the shape of the lattice, {lattice.shape}, got {shape}; pass the "
            "lattice of this camera."
        )
    return lattice


def _cleaned(frame: Any, white: Any, dark: Any, bayer: Mosaic | None) -> _Pixels:
    """Subtract the dark frame, fill bad pixels, and scale the white image to 1."""
    tile = None if bayer is None else tile_of(bayer)
    down, across = (1, 1) if tile is None else (len(tile), len(tile[0]))
    period = math.lcm(down, across)
    hot = np.zeros(frame.shape, bool) if dark is None else sensor_frames.hot_pixels(dark)
    picture = sensor_frames.subtract_dark(frame, dark)
    picture = sensor_frames.fill_pixels(
        picture, hot | sensor_frames.saturated_pixels(frame), step=period
    )
    if white is None:
        return _Pixels(picture, None, tile)
    flat = sensor_frames.as_frame(white, "white image")
    if flat.shape != frame.shape:
        raise ShapeError(
            f"white must have the shape of the raw frame, {frame.shape}, got {flat.shape}; pass "
            "the white image of this camera."
        )
    level = sensor_frames.fill_pixels(
        sensor_frames.subtract_dark(flat, dark),
        hot | sensor_frames.saturated_pixels(flat),
        step=period,
    )
    for y, x in itertools.product(range(down), range(across)):
        level[y::down, x::across] /= _white_level(level[y::down, x::across])
    return _Pixels(picture, level, tile)


def _white_level(values: Frame) -> float:
    """Return the level of a white image's bright pixels."""
    level = float(np.quantile(values[:: max(1, len(values) // 1024)], _BRIGHT))
    if not level > 0:
        raise ValueError("The white image is black; pass a picture of an evenly lit scene.")
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
    raw: RawImage, pixels: _Pixels, grid: LensletGrid, device: Device
) -> tuple[cla.Array, cla.Array | None]:
    """Return the views and their white level."""
    data = resample(raw.data, grid, device)
    if pixels.white is None:
        return data, None
    level = _sliced(pixels.white, grid, device)
    divided = device.empty(grid.shape, np.float32)
    divide_views(divided, data, level, 1, 0, device)
    return divided, level


def _coloured(
    raw: RawImage, pixels: _Pixels, grid: LensletGrid, demosaic: str, matrix: Frame | None
) -> tuple[cla.Array, cla.Array | None]:
    assert pixels.tile is not None
    if demosaic == "within":
        return _fitted(raw, pixels, pixels.tile, grid, matrix)
    data, level = _interpolated(pixels, pixels.tile, grid, demosaic, raw.device)
    if matrix is not None:
        _mix_colours(data, matrix, raw.device)
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
    raw: RawImage, pixels: _Pixels, bayer: Tile, grid: LensletGrid, matrix: Frame | None
) -> tuple[cla.Array, cla.Array | None]:
    device = raw.device
    white = np.ones_like(pixels.picture) if pixels.white is None else pixels.white
    flat = device.upload(white)
    # without a white image vignetting is indistinguishable from noise
    green = 0.0 if pixels.white is None else noise_of(pixels.picture, pixels.white, bayer)
    noise = [green * factor / pixels.factors[1] for factor in pixels.factors]
    data = fit_colours(
        raw.data, flat, grid, bayer, noise=noise, floor=_FLOOR, device=device, matrix=matrix
    )
    if pixels.white is None:
        return data, None
    # a view's mean is equal before its rows are interpolated, except at their ends
    return data, resample(flat, replace(grid, columns=None), device)


def white_samples(
    white: ArrayLike, dark: ArrayLike | None, grid: LensletGrid, device: Device
) -> cla.Array:
    """Return the views of a white image scaled to 1, the divisor of `decode_raw`."""
    flat = sensor_frames.as_frame(white, "white image")
    level = _cleaned(flat, flat, dark, None).white
    assert level is not None
    return _sliced(level, grid, device)


def divide_views(
    out: cla.Array, views: cla.Array, level: cla.Array, channels: int, channel: int, device: Device
) -> None:
    """Write one channel of the light field: views over their white level."""
    V, U, ny, nx = (int(n) for n in views.shape)
    device.launch_rows(
        device.kernel("devignette.cl", "divide"),
        (V * U, ny, nx),
        *(out, views, level),
        np.float32(_FLOOR),
        *(np.int32(n) for n in (ny, nx, channels, channel)),
    )


def _weights(level: cla.Array, device: Device) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return the mean white level of every view, the brightest 1."""
    rows = (device.download(level[v]) for v in range(int(level.shape[0])))  # avoids a full copy
    mean = np.maximum([row.mean(axis=(1, 2), dtype=np.float64) for row in rows], 0)
    return np.asarray(mean / mean.max(), np.float32)
