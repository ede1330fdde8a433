"""Degree of coherence and speckle contrast, measured from snapshots."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array
from clplen.compute.arrays import HostArray, Image
from clplen.errors import ShapeError
from clplen.wave.field.field import Field, Grid, require_field

Array = np.ndarray[Any, Any]


class DegreeEstimator:
    """Degree of coherence from snapshots that come one by one and are not kept.

    mu(lag) = <u*(r) u(r + lag)>/<abs(u)^2>, the means over the snapshots and over all pairs of
    samples in the window (Goodman 2015, section 5.2; Mandel & Wolf 1995, section 4.3), for light
    whose coherence is the same everywhere in it. The pairs are summed as power spectra (Wiener and
    Khinchin), in float64; memory is that of one spectrum.

    Attributes
    ----------
    grid : Grid
    periodic : bool
    reach : tuple of int
    count : int
        Snapshots so far.
    """

    def __init__(
        self, grid: Grid, *, reach: tuple[int, int] | None = None, periodic: bool = False
    ) -> None:
        ny, nx = grid.shape
        self.grid, self.periodic, self.count = grid, periodic, 0
        self.reach = _whole((ny - 1, nx - 1) if reach is None else reach, "The reach")
        if self.reach.shape != (2,) or (self.reach < 0).any() or (self.reach >= grid.shape).any():
            raise ValueError(
                f"The reach is two lags (y, x) from 0 to {(ny - 1, nx - 1)}, not {reach!r}."
            )
        from scipy import fft  # here, because it takes long to import

        self._fft = fft
        lengths = [
            n if periodic or most == 0 else fft.next_fast_len(n + int(most))
            for n, most in zip(grid.shape, self.reach, strict=True)
        ]
        self._power = np.zeros(lengths)

    def add(self, field: Field) -> None:
        """Take in a snapshot, or each of a batch."""
        if field.grid != self.grid:
            raise ShapeError(f"The estimator works on {self.grid}, the field is on {field.grid}.")
        for u in field.to_numpy().reshape(-1, *self.grid.shape):
            spectrum = self._fft.fft2(u.astype(np.complex128), self._power.shape, workers=-1)
            self._power += spectrum.real**2 + spectrum.imag**2
            self.count += 1

    def degree(self, dy: ArrayLike, dx: ArrayLike) -> Array:
        """mu at lags in samples."""
        rows, columns = _whole(dy, "A lag"), _whole(dx, "A lag")
        for lags, most, name in ((rows, self.reach[0], "y"), (columns, self.reach[1], "x")):
            if (np.abs(lags) > most).any():
                raise ValueError(
                    f"A lag of {np.abs(lags).max()} samples along {name} is beyond the reach of "
                    f"{most}; the window has {self.grid.shape['yx'.index(name)]}."
                )
        products, (ny, nx) = self._products(), self.grid.shape
        length_y, length_x = products.shape
        mean = products[rows % length_y, columns % length_x]
        if not self.periodic:
            mean = mean * ny * nx / ((ny - np.abs(rows)) * (nx - np.abs(columns)))
        return np.asarray(mean / products[0, 0].real)

    def map(self) -> Array:
        """mu at every lag of the reach, 0 in the middle."""
        if self.periodic:
            return np.fft.fftshift(self._products() / self._products()[0, 0].real)
        y, x = (np.arange(-most, most + 1) for most in self.reach)
        return self.degree(y[:, None], x[None, :])

    def _products(self) -> Array:
        """Sums of u*(r) u(r + lag) over pairs and snapshots, lags in FFT order."""
        if self.count == 0:
            raise ValueError("There is no snapshot to measure a degree of coherence from.")
        if not self._power.any():
            raise ValueError("The snapshots are dark: there is no light to measure coherence of.")
        return np.asarray(self._fft.ifft2(self._power, workers=-1))


def measured_degree(
    fields: Iterable[Field],
    lags: ArrayLike,
    *,
    axis: Literal["y", "x"] | None = None,
    periodic: bool = False,
) -> Array:
    """Return the degree of coherence of snapshots at some lags; see `DegreeEstimator`.

    Parameters
    ----------
    fields : iterable of Field
        Of one grid; read once, none is kept.
    lags : array_like of int
        In samples, either sign: along ``axis`` any shape, without one (dy, dx), shape (..., 2).
    axis : {"y", "x"}, optional
        Along which the lags are; None: they are pairs.
    periodic : bool
        Whether the window repeats, as that of random phase masks.

    Returns
    -------
    numpy.ndarray
        Complex degree mu, complex128, the shape of ``lags`` (without its last axis where there is
        no ``axis``).

    Raises
    ------
    ValueError
        If there is no field or no light, or a lag is not whole or beyond the window.
    ShapeError
        If the lags are not pairs, or the grids differ.
    TypeError
        If the snapshots are no fields.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> light = clplen.Coherence(clplen.wave.RandomPhaseMask(40e-6))
    >>> snapshots = light.snapshots(grid, wavelength=500e-9, count=50)
    >>> mu = clplen.wave.measured_degree(snapshots, [0, 2, 4], axis="x", periodic=True)
    >>> [f"{abs(value):.1f}" for value in mu]
    ['1.0', '0.5', '0.0']
    """
    dy, dx = _along(lags, axis)
    estimator = None
    if not isinstance(fields, Iterable) or isinstance(fields, str | HostArray):
        raise TypeError(
            "measured_degree takes snapshots, a list or generator of Field, not of type "
            f"{type(fields).__name__}."
        )
    for field in fields:
        require_field(field)
        if estimator is None:
            reach = (int(np.abs(dy).max(initial=0)), int(np.abs(dx).max(initial=0)))
            estimator = DegreeEstimator(field.grid, reach=reach, periodic=periodic)
        estimator.add(field)
    if estimator is None:
        raise ValueError("There is no snapshot to measure a degree of coherence from.")
    return estimator.degree(dy, dx)


def speckle_contrast(image: Image | Array, *, region: Any = None) -> float:
    """Return the standard deviation over mean of an intensity (Goodman 2020, eq. 3-32).

    Parameters
    ----------
    image : Image or numpy.ndarray
        Intensity, not negative, shape (ny, nx).
    region : index, optional
        What of it counts: a mask of its shape, or slices (y, x); everything by default.

    Returns
    -------
    float
        Contrast: 1 of developed speckle, 1/sqrt(M) of the mean of M independent ones.

    Raises
    ------
    ValueError
        If the region is empty or dark.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> light = clplen.Coherence(clplen.wave.RandomPhaseMask(20e-6))
    >>> snapshots = light.snapshots(grid, wavelength=500e-9, count=25)
    >>> pictures = np.stack([field.intensity().to_numpy() for field in snapshots])
    >>> f"{clplen.wave.speckle_contrast(pictures[0]):.1f}"
    '1.0'
    >>> f"{clplen.wave.speckle_contrast(pictures.mean(axis=0)):.1f}"  # 1/sqrt(25)
    '0.2'
    """
    values = host_array(image, "An image")
    chosen = (values if region is None else values[region]).astype(np.float64)
    if chosen.size == 0:
        raise ValueError(f"The region {region!r} holds no sample of an image of {values.shape}.")
    mean = float(chosen.mean())
    if not mean > 0:
        raise ValueError(f"The mean intensity of the region is {mean:g}: no light, no contrast.")
    return float(chosen.std()) / mean


def _along(lags: ArrayLike, axis: str | None) -> tuple[Array, Array]:
    """Lags as (dy, dx)."""
    values = _whole(lags, "A lag")
    if axis is None:
        if values.ndim == 0 or values.shape[-1] != 2:
            raise ShapeError(
                f"Lags are (dy, dx), shape (..., 2), not {values.shape}; or name their axis."
            )
        return values[..., 0], values[..., 1]
    if axis not in ("y", "x"):
        raise ValueError(f"The axis of lags is 'y' or 'x', not {axis!r}.")
    zero = np.zeros_like(values)
    return (values, zero) if axis == "y" else (zero, values)


def _whole(values: ArrayLike, what: str) -> Array:
    """Whole numbers as int64."""
    array = np.asarray(values)
    real = array.size > 0 and array.dtype.kind in "iuf"
    if not (real and np.isfinite(array).all() and (array == np.rint(array)).all()):
        raise ValueError(f"{what} is a whole number of samples, not {values!r}.")
    return array.astype(np.int64)
