"""Textures of surfaces: smooth periodic functions from tables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from clplen.checks import (
    check_finite,
    fits_float64,
    host_array,
    is_finite,
    is_integer,
    real_array,
)
from clplen.compute.arrays import HostArray
from clplen.errors import ShapeError
from clplen.reprs import OneLine

Samples = np.ndarray[Any, np.dtype[np.float32]]
MAX_SIDE = 8192  # maximum samples of a table's side
_MIN_BRICK = 4  # minimum side of a brick in pixels
DEFAULT_SMOOTHING = 0.6  # standard deviation in pixels; the gain at half a cycle a pixel is 17 %


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Texture(OneLine, HostArray):
    """Brightness of a surface over (Y, X), the pixels of the centre view.

    It is a periodic cubic B-spline through a table (Unser, Aldroubi and Eden 1993), twice
    continuously differentiable. The brightness is already averaged over pixels, and every view
    samples it at the centres of its pixels. Views of equal disparity are exact shifts of each
    other. A table without structure above about 0.35 cycles a pixel has no aliasing that biases
    subpixel measurements.

    Parameters
    ----------
    samples : array_like
        Table of shape (ny, nx) or (ny, nx, 3), finite; 0 is black, 1 white. Its middle lies at
        ``centre``, and it repeats periodically.
    scale : float
        Distance of samples in pixels, positive.
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.

    Attributes
    ----------
    samples : numpy.ndarray
        Table, float32, shape (ny, nx, 1) or (ny, nx, 3).
    scale : float
        Distance of samples in pixels.
    centre : tuple of float
        (Y, X) in pixels.

    Raises
    ------
    ShapeError
        If the table has another shape, or a side of more than 8192 samples.
    ValueError
        If a sample or a number is not finite, or the scale not positive.

    Examples
    --------
    >>> y, x = np.indices((32, 32))
    >>> wave = 0.5 + 0.2 * np.cos(2 * np.pi * x / 8)
    >>> texture = clplen.cameras.Texture(wave, scale=2)  # a period of 16 pixels
    >>> texture
    Texture(samples=<float32 (32, 32, 1)>, scale=2, centre=(0, 0))
    """

    _samples: ClassVar[str] = "samples"

    samples: Samples
    scale: float
    centre: tuple[float, float]

    def __init__(
        self, samples: Any, scale: float = 1.0, *, centre: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        values = np.asarray(host_array(samples, "A texture"), np.float32)
        if values.ndim == 2:
            values = values[..., None]
        if values.ndim != 3 or values.shape[2] not in (1, 3) or 0 in values.shape:
            raise ShapeError(
                f"A texture must have shape (ny, nx) or (ny, nx, 3), got {np.shape(samples)}."
            )
        if max(values.shape[:2]) > MAX_SIDE:
            raise ShapeError(
                f"A texture must have at most {MAX_SIDE} samples a side, got {values.shape}."
            )
        if not np.isfinite(values).all():
            raise ValueError("The samples of a texture must be finite.")
        if not (fits_float64(scale) and scale > 0):
            raise ValueError(f"The scale of a texture must be > 0 pixels, got {scale!r}.")
        if not np.isfinite(centre).all():
            raise ValueError(f"The centre of a texture must be finite, in pixels, got {centre!r}.")
        object.__setattr__(self, "samples", values)
        object.__setattr__(self, "scale", float(scale))
        object.__setattr__(self, "centre", (float(centre[0]), float(centre[1])))

    @property
    def channels(self) -> int:
        """Number of channels, 1 or 3."""
        return int(self.samples.shape[2])

    def coefficients(self, channels: int) -> Samples:
        """Return the B-spline's coefficients, float32, shape (ny, nx, channels).

        The spectrum is divided by (2 + cos w)/3 along each axis (Unser 1999, box 2).
        """
        values = spline_coefficients(self.samples).astype(np.float32)
        return np.ascontiguousarray(np.broadcast_to(values, (*values.shape[:2], channels)))


def spline_coefficients(samples: Any) -> Any:
    """Compute coefficients of the periodic cubic B-spline of samples, a symmetric linear map."""
    ny, nx = np.shape(samples)[:2]
    spectrum = np.fft.rfft2(np.asarray(samples, np.float64), axes=(0, 1))
    for axis, f in ((0, np.fft.fftfreq(ny)), (1, np.fft.rfftfreq(nx))):
        spectrum /= np.expand_dims((2 + np.cos(2 * np.pi * f)) / 3, (1 - axis, 2))
    return np.fft.irfft2(spectrum, s=(ny, nx), axes=(0, 1))


def uniform(level: float | tuple[float, float, float] = 0.5) -> Texture:
    """Return a texture of uniform brightness.

    Parameters
    ----------
    level : float or tuple of float
        Brightness, 0 black, 1 white; three numbers are a colour.

    Returns
    -------
    Texture
        Texture of one sample, shape (1, 1, 1), or (1, 1, 3) for a colour.

    Raises
    ------
    ShapeError
        If ``level`` has neither one number nor three.
    ValueError
        If a number is not finite.

    Examples
    --------
    >>> orange = clplen.cameras.uniform((1.0, 0.5, 0.0))
    >>> orange.samples.tolist()
    [[[1.0, 0.5, 0.0]]]
    """
    return Texture(np.atleast_3d(real_array(level, "level")).reshape(1, 1, -1))


def noise(
    seed: int,
    side: int = 512,
    *,
    mean: float = 0.5,
    contrast: float = 0.15,
    exponent: float = 1.0,
    finest: float = 0.3,
    coarsest: float = 1 / 128,
    colour: bool = False,
) -> Texture:
    """Return band-limited Gaussian noise with an amplitude spectrum f^-exponent.

    Parameters
    ----------
    seed : int
        Seed of `numpy.random.default_rng`.
    side : int
        Number of samples a side, one a pixel, at least 4; the period of the texture.
    mean, contrast : float
        Mean and rms of the brightness, clipped to 0..1.
    exponent : float
        Exponent of the spectrum: 0 for white noise, 1 as in natural pictures (Field 1987).
    finest, coarsest : float
        Limits of the band in cycles a pixel, 0 <= coarsest < finest <= 1/2.
    colour : bool
        True for three channels that share half of their variance.

    Returns
    -------
    Texture
        Noise, shape (side, side, 1), or (side, side, 3) with ``colour``.

    Raises
    ------
    ValueError
        If the band is empty on this side or reaches beyond half a cycle a pixel.

    Examples
    --------
    >>> texture = clplen.cameras.noise(1, 64, contrast=0.1)
    >>> texture.samples.shape
    (64, 64, 1)
    >>> f"{texture.samples.mean():.2f} +- {texture.samples.std():.2f}"
    '0.50 +- 0.10'
    """
    if not is_integer(side) or side < 4 or not 0 <= coarsest < finest <= 0.5:
        raise ValueError(
            f"Noise must have a side >= 4 and 0 <= coarsest < finest <= 0.5 cycles a pixel, got "
            f"side {side}, {coarsest!r} and {finest!r}."
        )
    check_finite(mean=mean, contrast=contrast, exponent=exponent)
    fy, fx = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :]
    f = np.hypot(fy, fx)
    band = (f >= coarsest) & (f <= finest) & (f > 0)
    if not band.any():
        raise ValueError(
            f"A side of {side} samples has no frequency from {coarsest} to {finest}: use a larger "
            "side."
        )
    weight = np.where(band, np.where(f > 0, f, 1) ** -exponent, 0)
    random = np.random.default_rng(seed)
    planes = [_noise_plane(random, weight, side) for _ in range(4 if colour else 1)]
    if colour:
        colours = [(planes[0] + planes[c]) / math.sqrt(2) for c in (1, 2, 3)]
        return Texture(np.clip(mean + contrast * np.stack(colours, axis=-1), 0, 1))
    return Texture(np.clip(mean + contrast * planes[0], 0, 1))


def _noise_plane(random: np.random.Generator, weight: Any, side: int) -> Any:
    """Return noise of a spectrum's weights, mean 0, rms 1."""
    white = np.fft.rfft2(random.standard_normal((side, side)))
    values = np.fft.irfft2(white * weight, s=(side, side))
    return values / values.std()


def picture(image: Any, *, scale: float = 1.0, smoothing: float = DEFAULT_SMOOTHING) -> Texture:
    """Return a texture of a smoothed picture, mirrored at its edges to repeat without a seam.

    Parameters
    ----------
    image : array_like
        Picture of shape (ny, nx) or (ny, nx, 3). Integers are divided by the largest of their type;
        other numbers are unchanged (0 black, 1 white).
    scale : float
        Distance of samples in pixels, positive.
    smoothing : float
        Standard deviation of the smoothing Gaussian in pixels; 0 for none.

    Returns
    -------
    Texture
        Texture of shape (2 ny, 2 nx, 1) or (2 ny, 2 nx, 3).

    Raises
    ------
    ShapeError
        If the picture has another shape, or a side of more than 4096 samples.
    ValueError
        If a sample is not finite, or the scale not positive.

    Examples
    --------
    >>> image = np.tile(np.arange(0, 256, 16, dtype=np.uint8), (16, 1))
    >>> texture = clplen.cameras.picture(image)
    >>> texture.samples.shape
    (32, 32, 1)
    >>> f"{texture.samples.mean():.3f}", f"{image.mean() / 255:.3f}"
    ('0.471', '0.471')
    """
    _require_positive("The scale of a picture", scale)
    values = host_array(image, "A picture")
    if values.dtype.kind in "ui":
        values = values / np.iinfo(values.dtype).max
    if values.ndim not in (2, 3) or not values.size:
        raise ShapeError(f"A picture must have shape (ny, nx) or (ny, nx, 3), got {values.shape}.")
    for axis in (0, 1):
        values = np.concatenate([values, np.flip(values, axis)], axis)
    return Texture(smooth(values, smoothing / scale), scale)


def checker(
    period: float, *, low: float = 0.2, high: float = 0.8, smoothing: float = DEFAULT_SMOOTHING
) -> Texture:
    """Return a chessboard of squares of half a period, its edges smoothed by a Gaussian.

    Parameters
    ----------
    period : float
        Side of two squares in pixels, positive.
    low, high : float
        Brightness of the dark and of the bright squares, 0 black, 1 white.
    smoothing : float
        Standard deviation of the Gaussian in pixels; 0 for none.

    Returns
    -------
    Texture
        One period, shape (64, 64, 1).

    Raises
    ------
    ValueError
        If the period is not positive, or a number is not finite.

    Examples
    --------
    >>> texture = clplen.cameras.checker(16)
    >>> texture.samples.shape, texture.scale
    ((64, 64, 1), 0.25)
    >>> f"{texture.samples.min():.2f} to {texture.samples.max():.2f}"
    '0.20 to 0.80'
    """
    _require_positive("The period of a chessboard", period)
    side = 64
    cells = np.indices((side, side)) // (side // 2)
    values = np.where(cells.sum(axis=0) % 2, high, low)
    return Texture(smooth(values, smoothing * side / period), period / side)


def stripes(
    period: float, *, mean: float = 0.5, contrast: float = 0.15, angle: bool = False
) -> Texture:
    """Return stripes whose brightness is a sine along X, or along Y.

    Parameters
    ----------
    period : float
        Period of the sine in pixels, positive.
    mean, contrast : float
        Mean and rms of the brightness, not clipped to 0..1.
    angle : bool
        True for a sine along Y, False along X.

    Returns
    -------
    Texture
        One period, shape (4, 32, 1), or (32, 4, 1) with ``angle``.

    Raises
    ------
    ValueError
        If the period is not positive, or a number is not finite.

    Examples
    --------
    >>> texture = clplen.cameras.stripes(8, contrast=0.1)
    >>> texture.samples.shape, texture.scale
    ((4, 32, 1), 0.25)
    >>> f"{texture.samples.std():.3f}"
    '0.100'
    """
    _require_positive("The period of stripes", period)
    check_finite(mean=mean, contrast=contrast)
    wave = mean + contrast * math.sqrt(2) * np.sin(2 * np.pi * np.arange(32) / 32)
    values = np.tile(wave, (4, 1))
    return Texture(values.T if angle else values, period / 32)


def bricks(
    seed: int,
    *,
    size: tuple[int, int] = (12, 30),
    mean: float = 0.5,
    contrast: float = 0.12,
    colour: bool = False,
    smoothing: float = DEFAULT_SMOOTHING,
) -> Texture:
    """Return a wall of bricks of random brightness with joints and grain, in running bond.

    Parameters
    ----------
    seed : int
        Seed of `numpy.random.default_rng`.
    size : tuple of int
        (height, length) of a brick in pixels, at least 4.
    mean, contrast : float
        Mean of the brightness, and its rms between bricks.
    colour : bool
        True for reddish bricks, False for grey bricks.
    smoothing : float
        Standard deviation of the smoothing Gaussian in pixels, as for `picture`.

    Returns
    -------
    Texture
        Wall with an even number of rows, one sample a pixel; three channels with ``colour``.

    Examples
    --------
    >>> wall = clplen.cameras.bricks(1, size=(20, 50), colour=True)
    >>> wall.samples.shape
    (400, 400, 3)
    >>> red, green, blue = wall.samples.mean(axis=(0, 1))
    >>> f"{green / red:.2f}, {blue / red:.2f}"
    '0.70, 0.55'
    """
    height, length = size
    if min(size) < _MIN_BRICK:
        raise ValueError(
            f"Bricks must be at least {_MIN_BRICK} pixels high and long, got {size!r}."
        )
    random = np.random.default_rng(seed)
    rows, columns = 2 * max(2, 200 // height), max(3, 400 // length)
    y, x = np.indices((rows * height, columns * length))
    row = y // height
    moved = (x + (row % 2) * (length // 2)) % (columns * length)
    level = mean + contrast * random.standard_normal((rows, columns))
    values = level[row, moved // length]
    values = values + contrast / 2 * random.standard_normal(values.shape)
    joint = (y % height < 2) | (moved % length < 2)
    values = np.clip(np.where(joint, mean + 2 * contrast, values), 0, 1)
    if colour:
        values = values[..., None] * np.array([1.0, 0.7, 0.55])
    return Texture(smooth(values, smoothing))


def _require_positive(what: str, value: float) -> None:
    if not (is_finite(value) and value > 0):
        raise ValueError(f"{what} must be a positive number of pixels, got {value!r}.")


def smooth(values: Any, sd: float) -> Any:
    """Smooth a periodic table by a Gaussian of a standard deviation in samples."""
    values = np.asarray(values, np.float64)
    if not (is_finite(sd) and sd >= 0):
        raise ValueError(f"smoothing must be a number >= 0, got {sd!r}.")
    if sd == 0:
        return values
    ny, nx = values.shape[:2]
    down = np.exp(-2 * (np.pi * sd * np.fft.fftfreq(ny)) ** 2)
    right = np.exp(-2 * (np.pi * sd * np.fft.rfftfreq(nx)) ** 2)
    gain = np.multiply.outer(down, right).reshape(ny, -1, *(1,) * (values.ndim - 2))
    spectrum = np.fft.rfft2(values, axes=(0, 1)) * gain
    return np.fft.irfft2(spectrum, s=(ny, nx), axes=(0, 1))
