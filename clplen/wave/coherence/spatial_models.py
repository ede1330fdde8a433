"""Protocol of spatial coherence models, their random numbers, and incoherent light."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from clplen.compute.device import DeviceLike, as_device
from clplen.wave.field.field import Field, Grid

UInt32Array = np.ndarray[Any, np.dtype[np.uint32]]

ROUNDS = 10
_MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL = np.uint32(0x9E3779B9), np.uint32(0xBB67AE85)
LARGEST_SEED = 2**64 - 1
LARGEST_INDEX = 2**32 - 1


def philox(counters: Any, key: Any) -> UInt32Array:
    """Return Philox4x32-10: four random words per counter (Salmon et al. 2011, section 3.3)."""
    counter = [np.asarray(counters, np.uint32)[..., i] for i in range(4)]
    keys = np.asarray(key, np.uint32).copy()
    with np.errstate(over="ignore"):
        for _ in range(ROUNDS):
            high0, low0 = _product(_MULTIPLIERS[0], counter[0])
            high1, low1 = _product(_MULTIPLIERS[1], counter[2])
            counter = [high1 ^ counter[1] ^ keys[0], low1, high0 ^ counter[3] ^ keys[1], low0]
            keys += _WEYL
    return np.stack(counter, axis=-1)


def key_of(seed: int) -> UInt32Array:
    """Return the key of a seed: its lower and upper 32 bits."""
    check_seed(seed)
    return np.array([seed & 0xFFFFFFFF, int(seed) >> 32], np.uint32)


def check_seed(seed: int) -> None:
    """Raise unless a seed is an integer from 0 to 2^64 - 1."""
    is_integer = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
    if not (is_integer and 0 <= seed <= LARGEST_SEED):
        raise ValueError(f"seed must be an integer from 0 to 2^64 - 1, got {seed!r}.")


def uniform(seed: int, index: int, stream: int, count: int) -> np.ndarray[Any, Any]:
    """Return four independent uniform numbers for each of ``count`` counters."""
    counters = np.zeros((count, 4), np.uint32)
    counters[:, 0] = np.arange(count)
    counters[:, 2], counters[:, 3] = index, stream
    return philox(counters, key_of(seed)) * 2.0**-32


def _product(multiplier: np.uint64, word: UInt32Array) -> tuple[UInt32Array, UInt32Array]:
    """Return the upper and lower 32 bits of a product."""
    product = multiplier * word.astype(np.uint64)
    return (product >> np.uint64(32)).astype(np.uint32), product.astype(np.uint32)


Array = np.ndarray[Any, Any]


@runtime_checkable
class SpatialModel(Protocol):
    """Light with a degree of spatial coherence: an ensemble of fields of mean intensity 1.

    A user-defined model derives from this class or has the same methods.

    Parameters
    ----------
    *args, **kwargs : object
        Arguments of the class that implements the protocol, which itself cannot be instantiated.

    Examples
    --------
    >>> mask = clplen.wave.RandomPhaseMask(40e-6)
    >>> isinstance(mask, clplen.wave.SpatialModel), mask.random
    (True, True)
    >>> np.round(mask.degree(0.0, [0.0, 20e-6, 40e-6], wavelength=500e-9), 2).tolist()
    [1.0, 0.5, 0.0]
    """

    random: ClassVar[bool] = True
    """True if snapshots differ; else a single snapshot is exact."""

    def check(self, grid: Grid, *, wavelength: float) -> None:
        """Raise or warn if the grid cannot sample the light; called once per run.

        Parameters
        ----------
        grid : Grid
            Samples of the window.
        wavelength : float
            Wavelength in metres.

        Raises
        ------
        SamplingError
            If the grid is too coarse (with the largest pitch allowed) or does not fit.
        """
        return  # models override the check

    def field(
        self,
        grid: Grid,
        *,
        wavelength: float,
        device: DeviceLike | None = None,
        seed: int,
        index: int,
    ) -> Field:
        """Return a snapshot; the mean of abs(u)^2 over snapshots is 1.

        Parameters
        ----------
        grid : Grid
            Samples of the window.
        wavelength : float
            Wavelength in metres.
        device : Device or str, optional
            Default ``Device.open()``.
        seed : int
            Seed, 0 to 2^64 - 1.
        index : int
            Number of the snapshot, 0 to 2^32 - 1, in any order.

        Returns
        -------
        Field
            Snapshot of shape (ny, nx).
        """
        raise NotImplementedError

    def degree(self, dy: ArrayLike, dx: ArrayLike, *, wavelength: float) -> Array:
        """Return the degree of coherence of two points (dy, dx) apart, <u*(r) u(r + D)>/<abs(u)^2>.

        Parameters
        ----------
        dy, dx : array_like
            Displacements in metres, broadcast together.
        wavelength : float
            Wavelength in metres; masks and incoherent light do not need it.

        Returns
        -------
        numpy.ndarray
            Degree of coherence, 1 at (0, 0), float64 or complex128.
        """
        raise NotImplementedError

    def power_spectrum(self, grid: Grid, *, wavelength: float) -> Array:
        """Return the shares of light at the frequencies of a grid, FFT order; their sum is 1.

        They are the transform of the degree of coherence over the shortest displacements in a
        periodic window (Wiener-Khinchin theorem: Goodman 2015, section 3.4). Values that rounding
        or a degree wider than the window make negative are set to 0.

        Parameters
        ----------
        grid : Grid
            Samples of the window.
        wavelength : float
            Wavelength in metres; masks and incoherent light do not need it.

        Returns
        -------
        numpy.ndarray
            Shares, float64, shape (ny, nx).

        Raises
        ------
        ValueError
            If the coherence of the light varies with position.
        """
        lags = [np.fft.fftfreq(n, 1 / (n * d)) for n, d in zip(grid.shape, grid.pitch, strict=True)]
        mu = self.degree(lags[0][:, None], lags[1][None, :], wavelength=wavelength)
        share = np.maximum(np.fft.fft2(mu).real, 0)
        return np.asarray(share / share.sum())

    def half_angle(self, wavelength: float) -> float:
        """Return the half angle to which light spreads, in rad."""
        raise NotImplementedError


@dataclass(frozen=True)
class IncoherentLight(SpatialModel):
    """Limit of incoherent light: each sample has an independent phase in each snapshot.

    The degree of coherence of any two samples is 0. A shift-invariant system then images by the
    optical transfer function (Goodman 2005, section 6.3).

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> clear = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> lamp = clplen.Coherence(clplen.wave.IncoherentLight())
    >>> image = lamp.average(clplen.wave.Pupil(4e-3, 0.1), clear)
    >>> image.method, image.intensity.shape
    ('incoherent', (32, 32))
    """

    def field(
        self,
        grid: Grid,
        *,
        wavelength: float,
        device: DeviceLike | None = None,
        seed: int,
        index: int,
    ) -> Field:
        """Return a snapshot of unit amplitude with an independent uniform phase at each sample."""
        device = as_device(device)
        ny, nx = grid.shape
        out = device.empty(grid.shape, device.complex)
        kernel = device.kernel("masks.cl", "cell_phasors", **device.wave_defines())
        device.launch_rows(kernel, grid.shape, out, np.uint32(index), key_of(seed), ny, nx)
        return Field(out, grid, float(wavelength), device)

    def degree(self, dy: ArrayLike, dx: ArrayLike, *, wavelength: float = 0.0) -> Array:
        """Return 1 where both displacements are 0, else 0."""
        return ((np.asarray(dy) == 0) & (np.asarray(dx) == 0)).astype(np.float64)

    def power_spectrum(self, grid: Grid, *, wavelength: float = 0.0) -> Array:
        """Return equal shares at all frequencies."""
        return super().power_spectrum(grid, wavelength=wavelength)

    def half_angle(self, wavelength: float) -> float:
        """Return pi/2, since the light spreads in all directions."""
        return math.pi / 2
