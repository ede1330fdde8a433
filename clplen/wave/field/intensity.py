"""Intensities: sums and running means on a device, and means of partially coherent light."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, cast, runtime_checkable

import numpy as np
import pyopencl.array as cla

from clplen.checks import check_keywords, keywords_of
from clplen.compute.arrays import HostArray, Image
from clplen.compute.device import Device
from clplen.wave.field.field import Field, Grid, row_powers

Region = tuple[slice, slice]
Object = Field | Callable[[float], Field]  # transmission, or a function of the wavelength


@dataclass(frozen=True)
class Window:
    """Rectangle of pixels: rows y0 <= y < y1, columns x0 <= x < x1."""

    y0: int
    y1: int
    x0: int
    x1: int

    @classmethod
    def of(cls, region: Region | None, shape: tuple[int, int]) -> Window:
        """Return the pixels of a region, slices (rows, columns); None: all pixels."""
        parts = (slice(None), slice(None)) if region is None else region
        pair = isinstance(parts, tuple) and [type(part) for part in parts] == [slice, slice]
        if not pair or any(part.step not in (None, 1) for part in parts):
            raise ValueError(
                f"region must be two slices (rows, columns) without steps, got {region!r}."
            )
        (y0, y1, _), (x0, x1, _) = (p.indices(n) for p, n in zip(parts, shape, strict=True))
        if y1 <= y0 or x1 <= x0:
            raise ValueError(f"region must contain pixels of the image of {shape}, got {region!r}.")
        return cls(y0, y1, x0, x1)


def accumulate(total: cla.Array, fields: cla.Array, weights: Any, device: Device) -> None:
    """Add sum_b weights[b] abs(fields[b, y, x])^2 to total[y, x] on the device."""
    factors = np.atleast_1d(np.asarray(weights, device.real))
    kernel = device.kernel("intensity.cl", "accumulate", **device.wave_defines())
    sizes = (factors.size, *total.shape)
    device.launch_rows(kernel, total.shape, total, fields, device.upload(factors), *sizes)


def add_scaled(total: cla.Array, picture: cla.Array, weight: float, device: Device) -> None:
    """Add weight picture[y, x] to total[y, x] on the device; both are real with equal shape."""
    defines = {"DOUBLE": True} if total.dtype == np.float64 else {}
    kernel = device.kernel("intensity.cl", "add_scaled", **defines)
    scale = total.dtype.type(weight)
    device.launch_rows(kernel, total.shape, total, picture, scale, *total.shape)


class Statistics:
    """Mean and variance of the intensities of snapshots per pixel (Welford 1962).

    Attributes
    ----------
    mean, m2 : pyopencl.array.Array
        Mean so far, and sum of the squared deviations from it in units of ``unit`` squared.
    unit : float
        Power of two nearest to the mean of the first snapshot, which keeps squares in range.
    count : int
        Number of snapshots so far.
    """

    def __init__(self, shape: tuple[int, int], device: Device) -> None:
        self.shape, self.device = shape, device
        self.mean = device.zeros(shape, device.real)
        self.m2 = device.zeros(shape, device.real)
        self.count = 0
        self.unit = 1.0

    def add(self, snapshot: Field | cla.Array) -> None:
        """Add a snapshot: abs(u)^2 of a field, or an image; shape (ny, nx)."""
        self.count += 1
        device = self.device
        is_field = isinstance(snapshot, Field)
        data = snapshot.data if isinstance(snapshot, Field) else snapshot
        if self.count == 1:
            self.unit = _unit_of(snapshot, device)
        name = "add_field" if is_field else "add_image"
        kernel = device.kernel("statistics.cl", name, **device.wave_defines())
        numbers = (device.real.type(x) for x in (1 / self.count, 1 / self.unit))
        device.launch_rows(kernel, self.shape, self.mean, self.m2, data, *numbers, *self.shape)

    def restore(
        self, mean: np.ndarray[Any, Any], m2: np.ndarray[Any, Any], count: int, unit: float
    ) -> None:
        """Restore a downloaded state."""
        self.mean, self.m2 = self.device.upload(mean), self.device.upload(m2)
        self.count, self.unit = count, unit

    def image(self) -> Image:
        """Return the mean."""
        return Image(self.mean, self.device)

    def standard_error(self) -> Image:
        """Return the standard error of the mean, sqrt(variance/count); NaN below two snapshots."""
        k = self.count
        scale = 1 / (k * (k - 1)) if k > 1 else math.nan
        factors = (self.device.real.type(x) for x in (scale, self.unit))
        out = self.device.empty(self.shape, self.device.real)
        kernel = self.device.kernel("statistics.cl", "standard_error", **self.device.wave_defines())
        self.device.launch_rows(kernel, self.shape, out, self.m2, *factors, *self.shape)
        return Image(out, self.device)

    def relative_error(self, window: Window) -> float:
        """Return the rms standard error over the mean intensity in a window.

        It is NaN below two snapshots or without light.
        """
        device, rows = self.device, window.y1 - window.y0
        out = device.empty((rows, 2), device.real)
        kernel = device.kernel("statistics.cl", "row_sums", **device.wave_defines())
        sizes = (window.y0, window.x0, window.x1, rows, self.shape[1])
        device.launch(kernel, (rows,), out, self.mean, self.m2, *sizes)
        sums = device.download(out).sum(axis=0, dtype=np.float64)
        pixels, k = rows * (window.x1 - window.x0), self.count
        if k < 2 or sums[0] <= 0:
            return math.nan
        deviation = math.sqrt(sums[1] / pixels / (k * (k - 1))) * self.unit
        return deviation / (sums[0] / pixels)


def _unit_of(snapshot: Field | cla.Array, device: Device) -> float:
    """Return the power of two nearest to the mean intensity, or 1 without light."""
    if isinstance(snapshot, Field):
        mean = float(row_powers(snapshot).sum()) / math.prod(snapshot.grid.shape)
    else:
        mean = float(device.download(snapshot).mean(dtype=np.float64))
    return 2.0 ** round(math.log2(mean)) if 0 < mean < math.inf else 1.0


@dataclass(frozen=True, eq=False, repr=False)
class MeanIntensity(HostArray):
    """Mean intensity of partially coherent light, with its convergence.

    Attributes
    ----------
    intensity : Image
        Intensity, shape (ny, nx).
    standard_error : Image
        Standard error of each pixel's mean; 0 for exact results.
    snapshots : int
        Number of snapshots, or of terms of an exact sum.
    convergence : numpy.ndarray
        History, float64, shape (n, 2): number of snapshots, and rms standard error over mean
        intensity in the region. Empty for exact results.
    method : str
        Method: "monte-carlo", "abbe", "incoherent" or "coherent".
    grid : Grid
        Grid of the image.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> clear = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> square = clplen.wave.rectangular_aperture(clear, 105e-6)
    >>> light = clplen.Coherence(clplen.wave.RandomPhaseMask(40e-6))
    >>> image = light.average(clplen.wave.Space(0.01), square, snapshots=20)
    >>> image.method, image.snapshots, image.intensity.shape
    ('monte-carlo', 20, (32, 32))
    >>> f"standard error {image.relative_error:.1f} of the mean"
    'standard error 0.3 of the mean'
    """

    intensity: Image
    standard_error: Image
    snapshots: int
    convergence: np.ndarray[Any, np.dtype[np.float64]]
    method: str
    grid: Grid

    _downloads: ClassVar[bool] = True

    def __repr__(self) -> str:
        error = f", standard error {self.relative_error:.2%}" if len(self.convergence) else ""
        kind = "snapshot" if self.method == "monte-carlo" else "term"
        kind += "s" * (self.snapshots != 1)
        return f"<MeanIntensity {self.method}, {self.snapshots} {kind}{error}, {self.grid}>"

    @property
    def relative_error(self) -> float:
        """Final standard error over mean in the region; 0 for exact results."""
        return float(self.convergence[-1, 1]) if len(self.convergence) else 0.0

    def to_numpy(self) -> np.ndarray[Any, Any]:
        """Return the intensity on the host, shape (ny, nx)."""
        return self.intensity.to_numpy()


@runtime_checkable
class PartialCoherence(Protocol):
    """Light with a method `average`, such as `Coherence`."""

    def average(self, *arguments: Any, **keywords: Any) -> MeanIntensity:
        """Return the mean intensity behind a system whose object this light illuminates."""


AVERAGING = ("snapshots", "rtol", "region", "checkpoint", "progress", "method")


def check_averaging(
    averaging: dict[str, Any], coherence: Any, function: Callable[..., Any], what: str
) -> None:
    """Raise unless keywords belong to a function or to `Coherence.average`."""
    check_keywords(averaging, dict.fromkeys((*keywords_of(function), *AVERAGING)), what)
    if averaging and coherence is None:
        raise TypeError(f"{', '.join(averaging)} require coherence=, since they set an average.")


def average_of(coherence: Any) -> Callable[..., Any]:
    """Return the method `average` of a coherence argument."""
    average = getattr(coherence, "average", None)
    if average is None or isinstance(coherence, type):
        raise TypeError(
            "coherence must be a Coherence, such as Coherence(RandomPhaseMask(40e-6)), got "
            f"{coherence!r}."
        )
    return cast(Callable[..., Any], average)
