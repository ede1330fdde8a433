"""Pixels of a sensor: their positions, and sums of light over their active areas."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen import units
from clplen.cameras.optics.color_filters import ColorFilterArray
from clplen.checks import is_finite, is_integer, real_array
from clplen.compute.device import Device
from clplen.reprs import OneLine
from clplen.wave.elements.lenslets import MicrolensArray

Values = np.ndarray[Any, np.dtype[np.float64]]
Pair = tuple[float, float]

TAPS = 10  # samples of the field's intensity beyond a pixel in its sum
KAISER_BETA = 8.0  # parameter of the interpolation's Kaiser window


@dataclass(frozen=True, kw_only=True, repr=False)
class PixelArray(OneLine):
    """Pixels of a sensor that integrate the light on their active area.

    Parameters
    ----------
    fill_factor : float
        Active fraction of a pixel's area, a square about its middle, from 0 to 1. 0 samples the
        intensity in the middle for the whole pixel.
    pitch : float, optional
        Pixel pitch in metres; None: lenslet pitch over ``pixels_per_lenslet``.
    shape : tuple of int, optional
        Pixels (ny, nx); None: as many as cover the array of lenslets.
    offset : tuple of float
        (y, x) of the middle of the sensor from the optical axis, in metres.
    rotation : float
        Angle of the pixels' rows against the axes of the array of lenslets, in radians; positive
        turns +x towards +y (y down). The axes of a scene are those of the pixels.
    crosstalk : array_like, optional
        Fractions of a pixel's signal that the pixel and its neighbours record: odd counts (ny, nx),
        not negative, sum 1 or less. With filters, the signal keeps the colour of its pixel.
    filters : ColorFilterArray, optional
        Colour filters over the pixels with their sensitivities; the raw image is then the signal
        behind them. None: the raw image is the energy of the light.

    Raises
    ------
    ValueError
        If a value is outside its range.
    TypeError
        If ``filters`` is not a `ColorFilterArray`.

    Examples
    --------
    >>> pixels = clplen.cameras.PixelArray(pitch=5e-6, fill_factor=0.8)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels=pixels)
    >>> round(camera.pixels_per_lenslet, 6), camera.grid.shape
    (30.0, (150, 150))
    """

    fill_factor: float = 1.0
    pitch: float | None = None
    shape: tuple[int, int] | None = None
    offset: Pair = (0.0, 0.0)
    rotation: float = 0.0
    crosstalk: tuple[tuple[float, ...], ...] | None = None
    filters: ColorFilterArray | None = None

    def __post_init__(self) -> None:
        if not (is_finite(self.fill_factor) and 0 <= self.fill_factor <= 1):
            raise ValueError(
                f"fill_factor, the active fraction of a pixel, must be 0 to 1, got "
                f"{self.fill_factor!r}."
            )
        if self.pitch is not None:
            if not (is_finite(self.pitch) and self.pitch > 0):
                raise ValueError(f"pitch must be > 0, in metres, got {self.pitch!r}.")
            units.PIXEL_PITCH.check(self.pitch, "The pitch of pixels")
        if self.shape is not None:
            counts = np.ravel(np.asarray(self.shape, object))
            if counts.size != 2 or not all(is_integer(n) and n >= 1 for n in counts):
                raise ValueError(f"shape must be pixels (ny, nx), both >= 1, got {self.shape!r}.")
            object.__setattr__(self, "shape", (int(counts[0]), int(counts[1])))
        if np.shape(self.offset) != (2,) or not all(map(is_finite, self.offset)):
            raise ValueError(
                f"offset must be (y, x) in metres, two finite numbers, got {self.offset!r}."
            )
        units.OFFSET.check(self.offset, "The offset of the sensor")
        object.__setattr__(self, "offset", (float(self.offset[0]), float(self.offset[1])))
        if not is_finite(self.rotation):
            raise ValueError(f"rotation must be a finite angle in radians, got {self.rotation!r}.")
        if self.crosstalk is not None:
            object.__setattr__(self, "crosstalk", _shares(self.crosstalk))
        if self.filters is not None and not isinstance(self.filters, ColorFilterArray):
            raise TypeError(
                f"filters must be a ColorFilterArray, such as ColorFilterArray.bayer('RGGB'), got "
                f"{self.filters!r}."
            )

    @property
    def active(self) -> float:
        """Side of the active square over the pitch."""
        return math.sqrt(self.fill_factor)

    def turned(self, mla: MicrolensArray) -> MicrolensArray:
        """Rotate an array of lenslets into the axes of the pixels."""
        if self.rotation == 0:
            return mla
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        y, x = mla.offset
        offset = (y * cos - x * sin, x * cos + y * sin)
        return mla.replaced(rotation=mla.rotation - self.rotation, offset=offset)

    def unturned(self, mla: MicrolensArray) -> MicrolensArray:
        """Rotate an array of lenslets back into its own axes, the inverse of `turned`."""
        return PixelArray(rotation=-self.rotation).turned(mla)

    @classmethod
    def from_json(cls, text: str) -> PixelArray:
        """Read pixels that `to_json` wrote.

        Raises
        ------
        ValueError
            If the text is not valid.
        """
        try:
            values = json.loads(text)
            if values.get("filters") is not None:
                values["filters"] = ColorFilterArray.from_json(values["filters"])
            return cls(**values)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"pixels must be a text of PixelArray.to_json: {error}") from error

    def to_json(self) -> str:
        """Return the pixels as JSON with all digits."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        if self.filters is not None:
            values["filters"] = self.filters.to_json()
        return json.dumps(values)

    def read(self, image: Values) -> Values:
        """Apply the crosstalk to an image.

        Parameters
        ----------
        image : numpy.ndarray
            Signals without crosstalk, shape (ny, nx).

        Returns
        -------
        numpy.ndarray
            Signals of equal shape; pixels beyond the rim contribute nothing.
        """
        if self.crosstalk is None:
            return image
        return _correlate(image, np.asarray(self.crosstalk)[::-1, ::-1])

    def read_adjoint(self, image: Values) -> Values:
        """Apply the transpose of `read` to an image.

        Parameters
        ----------
        image : numpy.ndarray
            Weights of the signals, shape (ny, nx).

        Returns
        -------
        numpy.ndarray
            Weights of the signals without crosstalk, of equal shape.
        """
        if self.crosstalk is None:
            return image
        return _correlate(image, np.asarray(self.crosstalk))


def _correlate(image: Values, kernel: Values) -> Values:
    from scipy import ndimage  # a slow import

    return np.asarray(ndimage.correlate(image, kernel, mode="constant"))


def _shares(crosstalk: Any) -> tuple[tuple[float, ...], ...]:
    """Return a checked kernel of crosstalk."""
    try:
        values = real_array(crosstalk, "crosstalk", np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"crosstalk must be numbers in rows of equal length, got {crosstalk!r}."
        ) from None
    if values.ndim != 2 or any(n % 2 == 0 for n in values.shape):
        raise ValueError(
            f"crosstalk must have odd numbers of rows and columns, such as (3, 3), got "
            f"{values.shape}."
        )
    if not (np.isfinite(values).all() and (values >= 0).all() and values.sum() <= 1 + 1e-9):
        raise ValueError(
            f"crosstalk must be >= 0 with a sum of 1 or less, got a sum of {values.sum():g}."
        )
    return tuple(tuple(float(share) for share in row) for row in values)


def pixel_weights(width: float) -> Values:
    """Compute weights of an intensity's samples whose sum is its integral over a width.

    They belong to samples -n..n about the middle of the active width: the integral of a sinc times
    Kaiser's window, scaled so that a constant is integrated exactly.
    """
    return _weights(float(width)).copy()


@lru_cache(maxsize=64)
def _weights(width: float) -> Values:
    if width == 0:
        return np.ones(1)
    n = math.ceil(width / 2 + TAPS)
    count = 32 * math.ceil(width)
    x, w = np.polynomial.legendre.leggauss(8)
    edges = np.linspace(-width / 2, width / 2, count // 8 + 1)
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    positions = (middle[:, None] + half[:, None] * x).ravel()
    areas = (half[:, None] * w).ravel()
    apart = positions[:, None] - np.arange(-n, n + 1)
    root = np.sqrt(np.maximum(1 - (apart / TAPS) ** 2, 0))
    kernel = (
        np.sinc(apart) * np.i0(KAISER_BETA * root) / np.i0(KAISER_BETA) * (np.abs(apart) < TAPS)
    )
    sums = areas @ kernel
    return np.asarray(sums * (width / sums.sum()))


@dataclass(frozen=True)
class PixelSums:
    """Positions of a patch's pixels among samples of the field and on the sensor."""

    first: tuple[int, int]  # sample (y, x) in the middle of the patch's first pixel
    step: int  # samples from pixel to pixel
    # side of the active square in samples; 0 takes the sample in the middle for the whole pixel
    width: float
    pixel: tuple[int, int]  # pixel (y, x) of the sensor at the patch's first pixel
    shape: tuple[int, int]  # pixels (y, x) of the patch

    def put(
        self, total: cla.Array, fields: cla.Array, number: int, gain: Any, device: Device
    ) -> None:
        """Add abs(U)^2 times ``gain`` of a field of a batch to the pixels of an image."""
        if min(self.shape) < 1:
            return
        weights = pixel_weights(self.width)
        reach = len(weights) // 2
        ny, nx = fields.shape[-2:]
        down, across = self.shape
        rows = device.empty((ny, across), device.real)
        taps = device.upload(weights.astype(device.real))
        defines = device.wave_defines()
        numbers = (len(weights), self.first[1] - reach, self.step, number, ny, nx, across)
        device.launch_rows(
            device.kernel("pixels.cl", "pixel_rows", **defines),
            (ny, across), rows, fields, taps, *(np.int32(n) for n in numbers),
        )  # fmt: skip
        tile = np.ascontiguousarray(np.atleast_2d(gain), device.real)
        device.launch_rows(
            device.kernel("pixels.cl", "pixel_columns", **defines),
            (down, across), total, rows, taps,
            np.int32(len(weights)), np.int32(self.first[0] - reach), np.int32(self.step),
            device.upload(tile),
            *(np.int32(n) for n in (*tile.shape, *self.pixel, total.shape[-1], down, across)),
        )  # fmt: skip

    def sums(self, values: Values) -> Values:
        """Sum real samples, in place of abs(U)^2, as `put` with gain 1, on the host."""
        weights, totals = pixel_weights(self.width), np.asarray(values, np.float64)
        for axis in (0, 1):
            first, along = (
                self.first[axis] - len(weights) // 2,
                np.moveaxis(totals, axis + 1, 0),
            )
            taps = [along[first + j :: self.step][: self.shape[axis]] for j in range(len(weights))]
            summed = sum(weight * tap for weight, tap in zip(weights, taps, strict=True))
            totals = np.moveaxis(np.asarray(summed), 0, axis + 1)
        return np.ascontiguousarray(totals)

    def spread(self, image: Values, shape: tuple[int, int]) -> Values:
        """Apply the transpose of `put`, as a map of abs(U)^2, with gain 1."""
        weights, (down, across) = pixel_weights(self.width), self.shape
        y, x = self.pixel
        spread = np.asarray(image, np.float64)[y : y + down, x : x + across]
        for axis in (0, 1):
            along = np.moveaxis(spread, axis, 0)
            wide = np.zeros((shape[axis], *along.shape[1:]))
            first = self.first[axis] - len(weights) // 2
            for j, weight in enumerate(weights):
                wide[first + j :: self.step][: self.shape[axis]] += weight * along
            spread = np.moveaxis(wide, 0, axis)
        return np.ascontiguousarray(spread)
