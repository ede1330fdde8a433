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
    """Estimator of the degree of coherence from a sequence of snapshots, which it does not store.

    mu(lag) = <u*(r) u(r + lag)>/<abs(u)^2>, averaged over the snapshots and all pairs of samples in
    the window (Goodman 2015, section 5.2; Mandel & Wolf 1995, section 4.3). The light must have
    equal coherence everywhere in the window. The pairs are summed as power spectra (Wiener-Khinchin
    theorem) in float64, with the memory of a single spectrum.

    Attributes
    ----------
    grid : Grid
        Samples of the snapshots.
    periodic : bool
        True if the window is periodic.
    reach : tuple of int
        Largest lags (y, x) in samples.
    count : int
        Number of snapshots so far.
    """

    def __init__(
        self, grid: Grid, *, reach: tuple[int, int] | None = None, periodic: bool = False
    ) -> None:
        ny, nx = grid.shape
        self.grid, self.periodic, self.count = grid, periodic, 0
        self.reach = _integers((ny - 1, nx - 1) if reach is None else reach, "reach")
        if self.reach.shape != (2,) or (self.reach < 0).any() or (self.reach >= grid.shape).any():
            raise ValueError(
                f"reach must be two lags (y, x) from 0 to {(ny - 1, nx - 1)}, got {reach!r}."
            )
        from scipy import fft  # a local import, since it is slow

        self._fft = fft
        lengths = [
            n if periodic or limit == 0 else fft.next_fast_len(n + int(limit))
            for n, limit in zip(grid.shape, self.reach, strict=True)
        ]
        self._power = np.zeros(lengths)

    def add(self, field: Field) -> None:
        """Add a snapshot, or each field of a batch."""
        if field.grid != self.grid:
            raise ShapeError(f"field must have the estimator's {self.grid}, got {field.grid}.")
        for u in field.to_numpy().reshape(-1, *self.grid.shape):
            spectrum = self._fft.fft2(u.astype(np.complex128), self._power.shape, workers=-1)
            self._power += spectrum.real**2 + spectrum.imag**2
            self.count += 1

    def degree(self, dy: ArrayLike, dx: ArrayLike) -> Array:
        """Return mu at lags in samples."""
        rows, columns = _integers(dy, "lags"), _integers(dx, "lags")
        for lags, limit, name in ((rows, self.reach[0], "y"), (columns, self.reach[1], "x")):
            if (np.abs(lags) > limit).any():
                raise ValueError(
                    f"lags along {name} must be at most {limit} samples, got {np.abs(lags).max()}; "
                    f"the window has {self.grid.shape['yx'.index(name)]}."
                )
        products, (ny, nx) = self._products(), self.grid.shape
        length_y, length_x = products.shape
        mean = products[rows % length_y, columns % length_x]
        if not self.periodic:
            mean = mean * ny * nx / ((ny - np.abs(rows)) * (nx - np.abs(columns)))
        return np.asarray(mean / products[0, 0].real)

    def map(self) -> Array:
        """Return mu at every lag within reach, with lag 0 in the middle."""
        if self.periodic:
            return np.fft.fftshift(self._products() / self._products()[0, 0].real)
        y, x = (np.arange(-limit, limit + 1) for limit in self.reach)
        return self.degree(y[:, None], x[None, :])

    def _products(self) -> Array:
        """Return sums of u*(r) u(r + lag) over pairs and snapshots, lags in FFT order."""
        if self.count == 0:
            raise ValueError("The degree of coherence requires at least one snapshot.")
        if not self._power.any():
            raise ValueError("The snapshots are dark; the degree of coherence is undefined.")
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
        Snapshots on a common grid, read once and not stored.
    lags : array_like of int
        Lags in samples, of either sign: any shape with ``axis``, else pairs (dy, dx) of shape (...,
        2).
    axis : {"y", "x"}, optional
        Direction of the lags; None: the lags are pairs.
    periodic : bool
        True if the window is periodic, as for random phase masks.

    Returns
    -------
    numpy.ndarray
        Complex degree mu, complex128, with the shape of ``lags`` (for pairs without the last axis).

    Raises
    ------
    ValueError
        If there is no field or no light, or a lag is not an integer or exceeds the window.
    ShapeError
        If the lags are not pairs, or the grids differ.
    TypeError
        If the snapshots are not fields.

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
            f"fields must be a list or generator of Field, got {type(fields).__name__}."
        )
    for field in fields:
        require_field(field)
        if estimator is None:
            reach = (int(np.abs(dy).max(initial=0)), int(np.abs(dx).max(initial=0)))
            estimator = DegreeEstimator(field.grid, reach=reach, periodic=periodic)
        estimator.add(field)
    if estimator is None:
        raise ValueError("The degree of coherence requires at least one snapshot.")
    return estimator.degree(dy, dx)


def speckle_contrast(image: Image | Array, *, region: Any = None) -> float:
    """Return the standard deviation over the mean of an intensity (Goodman 2020, eq. 3-32).

    Parameters
    ----------
    image : Image or numpy.ndarray
        Intensity, not negative, shape (ny, nx).
    region : index, optional
        Region of the image: a mask of its shape, or slices (y, x); by default the whole image.

    Returns
    -------
    float
        Contrast: 1 for developed speckle, 1/sqrt(M) for the mean of M independent patterns.

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
        raise ValueError(f"region must contain samples of the image, got {region!r}.")
    mean = float(chosen.mean())
    if not mean > 0:
        raise ValueError(f"The mean intensity of the region must be positive, got {mean:g}.")
    return float(chosen.std()) / mean


def _along(lags: ArrayLike, axis: str | None) -> tuple[Array, Array]:
    """Return lags as (dy, dx)."""
    values = _integers(lags, "lags")
    if axis is None:
        if values.ndim == 0 or values.shape[-1] != 2:
            raise ShapeError(
                f"lags must be (dy, dx) of shape (..., 2), got {values.shape}; else set axis."
            )
        return values[..., 0], values[..., 1]
    if axis not in ("y", "x"):
        raise ValueError(f"axis must be 'y' or 'x', got {axis!r}.")
    zero = np.zeros_like(values)
    return (values, zero) if axis == "y" else (zero, values)


def _integers(values: ArrayLike, what: str) -> Array:
    """Return integers as int64, or raise a ValueError."""
    array = np.asarray(values)
    real = array.size > 0 and array.dtype.kind in "iuf"
    if not (real and np.isfinite(array).all() and (array == np.rint(array)).all()):
        raise ValueError(f"{what} must be integers, in samples, got {values!r}.")
    return array.astype(np.int64)
