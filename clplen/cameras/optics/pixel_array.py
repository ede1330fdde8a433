"""Pixels of a sensor: where they lie, and the sums of light over their active areas."""

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

TAPS = 10  # samples of the field's intensity beyond a pixel that its sum takes in
SHAPE = 8.0  # of Kaiser's window over the interpolation


@dataclass(frozen=True, kw_only=True, repr=False)
class PixelArray(OneLine):
    """The pixels of a sensor, which integrate the light that falls on their active area.

    Parameters
    ----------
    fill_factor : float
        Active share of a pixel's area, a square about its middle, from 0 to 1. 0 takes the
        intensity in the middle for the whole pixel.
    pitch : float, optional
        Of the pixels in metres; None: that of the lenslets over ``pixels_per_lenslet``.
    shape : tuple of int, optional
        Pixels (ny, nx); None: as many as cover the array of lenslets.
    offset : tuple of float
        (y, x) of the middle of the sensor from the optical axis, in metres.
    rotation : float
        Of the pixels' rows against the axes of the array of lenslets, in radians; positive turns
        +x towards +y (y down). The axes of a scene are those of the pixels.
    crosstalk : array_like, optional
        Shares of a pixel's signal that itself and its neighbours read, odd counts (ny, nx), not
        negative, with the sum 1 or less. With filters, what leaks from a pixel has its colour.
    filters : ColorFilterArray, optional
        Colour filters over the pixels and the sensitivity behind them: the raw image is then their
        signal for the light's wavelengths. None: the energy of the light.

    Raises
    ------
    ValueError
        For a value outside its range.
    TypeError
        If filters are no `ColorFilterArray`.

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
                f"fill_factor is the active share of a pixel's area, 0 to 1, not "
                f"{self.fill_factor!r}."
            )
        if self.pitch is not None:
            if not (is_finite(self.pitch) and self.pitch > 0):
                raise ValueError(f"The pitch of pixels is positive, in metres, not {self.pitch!r}.")
            units.PIXEL_PITCH.check(self.pitch, "The pitch of pixels")
        if self.shape is not None:
            counts = np.ravel(np.asarray(self.shape, object))
            if counts.size != 2 or not all(is_integer(n) and n >= 1 for n in counts):
                raise ValueError(f"shape is pixels (ny, nx), both 1 or more, not {self.shape!r}.")
            object.__setattr__(self, "shape", (int(counts[0]), int(counts[1])))
        if np.shape(self.offset) != (2,) or not all(map(is_finite, self.offset)):
            raise ValueError(
                f"offset is (y, x) in metres, two finite numbers, not {self.offset!r}."
            )
        units.OFFSET.check(self.offset, "The offset of the sensor")
        object.__setattr__(self, "offset", (float(self.offset[0]), float(self.offset[1])))
        if not is_finite(self.rotation):
            raise ValueError(f"rotation is a finite angle in radians, not {self.rotation!r}.")
        if self.crosstalk is not None:
            object.__setattr__(self, "crosstalk", _shares(self.crosstalk))
        if self.filters is not None and not isinstance(self.filters, ColorFilterArray):
            raise TypeError(
                f"filters is a ColorFilterArray, such as ColorFilterArray.bayer('RGGB'), not "
                f"{self.filters!r}."
            )

    @property
    def active(self) -> float:
        """Side of the active square over the pitch."""
        return math.sqrt(self.fill_factor)

    def turned(self, mla: MicrolensArray) -> MicrolensArray:
        """An array of lenslets as it lies along the axes of the pixels."""
        if self.rotation == 0:
            return mla
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        y, x = mla.offset
        offset = (y * cos - x * sin, x * cos + y * sin)
        return mla.replaced(rotation=mla.rotation - self.rotation, offset=offset)

    def unturned(self, mla: MicrolensArray) -> MicrolensArray:
        """The inverse of `turned`: the array along its own axes."""
        return PixelArray(rotation=-self.rotation).turned(mla)

    @classmethod
    def from_json(cls, text: str) -> PixelArray:
        """Pixels as `to_json` wrote them.

        Raises
        ------
        ValueError
            If the text is none.
        """
        try:
            values = json.loads(text)
            if values.get("filters") is not None:
                values["filters"] = ColorFilterArray.from_json(values["filters"])
            return cls(**values)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"pixels are none: {error}") from error

    def to_json(self) -> str:
        """As text, all digits kept."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        if self.filters is not None:
            values["filters"] = self.filters.to_json()
        return json.dumps(values)

    def read(self, image: Values) -> Values:
        """An image of pixels with their crosstalk.

        Parameters
        ----------
        image : numpy.ndarray
            Shape (ny, nx).

        Returns
        -------
        numpy.ndarray
            Of the same shape; what beyond the rim would give is missing.
        """
        if self.crosstalk is None:
            return image
        return _correlated(image, np.asarray(self.crosstalk)[::-1, ::-1])

    def read_adjoint(self, image: Values) -> Values:
        """The transpose of `read`: what of an image each pixel without crosstalk has a share in.

        Parameters
        ----------
        image : numpy.ndarray
            Shape (ny, nx).

        Returns
        -------
        numpy.ndarray
            Of the same shape.
        """
        if self.crosstalk is None:
            return image
        return _correlated(image, np.asarray(self.crosstalk))


def _correlated(image: Values, kernel: Values) -> Values:
    from scipy import ndimage  # a slow import

    return np.asarray(ndimage.correlate(image, kernel, mode="constant"))


def _shares(crosstalk: Any) -> tuple[tuple[float, ...], ...]:
    """A kernel of crosstalk, checked."""
    try:
        values = real_array(crosstalk, "crosstalk", np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"crosstalk is numbers in rows of one length, not {crosstalk!r}."
        ) from None
    if values.ndim != 2 or any(n % 2 == 0 for n in values.shape):
        raise ValueError(
            f"crosstalk has an odd number of rows and of columns, such as (3, 3), not "
            f"{values.shape}."
        )
    if not (np.isfinite(values).all() and (values >= 0).all() and values.sum() <= 1 + 1e-9):
        raise ValueError(
            f"The shares of crosstalk are not negative and their sum is 1 or less, not "
            f"{values.sum():g}."
        )
    return tuple(tuple(float(share) for share in row) for row in values)


def pixel_weights(width: float) -> Values:
    """Factors of an intensity's samples whose sum is its integral over a width.

    Of the samples -n..n about the middle of the active width: the integral of sinc times Kaiser's
    window, scaled so that a constant is integrated exactly.
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
    places = (middle[:, None] + half[:, None] * x).ravel()
    areas = (half[:, None] * w).ravel()
    apart = places[:, None] - np.arange(-n, n + 1)
    root = np.sqrt(np.maximum(1 - (apart / TAPS) ** 2, 0))
    kernel = np.sinc(apart) * np.i0(SHAPE * root) / np.i0(SHAPE) * (np.abs(apart) < TAPS)
    sums = areas @ kernel
    return np.asarray(sums * (width / sums.sum()))


@dataclass(frozen=True)
class PixelSums:
    """Where the pixels of a patch lie among samples of the field, and where on the sensor."""

    first: tuple[int, int]  # sample (y, x) in the middle of the patch's first pixel
    step: int  # samples from pixel to pixel
    # of the active square in samples; 0 takes the sample in the middle for the whole pixel
    width: float
    place: tuple[int, int]  # pixel (y, x) of the sensor that is the patch's first
    shape: tuple[int, int]  # pixels (y, x) of the patch

    def put(
        self, total: cla.Array, fields: cla.Array, number: int, gain: Any, device: Device
    ) -> None:
        """Add abs(U)^2 times ``gain`` of one of several fields to the pixels of an image."""
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
            *(np.int32(n) for n in (*tile.shape, *self.place, total.shape[-1], down, across)),
        )  # fmt: skip

    def sums(self, values: Values) -> Values:
        """What `put` adds of real samples in place of abs(U)^2, with gain 1, on the host."""
        weights, found = pixel_weights(self.width), np.asarray(values, np.float64)
        for axis in (0, 1):
            first, along = self.first[axis] - len(weights) // 2, np.moveaxis(found, axis + 1, 0)
            taps = [along[first + j :: self.step][: self.shape[axis]] for j in range(len(weights))]
            summed = sum(weight * tap for weight, tap in zip(weights, taps, strict=True))
            found = np.moveaxis(np.asarray(summed), 0, axis + 1)
        return np.ascontiguousarray(found)

    def spread(self, image: Values, shape: tuple[int, int]) -> Values:
        """The transpose of `put` as a map of abs(U)^2, with gain 1."""
        weights, (down, across) = pixel_weights(self.width), self.shape
        y, x = self.place
        found = np.asarray(image, np.float64)[y : y + down, x : x + across]
        for axis in (0, 1):
            along = np.moveaxis(found, axis, 0)
            wide = np.zeros((shape[axis], *along.shape[1:]))
            first = self.first[axis] - len(weights) // 2
            for j, weight in enumerate(weights):
                wide[first + j :: self.step][: self.shape[axis]] += weight * along
            found = np.moveaxis(wide, 0, axis)
        return np.ascontiguousarray(found)
