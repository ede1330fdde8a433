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


@dataclass(frozen=True, init=False)
class Grid:
    """Where the samples of a field lie.

    Sample i of an axis of N samples lies at ``origin + (i - N//2) pitch``, for even and odd N.

    Parameters
    ----------
    shape : tuple of int
        (ny, nx), each at least 1. An axis of length 1 means that nothing varies along it (the
        cylindrical problem): it is never padded and carries no frequency.
    pitch : float or tuple of float
        Sample spacing in metres, (dy, dx) or one number for both; at most 1 m.
    origin : tuple of float, optional
        (y, x) coordinate of sample N//2 in metres. Half a pitch puts the axis between the two
        central samples of an even grid.

    Attributes
    ----------
    shape : tuple of int
        (ny, nx).
    pitch : tuple of float
        (dy, dx) in metres.
    origin : tuple of float
        (y, x) in metres.

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
            raise ShapeError(f"A grid's shape is (ny, nx), two positive integers, not {shape!r}.")
        pitches, origins = _pair(pitch), _pair(origin)
        if not (np.isfinite(pitches).all() and (pitches > 0).all()):
            raise ValueError(f"A grid's pitch is positive and finite, in metres, not {pitch!r}.")
        units.PITCH.check(pitch, "A grid's pitch")
        if not np.isfinite(origins).all():
            raise ValueError(f"A grid's origin is finite, in metres, not {origin!r}.")
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
        """Spatial frequencies of the rows in cycles a metre, FFT order, shape (ny,)."""
        return np.fft.fftfreq(self.shape[0], self.pitch[0])

    @property
    def fx(self) -> Vector:
        """Spatial frequencies of the columns in cycles a metre, FFT order, shape (nx,)."""
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
    """A grid that follows from others, of any pitch: far away, or of frequencies."""
    grid = object.__new__(Grid)
    grid._set(shape, pitch, origin)
    return grid


def _pair(values: Any) -> Vector:
    """One number or two as two; NaN where they are something else."""
    try:
        return np.broadcast_to(np.asarray(values, dtype=np.float64), (2,))
    except (TypeError, ValueError, OverflowError):
        return np.full(2, np.nan)


@dataclass(frozen=True, eq=False, repr=False)
class Field(Plottable, OnDevice):
    """A scalar field sampled on a grid. Made by `from_array` or by an operation.

    The time factor is exp(-i omega t): a wave that goes to +z is exp(+ikz). The carrier exp(ikz),
    constant over the field, is dropped by every propagation.

    Attributes
    ----------
    data : pyopencl.array.Array
        complex64 (complex128 on a device of double precision), shape (..., ny, nx).
    grid : Grid
        Where its samples lie.
    wavelength : float
        In metres.
    device : Device
        The device that holds the samples.

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

    @classmethod
    def from_array(
        cls, u: Any, grid: Grid, *, wavelength: float, device: DeviceLike | None = None
    ) -> Field:
        """Bring complex amplitudes to a device.

        Parameters
        ----------
        u : array_like
            Shape (..., ny, nx); leading axes are a batch. Real or complex.
        grid : Grid
            Its shape is that of the last two axes.
        wavelength : float
            In metres, positive.
        device : Device or str, optional
            Where the field will live; default ``Device.open()``.

        Raises
        ------
        ShapeError
            If the shapes of field and grid differ.
        ValueError
            If a sample is not finite (a Fourier transform would spread it over the whole field)
            or the wavelength is not positive.
        """
        require_grid(grid)
        device = as_device(device)
        if not (isinstance(wavelength, Real) and 0 < wavelength < np.inf):
            raise ValueError(f"The wavelength is positive, in metres, not {wavelength!r}.")
        units.WAVELENGTH.check(wavelength, "The wavelength")
        values = host_array(u, "A field")
        if values.shape[-2:] != grid.shape:
            raise ShapeError(
                f"The field has shape {values.shape}, the grid {grid.shape}: the last two axes "
                "must agree."
            )
        data = device.upload(values.astype(device.complex, copy=False))
        bad = count_bad(data, device)
        if bad:
            raise ValueError(
                f"The field has {bad} values that are NaN or infinite; a propagation would spread "
                "them over the whole field: replace them, by 0 for no light."
            )
        return cls(data, grid, float(wavelength), device)

    def __repr__(self) -> str:
        pitch = both(self.grid.pitch, metres)
        return (
            f"<Field {self.shape} {self.data.dtype}, {metres(self.wavelength)}, pitch {pitch}, "
            f"{self.device.name}>"
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
        """Shape of the samples, (..., ny, nx)."""
        return tuple(self.data.shape)

    def to_numpy(self) -> np.ndarray[Any, Any]:
        """The complex amplitudes on the host, shape (..., ny, nx)."""
        return self.device.download(self.data)

    def intensity(self) -> Image:
        """abs(u)^2 as an image of shape (..., ny, nx)."""
        out = self.device.empty(self.shape, self.device.real)
        kernel = self.device.kernel("intensity.cl", "intensity", **self.device.wave_defines())
        self.device.launch_rows(kernel, self.shape, out, self.data, *self.grid.shape)
        return Image(out, self.device)

    def power(self) -> Any:
        """sum abs(u)^2 dy dx in the unit of abs(u)^2 times square metres.

        Returns
        -------
        float or numpy.ndarray
            One float, or one for each leading batch index.
        """
        total = row_powers(self).sum(axis=-1) * self.grid.pitch[0] * self.grid.pitch[1]
        return float(total) if total.ndim == 0 else total

    def with_data(self, data: cla.Array) -> Field:
        """The same grid, wavelength and device with other samples."""
        return replace(self, data=data)


def require_field(field: object) -> None:
    """Refuse what is no field."""
    require(Field, field, "field", "Field.from_array or plane_wave")


def require_grid(grid: object) -> None:
    """Refuse what is no grid."""
    require(Grid, grid, "grid", "Grid(shape, pitch)")


def map_samples(field: Field, kernel: cl.Kernel, *args: Any, out: cla.Array | None = None) -> Field:
    """Return the field that a kernel (out, samples, ``args``, ny, nx) makes of another one."""
    out = field.device.empty(field.shape, field.device.complex) if out is None else out
    field.device.launch_rows(kernel, field.shape, out, field.data, *args, *field.grid.shape)
    return field.with_data(out)


def row_powers(field: Field) -> Vector:
    """Sum of abs(u)^2 along each row, compensated on the device, shape (..., ny), float64."""
    out = field.device.empty(field.shape[:-1], field.device.real)
    ny, nx = field.grid.shape
    kernel = field.device.kernel("intensity.cl", "row_power", **field.device.wave_defines())
    count = int(np.prod(field.shape[:-2], dtype=np.int64))
    field.device.launch(kernel, (ny, count), out, field.data, ny, nx)
    return field.device.download(out).astype(np.float64)
