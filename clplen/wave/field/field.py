"""Sampling grids and complex scalar fields on a device."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, ClassVar

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen import units
from clplen.checks import host_array, is_integer, require
from clplen.compute.arrays import Image, OnDevice, count_bad
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import ShapeError
from clplen.results import Plottable
from clplen.units import both, metres

Vector = np.ndarray[Any, np.dtype[np.floating[Any]]]
MAX_INDEX = 10.0  # of a medium; larger values are mistaken units


@dataclass(frozen=True, init=False)
class Grid:
    """Positions of the samples of a field.

    Sample i of an axis of N samples is at ``origin + (i - N//2) pitch``, for even and odd N.

    Parameters
    ----------
    shape : tuple of int
        Numbers of samples (ny, nx), each at least 1. A field does not vary along an axis of length
        1 (the cylindrical problem): the axis is never padded and carries no frequency.
    pitch : float or tuple of float
        Sample spacing in metres, (dy, dx) or a single number for both; at most 1 m.
    origin : tuple of float, optional
        Coordinates (y, x) of sample N//2 in metres. Half a pitch centres an even grid on the axis.

    Attributes
    ----------
    shape : tuple of int
        Numbers of samples (ny, nx).
    pitch : tuple of float
        Sample spacing (dy, dx) in metres.
    origin : tuple of float
        Coordinates (y, x) of sample N//2 in metres.

    Raises
    ------
    ShapeError
        If the shape is not two positive integers.
    ValueError
        If a pitch is not positive, finite and at most 1 m, or an origin is not finite.

    Examples
    --------
    >>> grid = clplen.Grid((64, 128), 5e-6)
    >>> [f"{1e6 * length:.0f} um" for length in grid.extent]
    ['320 um', '640 um']
    >>> grid.y.shape, f"{1e6 * grid.x[0]:.0f} um", f"{grid.x[64]:.0f} m"
    ((64,), '-320 um', '0 m')
    """

    shape: tuple[int, int]
    pitch: tuple[float, float]
    origin: tuple[float, float]

    def __init__(
        self,
        shape: tuple[int, int],
        pitch: float | tuple[float, float],
        *,
        origin: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        sizes = tuple(shape) if np.ndim(shape) == 1 else ()
        if len(sizes) != 2 or not all(is_integer(n) and n >= 1 for n in sizes):
            raise ShapeError(f"shape must be two positive integers (ny, nx), got {shape!r}.")
        pitches, origins = _pair(pitch), _pair(origin)
        if not (np.isfinite(pitches).all() and (pitches > 0).all()):
            raise ValueError(f"pitch must be positive and finite, in metres, got {pitch!r}.")
        units.PITCH.check(pitch, "A grid's pitch")
        if not np.isfinite(origins).all():
            raise ValueError(f"origin must be finite, in metres, got {origin!r}.")
        units.DISTANCE.check(origin, "A grid's origin")
        self._set((sizes[0], sizes[1]), (pitches[0], pitches[1]), (origins[0], origins[1]))

    @property
    def y(self) -> Vector:
        """Coordinates of the rows in metres, shape (ny,)."""
        return self._axis(0)

    @property
    def x(self) -> Vector:
        """Coordinates of the columns in metres, shape (nx,)."""
        return self._axis(1)

    @property
    def fy(self) -> Vector:
        """Spatial frequencies of the rows in cycles per metre, FFT order, shape (ny,)."""
        return np.fft.fftfreq(self.shape[0], self.pitch[0])

    @property
    def fx(self) -> Vector:
        """Spatial frequencies of the columns in cycles per metre, FFT order, shape (nx,)."""
        return np.fft.fftfreq(self.shape[1], self.pitch[1])

    @property
    def extent(self) -> tuple[float, float]:
        """Width of the window in metres, (ny dy, nx dx)."""
        return (self.shape[0] * self.pitch[0], self.shape[1] * self.pitch[1])

    def _set(
        self, shape: tuple[int, int], pitch: tuple[float, float], origin: tuple[float, float]
    ) -> None:
        object.__setattr__(self, "shape", (int(shape[0]), int(shape[1])))
        object.__setattr__(self, "pitch", (float(pitch[0]), float(pitch[1])))
        object.__setattr__(self, "origin", (float(origin[0]), float(origin[1])))

    def _axis(self, axis: int) -> Vector:
        n = self.shape[axis]
        return self.origin[axis] + (np.arange(n) - n // 2) * self.pitch[axis]


def derived_grid(
    shape: tuple[int, int],
    pitch: tuple[float, float],
    origin: tuple[float, float] = (0.0, 0.0),
) -> Grid:
    """Return a grid derived from others, with any pitch, such as a far field or frequencies."""
    grid = object.__new__(Grid)
    grid._set(shape, pitch, origin)
    return grid


def _pair(values: Any) -> Vector:
    """Return a number or a pair as a pair, with NaN for anything else."""
    try:
        return np.broadcast_to(np.asarray(values, dtype=np.float64), (2,))
    except (TypeError, ValueError, OverflowError):
        return np.full(2, np.nan)


@dataclass(frozen=True, eq=False, repr=False)
class Field(Plottable, OnDevice):
    """Complex scalar field on a grid, returned by `from_array` or by an operation.

    The time factor is exp(-i omega t), so that a wave towards +z is exp(+ikz). Every propagation
    omits the carrier exp(ikz), which is constant over the field.

    Attributes
    ----------
    data : pyopencl.array.Array
        Samples, complex64 (complex128 on a device of double precision), shape (..., ny, nx).
    grid : Grid
        Positions of the samples.
    wavelength : float
        Wavelength in vacuum, in metres.
    device : Device
        Device that holds the samples.
    index : float
        Refractive index of the medium, real and at least 1.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> spot = np.exp(-(grid.x**2 + grid.y[:, None] ** 2) / (100e-6) ** 2)
    >>> field = clplen.Field.from_array(spot, grid, wavelength=500e-9)
    >>> field.shape, f"{field.power():.3e}"  # pi w^2/2 = 1.571e-08
    ((64, 64), '1.571e-08')
    >>> clplen.propagate(field, 0.01).intensity()
    <Image (64, 64) float32, ...>
    """

    _figure: ClassVar[str] = "intensity"

    data: cla.Array
    grid: Grid
    wavelength: float
    device: Device
    index: float = 1.0

    @classmethod
    def from_array(
        cls,
        u: Any,
        grid: Grid,
        *,
        wavelength: float,
        device: DeviceLike | None = None,
        index: float = 1.0,
    ) -> Field:
        """Return the field of complex amplitudes on the host.

        Parameters
        ----------
        u : array_like
            Amplitudes, real or complex, shape (..., ny, nx); leading axes are a batch.
        grid : Grid
            Grid with the shape of the last two axes.
        wavelength : float
            Wavelength in vacuum, in metres, positive.
        device : Device or str, optional
            Device of the field; default ``Device.open()``.
        index : float
            Refractive index of the medium, real, from 1 to 10.

        Raises
        ------
        ShapeError
            If the shapes of field and grid differ.
        ValueError
            If a sample is not finite (a Fourier transform would spread it over the whole field)
            or the wavelength is not positive, or the index out of range.
        """
        require_grid(grid)
        device = as_device(device)
        check_index(index)
        if not (isinstance(wavelength, Real) and 0 < wavelength < np.inf):
            raise ValueError(f"The wavelength must be positive, in metres, got {wavelength!r}.")
        units.WAVELENGTH.check(wavelength, "The wavelength")
        values = host_array(u, "A field")
        if values.shape[-2:] != grid.shape:
            raise ShapeError(
                f"The last two axes of the field must have the grid's shape {grid.shape}, got "
                f"{values.shape}."
            )
        data = device.upload(values.astype(device.complex, copy=False))
        bad = count_bad(data, device)
        if bad:
            raise ValueError(
                f"The field has {bad} values that are NaN or infinite, which a propagation would "
                "spread over all samples; replace them, for example by 0."
            )
        return cls(data, grid, float(wavelength), device, float(index))

    def __repr__(self) -> str:
        pitch = both(self.grid.pitch, metres)
        medium = "" if self.index == 1 else f" in index {self.index:g}"
        return (
            f"<Field {self.shape} {self.data.dtype}, {metres(self.wavelength)}{medium}, "
            f"pitch {pitch}, {self.device.name}>"
        )

    def __getitem__(self, index: int | tuple[int, ...]) -> Field:
        """Return an item of a batch as a new field.

        Parameters
        ----------
        index : int or tuple of int
            Indices of leading axes; negative indices count from the end. Fewer indices than batch
            axes return a smaller batch.

        Raises
        ------
        TypeError
            If an index is not an integer.
        IndexError
            If an index is out of range.
        ShapeError
            If there are more indices than batch axes.

        Examples
        --------
        >>> grid = clplen.Grid((8, 8), 10e-6)
        >>> batch = clplen.Field.from_array(np.ones((3, 8, 8)), grid, wavelength=500e-9)
        >>> batch[0].shape
        (8, 8)
        """
        indices, batch = index if isinstance(index, tuple) else (index,), self.shape[:-2]
        if len(indices) > len(batch):
            raise ShapeError(
                f"A field of shape {self.shape} must be indexed along its {len(batch)} batch axes, "
                f"got {len(indices)} indices."
            )
        if not all(is_integer(i) for i in indices):
            raise TypeError(f"Indices of a field must be integers, got {index!r}.")
        for i, n in zip(indices, batch, strict=False):
            if not -n <= i < n:
                raise IndexError(f"Indices must lie in a batch of shape {batch}, got {index!r}.")
        part = self.data[tuple(int(i) % n for i, n in zip(indices, batch, strict=False))]
        return self.with_data(part.copy())

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (..., ny, nx) of the samples."""
        return tuple(self.data.shape)

    @property
    def medium_wavelength(self) -> float:
        """Wavelength in the medium, wavelength/index, in metres."""
        return self.wavelength / self.index

    def to_numpy(self) -> np.ndarray[Any, Any]:
        """Return the complex amplitudes on the host, shape (..., ny, nx)."""
        return self.device.download(self.data)

    def intensity(self) -> Image:
        """Return the intensity abs(u)^2 as an image of shape (..., ny, nx)."""
        out = self.device.empty(self.shape, self.device.real)
        kernel = self.device.kernel("intensity.cl", "intensity", **self.device.wave_defines())
        self.device.launch_rows(kernel, self.shape, out, self.data, *self.grid.shape)
        return Image(out, self.device)

    def power(self) -> Any:
        """Return the power, sum abs(u)^2 dy dx, in the unit of abs(u)^2 times square metres.

        Returns
        -------
        float or numpy.ndarray
            Power of the field, or of each field of a batch.
        """
        total = row_powers(self).sum(axis=-1) * self.grid.pitch[0] * self.grid.pitch[1]
        return float(total) if total.ndim == 0 else total

    def with_data(self, data: cla.Array) -> Field:
        """Return a field with other samples on the same grid, wavelength and device."""
        return replace(self, data=data)


def require_field(field: object) -> None:
    """Raise a TypeError unless an object is a `Field`."""
    require(Field, field, "field", "Field.from_array or plane_wave")


def check_index(index: object) -> None:
    """Raise a ValueError unless a refractive index is real and from 1 to `MAX_INDEX`."""
    if not (isinstance(index, Real) and 1 <= float(index) <= MAX_INDEX):
        raise ValueError(
            f"The refractive index must be a real number from 1 to {MAX_INDEX:g}, got {index!r}."
        )


def require_grid(grid: object) -> None:
    """Raise a TypeError unless an object is a `Grid`."""
    require(Grid, grid, "grid", "Grid(shape, pitch)")


def map_samples(field: Field, kernel: cl.Kernel, *args: Any, out: cla.Array | None = None) -> Field:
    """Return the field computed by a kernel with arguments (out, samples, ``args``, ny, nx)."""
    out = field.device.empty(field.shape, field.device.complex) if out is None else out
    field.device.launch_rows(kernel, field.shape, out, field.data, *args, *field.grid.shape)
    return field.with_data(out)


def row_powers(field: Field) -> Vector:
    """Return the compensated sum of abs(u)^2 along each row, shape (..., ny), float64."""
    out = field.device.empty(field.shape[:-1], field.device.real)
    ny, nx = field.grid.shape
    kernel = field.device.kernel("intensity.cl", "row_power", **field.device.wave_defines())
    count = int(np.prod(field.shape[:-2], dtype=np.int64))
    field.device.launch(kernel, (ny, count), out, field.data, ny, nx)
    return field.device.download(out).astype(np.float64)
