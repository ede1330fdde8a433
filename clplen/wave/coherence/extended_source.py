"""Extended sources: sums of plane waves with van Cittert-Zernike coherence."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from numbers import Integral
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import check_positive, float64_array, is_finite, real_array
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import SamplingError, SamplingWarning, ShapeError, warn_caller
from clplen.reprs import OneLine
from clplen.units import metres
from clplen.wave.coherence.spatial_models import SpatialModel, uniform
from clplen.wave.elements.hard_apertures import disc_coverage, interval_coverage
from clplen.wave.field.field import Field, Grid, derived_grid
from clplen.wave.field.sampling import exceeds
from clplen.wave.field.transmission import multiply_separable, offsets, phasor

Vector = np.ndarray[Any, Any]

_STRETCH = 32  # samples between two phases that are computed directly


class _Blocks(NamedTuple):
    """Sizes of the sums that a work-item keeps in registers; see plane_waves.cl."""

    LANES: int
    VECTORS: int
    HEIGHT: int


def plane_waves(
    frequencies: Vector, amplitudes: Vector, *, grid: Grid, wavelength: float, device: Device
) -> Field:
    """Return the field sum_p a_p exp(2 pi i (fy_p y + fx_p x))."""
    points = len(amplitudes)
    if np.shape(frequencies) != (points, 2) or points == 0:
        raise ShapeError(
            f"The frequencies of {points} plane waves must have shape ({points}, 2) with at least "
            f"one row, got {np.shape(frequencies)}."
        )
    (ny, nx), blocks = grid.shape, _blocks(device)
    middle = grid.origin[1] + ((nx - 1) / 2 - nx // 2) * grid.pitch[1]
    fy, fx = (f if n > 1 else 0 * f for f, n in zip(frequencies.T, grid.shape, strict=True))
    rows = _waves(fy, grid.y[0], grid.pitch[0], ny)
    rows *= (amplitudes * phasor(fx * middle))[:, None]
    columns = _waves(fx, (nx - 1) % 2 * grid.pitch[1] / 2, grid.pitch[1], (nx + 1) // 2)
    out = device.empty(grid.shape, device.complex)
    kernel = device.kernel(
        "plane_waves.cl", "plane_waves", **blocks._asdict(), **device.wave_defines()
    )
    down, across = -(-ny // blocks.HEIGHT), -(-((nx + 1) // 2) // (blocks.LANES * blocks.VECTORS))
    device.launch(
        kernel,
        (down, across) if device.rows else (across, down),
        out,
        device.upload(_row_blocks(rows, blocks.HEIGHT, device.complex)),
        device.upload(_column_blocks(columns, blocks.LANES * blocks.VECTORS, device.real)),
        points,
        *grid.shape,
    )
    return Field(out, grid, float(wavelength), device)


def _blocks(device: Device) -> _Blocks:
    """Return sizes whose accumulators (4 LANES VECTORS HEIGHT) fit in the registers."""
    if not device.rows:
        return _Blocks(1, 1, 4)
    single = device.precision == "single"
    cl_device, registers = device.cl_device, 16 if single else 8
    wide = cl_device.native_vector_width_float if single else cl_device.native_vector_width_double
    lanes = min(max(int(wide), registers // 4), registers)
    return _Blocks(lanes, 2 if lanes == registers else 1, 3)


def _waves(frequency: Vector, first: float, pitch: float, count: int) -> Vector:
    """Return exp(2 pi i f (first + i pitch)), shape (points, count), complex128.

    Phases of every 32nd sample times those in between save nine tenths of the exponentials.
    """
    segments = -(-count // _STRETCH)
    coarse = phasor(np.multiply.outer(frequency, first + np.arange(segments) * _STRETCH * pitch))
    fine = phasor(np.multiply.outer(frequency, np.arange(min(_STRETCH, count)) * pitch))
    waves = coarse[:, :, None] * fine[:, None, :]
    return waves.reshape(len(frequency), -1)[:, :count]


def _row_blocks(waves: Vector, height: int, dtype: np.dtype[Any]) -> Vector:
    """Pack (points, n) as (n / height, points, height), padded with 0."""
    points, n = waves.shape
    count = -(-n // height)
    packed = np.zeros((points, count * height), dtype)
    packed[:, :n] = waves
    return packed.reshape(points, count, height).swapaxes(0, 1)


def _column_blocks(waves: Vector, width: int, dtype: np.dtype[Any]) -> Vector:
    """Pack (points, n) as cosines and sines (n / width, points, 2, width), padded with 0."""
    points, n = waves.shape
    count = -(-n // width)
    packed = np.zeros((count, points, 2, width), dtype)
    for i in range(count):
        part = waves[:, i * width : (i + 1) * width]
        packed[i, :, 0, : part.shape[1]] = part.real
        packed[i, :, 1, : part.shape[1]] = part.imag
    return packed


Array = np.ndarray[Any, Any]

_POSITIONS = 2  # stream of random numbers


@dataclass(frozen=True, eq=False, repr=False)
class ExtendedSource(OneLine, SpatialModel):
    """Light of an incoherent source far enough away for the Fresnel approximation.

    A snapshot is the field of random points of the source, with equal powers and random phases, in
    a window on the axis. The mean over snapshots has the van Cittert-Zernike degree of coherence,
    which `degree` returns.

    Parameters
    ----------
    size : float
        Extent in metres: diameter of the disc, side of the square, or width of the picture along x.
    distance : float
        Distance from the source to the window in metres.
    shape : {"circular", "square"}
        Shape of a uniform source; ignored if there is a picture.
    picture : array_like, optional
        Intensities of the source, 2-D, finite, not negative and not all 0. The picture is centred
        on the axis, with uniform square pixels and row 0 at the smallest y.
    points : int
        Number of points, drawn again for each snapshot. The field tends to a circular Gaussian
        field as it grows: the contrast of abs(u)^2 is sqrt(1 - 1/points).
    curved : bool
        True to include the curvature common to all points, exp(i pi r^2/(lam distance)). Without it
        the coherence is equal everywhere in the window, as behind a field lens of focal length
        ``distance``.

    Raises
    ------
    ValueError
        If the size or distance is not positive, the shape unknown, the number of points below 1, or
        the picture invalid.

    Notes
    -----
    Without the common curvature, a point at s emits the plane wave of frequency -s/(lam distance)
    (Goodman 2015, section 5.6; the random phase absorbs the quadratic phase of the point). The
    model is paraxial: it replaces the sine of an angle by its tangent, with a relative error of
    half_angle^2/2. If the window has length 1 along an axis, the source is projected on the other.

    Examples
    --------
    >>> source = clplen.wave.ExtendedSource(2e-3, 0.1)  # 2 mm wide, 100 mm away
    >>> mu = source.degree(0.0, [0.0, 15e-6, 30.5e-6], wavelength=500e-9)
    >>> [f"{abs(value):.2f}" for value in mu]
    ['1.00', '0.62', '0.00']
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> snapshots = list(clplen.Coherence(source).snapshots(grid, wavelength=500e-9, count=2))
    >>> len(snapshots), snapshots[0].shape
    (2, (32, 32))
    """

    size: float
    distance: float
    _: KW_ONLY
    shape: Literal["circular", "square"] = "circular"
    picture: Array | None = None
    points: int = 400
    curved: bool = False

    def __post_init__(self) -> None:
        for name in ("size", "distance"):
            value = getattr(self, name)
            if not (is_finite(value) and value > 0):
                raise ValueError(f"{name} must be positive, in metres, got {value!r}.")
        if self.shape not in ("circular", "square"):
            raise ValueError(f"shape must be 'circular' or 'square', got {self.shape!r}.")
        if (
            isinstance(self.points, bool)
            or not isinstance(self.points, Integral)
            or self.points < 1
        ):
            raise ValueError(f"points must be an integer of at least 1, got {self.points!r}.")
        if self.picture is not None:
            object.__setattr__(self, "picture", _intensities(self.picture))

    @property
    def degree_is_exact(self) -> bool:
        """False, since the source's waves are not periodic in the window.

        Sums over the source are nevertheless exact for objects with a dark border.
        """
        return False

    @property
    def extent(self) -> tuple[float, float]:
        """Height and width of the source in metres, (y, x)."""
        if self.picture is None:
            return self.size, self.size
        rows, columns = self.picture.shape
        return self.size * rows / columns, self.size

    def check(self, grid: Grid, *, wavelength: float) -> None:
        """Raise if the Nyquist frequency of a window is below that of a point of the source.

        Warns
        -----
        SamplingWarning
            If ``curved`` and the curvature exceeds it towards the edge of the window.
        """
        check_positive(wavelength=wavelength)
        for axis, (n, pitch, size) in enumerate(
            zip(grid.shape, grid.pitch, self.extent, strict=True)
        ):
            name = "yx"[axis]
            limit = wavelength * self.distance / size
            if n > 1 and exceeds(pitch, limit):
                raise SamplingError(
                    f"The pitch along {name} must be at most {metres(limit)} for a source of "
                    f"{metres(size)} at {metres(self.distance)}, got {metres(pitch)}: the light of "
                    "its rim is beyond the Nyquist frequency."
                )
            edge = np.abs((grid.y, grid.x)[axis]).max() + size / 2
            limit = wavelength * self.distance / (2 * edge)
            if n > 1 and self.curved and exceeds(pitch, limit):
                warn_caller(
                    f"The curvature of a source at {metres(self.distance)} is undersampled at the "
                    f"window's edge along {name}: use a pitch of at most {metres(limit)} instead "
                    f"of {metres(pitch)}, or curved=False.",
                    SamplingWarning,
                )

    def field(
        self,
        grid: Grid,
        *,
        wavelength: float,
        device: DeviceLike | None = None,
        seed: int,
        index: int,
    ) -> Field:
        """Return the snapshot sum_p exp(i phi_p - 2 pi i (s_p . r)/(lam distance))/sqrt(points)."""
        device = as_device(device)
        draws = uniform(seed, index, _POSITIONS, self.points)
        field = plane_waves(
            -self._positions(draws) / (wavelength * self.distance),
            phasor(draws[:, 2]) / math.sqrt(self.points),
            grid=grid,
            wavelength=wavelength,
            device=device,
        )
        if not self.curved:
            return field
        ty, tx = (
            phasor(s**2 / (2 * wavelength * self.distance), device.complex) for s in offsets(grid)
        )
        return multiply_separable(field, ty, tx)

    def degree(self, dy: ArrayLike, dx: ArrayLike, *, wavelength: float) -> Array:
        """Return the degree of coherence of two points (dy, dx) apart, without the curvature.

        It is the normalised Fourier transform of the source (van Cittert 1934; Zernike 1938;
        Goodman 2015, eq. 5.6-8). A disc has 2 J1(v)/v with v = pi size D/(lam distance), a square a
        product of sin(v)/v. A picture has, times the factors of a pixel, the complex degree
        sum_jk p_jk exp(-2 pi i (D . s_jk)/(lam distance)) / sum p_jk.
        """
        check_positive(wavelength=wavelength)
        from scipy import special  # a local import, a third of the package's import time

        fy, fx = (float64_array(d) / (wavelength * self.distance) for d in (dy, dx))
        if self.picture is not None:
            return self._transform(self.picture, fy, fx)
        if self.shape == "square":
            return np.asarray(np.sinc(fy * self.size) * np.sinc(fx * self.size))
        v = np.asarray(np.pi * self.size * np.hypot(fy, fx))
        return np.where(v > 0, 2 * special.j1(v) / np.where(v > 0, v, 1), 1.0)

    def power_spectrum(self, grid: Grid, *, wavelength: float) -> Array:
        """Return the share of light at each frequency: the part of the source in its cell.

        A point at s has the frequency -s/(lam distance). A ``curved`` source raises a ValueError.
        """
        if self.curved:
            raise ValueError(
                "Light of a curved source has no single spectrum; use curved=False and a lens of "
                f"focal length {metres(-self.distance)} for the curvature."
            )
        self.check(grid, wavelength=wavelength)
        order = [np.arange(-(n // 2), n // 2 + 1) for n in grid.shape]  # even n: both ends fold
        cell = [
            wavelength * self.distance / (n * d) if n > 1 else 2 * size
            for n, d, size in zip(grid.shape, grid.pitch, self.extent, strict=True)
        ]
        share = self._shares(order, cell)
        out = np.zeros(grid.shape)
        at = [k % n for k, n in zip(order, grid.shape, strict=True)]
        np.add.at(out, (at[0][:, None], at[1][None, :]), share)
        return out / out.sum()

    def half_angle(self, wavelength: float = 0.0) -> float:
        """Return the half angle of the source along its longer side, size/(2 distance), in rad."""
        return max(self.extent) / 2 / self.distance

    def coherence_area(self, wavelength: float) -> float:
        """Return the integral of abs(mu)^2 over the displacement in square metres.

        It is (lam distance)^2 over the area of a uniform source. For a picture it is multiplied by
        the mean of the squared intensity over the squared mean (Goodman 2015, section 5.7).
        """
        height, width = self.extent
        if self.picture is not None:
            even = self.picture.mean() ** 2 / np.mean(self.picture**2)
            area = height * width * float(even)
        else:
            area = height * width * (math.pi / 4 if self.shape == "circular" else 1)
        return (wavelength * self.distance) ** 2 / area

    def _positions(self, draws: Array) -> Array:
        """Return the positions (y, x) of the points in metres, shape (points, 2)."""
        if self.picture is not None:
            rows, columns = self.picture.shape
            sums = np.cumsum(self.picture, dtype=np.float64)
            cells = np.searchsorted(sums, draws[:, 3] * sums[-1], side="right")
            row, column = np.divmod(cells, columns)
            at = np.stack([row - rows / 2, column - columns / 2], axis=-1) + draws[:, :2]
            return at * (self.size / columns)
        if self.shape == "square":
            return self.size * (draws[:, :2] - 0.5)
        radius = self.size / 2 * np.sqrt(draws[:, 0])
        around = phasor(draws[:, 1])
        return np.stack([radius * around.imag, radius * around.real], axis=-1)

    def _transform(self, picture: Array, fy: Array, fx: Array) -> Array:
        """Return the normalised Fourier transform of a picture at frequencies in cycles per m."""
        (y, x), pixel = self._centres(picture.shape), self.size / picture.shape[1]
        rows = phasor(-np.multiply.outer(fy, y)) @ (picture / picture.sum())
        columns = phasor(-np.multiply.outer(fx, x))
        sums = np.einsum("...k,...k->...", rows, columns)
        return np.asarray(sums * np.sinc(fy * pixel) * np.sinc(fx * pixel))

    def _centres(self, shape: tuple[int, ...]) -> tuple[Array, Array]:
        """Return the coordinates of the rows and columns of a picture in metres."""
        pixel = self.size / shape[1]
        y, x = ((np.arange(n) - (n - 1) / 2) * pixel for n in shape)
        return y, x

    def _shares(self, order: list[Array], cell: list[float]) -> Array:
        """Return the power of the source in cells (y, x) about -order times cell, in any unit."""
        at = [-k * side for k, side in zip(order, cell, strict=True)]
        if self.picture is None and self.shape == "circular":
            frame = derived_grid((len(at[0]), len(at[1])), (cell[0], cell[1]))
            return disc_coverage(frame, self.size / 2, (0.0, 0.0))
        picture = np.ones((1, 1)) if self.picture is None else self.picture
        half = self.size / picture.shape[1] / 2
        rows, columns = (
            interval_coverage(np.subtract.outer(a, s), side, half)
            for a, s, side in zip(at, self._centres(picture.shape), cell, strict=True)
        )
        return np.asarray(rows @ picture @ columns.T)


def _intensities(picture: ArrayLike) -> Array:
    """Return a picture of a source as a read-only array of float64."""
    values = np.array(real_array(picture, "picture", np.float64))
    if values.ndim != 2 or values.size == 0:
        raise ValueError(f"picture must be a 2-D array of intensities, got shape {values.shape}.")
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ValueError("picture must have finite intensities that are not negative.")
    if not values.any():
        raise ValueError("picture must have at least one intensity above 0.")
    values.flags.writeable = False
    return values
