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
LARGEST_SIDE = 8192
_LEAST_BRICK = 4  # pixels
SMOOTHING = 0.6  # pixels; what is left at half a cycle a pixel is 17 %


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Texture(OneLine, HostArray):
    """The brightness of a surface over (Y, X), the pixels of the centre view.

    A periodic cubic B-spline through a table (Unser, Aldroubi and Eden 1993), twice continuously
    differentiable. It is the brightness as pixels see it, averaged over them already: every view
    takes it at the centres of its pixels, so that views of one disparity are exact shifts of each
    other. A table without structure beyond about 0.35 cycles a pixel leaves no aliasing that moves
    what is measured between pixels.

    Parameters
    ----------
    samples : array_like
        Shape (ny, nx) or (ny, nx, 3), finite; 0 is black, 1 white. The table's middle lies at
        ``centre``, and it repeats itself.
    scale : float
        Pixels from sample to sample, positive.
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.

    Attributes
    ----------
    samples : numpy.ndarray
        float32, shape (ny, nx, 1) or (ny, nx, 3).
    scale : float
        As given.
    centre : tuple of float
        As given.

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
                f"A texture has shape (ny, nx) or (ny, nx, 3), not {np.shape(samples)}."
            )
        if max(values.shape[:2]) > LARGEST_SIDE:
            raise ShapeError(f"A texture has at most {LARGEST_SIDE} samples a side.")
        if not np.isfinite(values).all():
            raise ValueError("The samples of a texture are finite.")
        if not (fits_float64(scale) and scale > 0):
            raise ValueError(f"The scale of a texture is positive, in pixels, not {scale!r}.")
        if not np.isfinite(centre).all():
            raise ValueError(f"The centre of a texture is finite, in pixels, not {centre!r}.")
        object.__setattr__(self, "samples", values)
        object.__setattr__(self, "scale", float(scale))
        object.__setattr__(self, "centre", (float(centre[0]), float(centre[1])))

    @property
    def channels(self) -> int:
        """1 or 3."""
        return int(self.samples.shape[2])

    def coefficients(self, channels: int) -> Samples:
        """Of the B-spline that passes through the samples, float32, shape (ny, nx, channels).

        By division of the spectrum by (2 + cos w)/3 along each axis (Unser 1999, box 2).
        """
        values = spline_coefficients(self.samples).astype(np.float32)
        return np.ascontiguousarray(np.broadcast_to(values, (*values.shape[:2], channels)))


def spline_coefficients(samples: Any) -> Any:
    """Of the periodic cubic B-spline through samples, a symmetric linear map."""
    ny, nx = np.shape(samples)[:2]
    spectrum = np.fft.rfft2(np.asarray(samples, np.float64), axes=(0, 1))
    for axis, f in ((0, np.fft.fftfreq(ny)), (1, np.fft.rfftfreq(nx))):
        spectrum /= np.expand_dims((2 + np.cos(2 * np.pi * f)) / 3, (1 - axis, 2))
    return np.fft.irfft2(spectrum, s=(ny, nx), axes=(0, 1))


def uniform(level: float | tuple[float, float, float] = 0.5) -> Texture:
    """Return a texture of the same brightness everywhere.

    Parameters
    ----------
    level : float or tuple of float
        Brightness, 0 black, 1 white; three numbers are a colour.

    Returns
    -------
    Texture
        Of one sample, shape (1, 1, 1), or (1, 1, 3) for a colour.

    Raises
    ------
    ShapeError
        If there are neither one number nor three.
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
    """Make band-limited Gaussian noise with an amplitude spectrum f^-exponent.

    Parameters
    ----------
    seed : int
        Of `numpy.random.default_rng`.
    side : int
        Samples a side, one a pixel, at least 4; the period of the texture.
    mean, contrast : float
        Mean and rms of the brightness; what leaves 0..1 is clipped.
    exponent : float
        0 white, 1 as natural pictures have (Field 1987).
    finest, coarsest : float
        The band, in cycles a pixel, 0 <= coarsest < finest <= 1/2.
    colour : bool
        Three channels, half of each of its own.

    Returns
    -------
    Texture
        Shape (side, side, 1), or (side, side, 3) with ``colour``.

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
            f"Noise has a side of 4 or more and 0 <= coarsest < finest <= 0.5 cycles a pixel, not "
            f"side {side}, {coarsest!r} and {finest!r}."
        )
    check_finite(mean=mean, contrast=contrast, exponent=exponent)
    fy, fx = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :]
    f = np.hypot(fy, fx)
    band = (f >= coarsest) & (f <= finest) & (f > 0)
    if not band.any():
        raise ValueError(
            f"A side of {side} samples has no frequency from {coarsest} to {finest}: take more."
        )
    weight = np.where(band, np.where(f > 0, f, 1) ** -exponent, 0)
    random = np.random.default_rng(seed)
    planes = [_one_noise(random, weight, side) for _ in range(4 if colour else 1)]
    if colour:
        own = [(planes[0] + planes[c]) / math.sqrt(2) for c in (1, 2, 3)]
        return Texture(np.clip(mean + contrast * np.stack(own, axis=-1), 0, 1))
    return Texture(np.clip(mean + contrast * planes[0], 0, 1))


def _one_noise(random: np.random.Generator, weight: Any, side: int) -> Any:
    """Noise of a spectrum's weights, mean 0, rms 1."""
    white = np.fft.rfft2(random.standard_normal((side, side)))
    values = np.fft.irfft2(white * weight, s=(side, side))
    return values / values.std()


def picture(image: Any, *, scale: float = 1.0, smoothing: float = SMOOTHING) -> Texture:
    """Make a texture of a picture, smoothed, and mirrored at its edges to repeat without a seam.

    Parameters
    ----------
    image : array_like
        Shape (ny, nx) or (ny, nx, 3); integers are divided by the largest of their type, other
        numbers are taken as they are (0 black, 1 white).
    scale : float
        Pixels from sample to sample, positive.
    smoothing : float
        Standard deviation in pixels of the Gaussian that it is smoothed with; 0 leaves it.

    Returns
    -------
    Texture
        Shape (2 ny, 2 nx, 1) or (2 ny, 2 nx, 3).

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
        raise ShapeError(f"A picture has shape (ny, nx) or (ny, nx, 3), not {values.shape}.")
    for axis in (0, 1):
        values = np.concatenate([values, np.flip(values, axis)], axis)
    return Texture(smoothed(values, smoothing / scale), scale)


def checker(
    period: float, *, low: float = 0.2, high: float = 0.8, smoothing: float = SMOOTHING
) -> Texture:
    """Make a chessboard of squares of half a period, its edges smoothed by a Gaussian.

    Parameters
    ----------
    period : float
        Two squares side by side, in pixels, positive.
    low, high : float
        Brightness of the dark and of the bright squares, 0 black, 1 white.
    smoothing : float
        Standard deviation of the Gaussian in pixels; 0 leaves the edges as they are.

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
    return Texture(smoothed(values, smoothing * side / period), period / side)


def stripes(
    period: float, *, mean: float = 0.5, contrast: float = 0.15, angle: bool = False
) -> Texture:
    """Make stripes whose brightness is a sine along X, or along Y.

    Parameters
    ----------
    period : float
        Of the sine in pixels, positive.
    mean, contrast : float
        Mean and rms of the brightness, which is not clipped to 0..1.
    angle : bool
        Whether the brightness varies along Y, not along X.

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
    smoothing: float = SMOOTHING,
) -> Texture:
    """Make a wall of bricks of random brightness with joints and fine grain, in running bond.

    Parameters
    ----------
    seed : int
        Of `numpy.random.default_rng`.
    size : tuple of int
        (height, length) of a brick in pixels, at least 4.
    mean, contrast : float
        Mean, and rms from brick to brick, of the brightness.
    colour : bool
        Reddish instead of grey.
    smoothing : float
        Standard deviation in pixels of the Gaussian that it is smoothed with, as for `picture`.

    Returns
    -------
    Texture
        Of an even number of rows of bricks, one sample a pixel; three channels with ``colour``.

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
    if min(size) < _LEAST_BRICK:
        raise ValueError(f"Bricks are at least {_LEAST_BRICK} pixels high and long, not {size!r}.")
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
    return Texture(smoothed(values, smoothing))


def _require_positive(what: str, value: float) -> None:
    if not (is_finite(value) and value > 0):
        raise ValueError(f"{what} is a positive number of pixels, not {value!r}.")


def smoothed(values: Any, sd: float) -> Any:
    """A periodic table smoothed by a Gaussian of a standard deviation in samples."""
    values = np.asarray(values, np.float64)
    if not (is_finite(sd) and sd >= 0):
        raise ValueError(f"smoothing is 0 or a positive number, not {sd!r}.")
    if sd == 0:
        return values
    ny, nx = values.shape[:2]
    down = np.exp(-2 * (np.pi * sd * np.fft.fftfreq(ny)) ** 2)
    right = np.exp(-2 * (np.pi * sd * np.fft.rfftfreq(nx)) ** 2)
    gain = np.multiply.outer(down, right).reshape(ny, -1, *(1,) * (values.ndim - 2))
    spectrum = np.fft.rfft2(values, axes=(0, 1)) * gain
    return np.fft.irfft2(spectrum, s=(ny, nx), axes=(0, 1))
