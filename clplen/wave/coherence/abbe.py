"""Exact mean images of shift-invariant systems in partially coherent light (Abbe's sum).

The sum has two routes: over the points of the source, or over the displacements within the
coherence length (lags.py). A source of few points has a long coherence length, and vice versa; the
cheaper route is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from clplen.checks import host_array, real_array
from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.compute.fft.lines import smooth_length
from clplen.errors import ShapeError
from clplen.wave.coherence.lags import BLOCK, Lags, batch_count, lag_flops, lag_image, strongest
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import accumulate

Values = np.ndarray[Any, Any]
Route = Literal["auto", "points", "lags"]

MIN_LIGHT_SHARE = 1e-13  # weaker light behind the pupil is rounding of the object's spectrum
SOURCE_TOLERANCE = 1e-9  # rounding of a source below 0, or of its sum from 1
SAMPLE_OPERATIONS = 20  # operations per sample and source point besides the transform


class AbbeImage(NamedTuple):
    """Mean intensity and the number of terms in its sum.

    Attributes
    ----------
    intensity : Image
        Intensity, real, not negative, shape (ny, nx).
    terms : int
        Number of coherent images (route "points") or pairs of displacements (route "lags").
    dropped : float
        Sum of S (route "points") or abs(mu) (route "lags") over the omitted terms.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> clear = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> square = clplen.wave.rectangular_aperture(clear, 105e-6)
    >>> pupil = clplen.wave.Pupil(4e-3, 0.1).transfer(grid, 500e-9)
    >>> source = clplen.wave.RandomPhaseMask(80e-6).power_spectrum(grid, wavelength=500e-9)
    >>> image = clplen.wave.abbe_image(square, pupil, source)
    >>> image.intensity.shape, image.terms > 1
    ((32, 32), True)
    """

    intensity: Image
    terms: int
    dropped: float


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a source."""

    indices: Values  # rows and columns of S, shape (n, 2)
    weights: Values  # values of S, float64, shape (n,)
    dropped: float  # sum of S over the omitted positive points

    @classmethod
    def of(cls, source: Values, tolerance: float) -> Points:
        """Return the positive points without the weakest, whose sum is at most ``tolerance``."""
        indices = np.argwhere(source > 0)
        weights = source[source > 0]
        selected, dropped = strongest(weights, tolerance)
        return cls(indices[selected], weights[selected], dropped)

    def lit(self, spectrum: Values, transfer: Values) -> Points:
        """Return the points whose light sum_f' |O(f' - f) H(f')|^2 passes the pupil."""
        power = np.abs(spectrum.astype(np.complex128)) ** 2
        passed = np.fft.fft2(np.abs(transfer) ** 2) * np.conj(np.fft.fft2(power))
        light = self.weights * np.maximum(np.fft.ifft2(passed).real, 0)[tuple(self.indices.T)]
        selected, _ = strongest(light, MIN_LIGHT_SHARE * light.sum())
        return Points(self.indices[selected], self.weights[selected], self.dropped)


@dataclass(frozen=True)
class Box:
    """Part of an N-periodic spectrum that contains all frequencies of a transfer function."""

    shape: tuple[int, int]  # (ny, nx) of the spectrum
    start: tuple[int, int]  # FFT index of the first row and column
    size: tuple[int, int]  # (h, w) rows and columns

    @classmethod
    def of(cls, transfer: Values) -> Box:
        """Return the smallest box of a transfer function."""
        used = transfer != 0
        (y, h), (x, w) = _shortest(used.any(axis=1)), _shortest(used.any(axis=0))
        return cls((transfer.shape[0], transfer.shape[1]), (y, x), (h, w))

    @property
    def window(self) -> tuple[int, int]:
        """Numbers of samples of the intensity, with a band of 2 h - 1 by 2 w - 1, at most N."""
        ny, nx = (
            min(n, smooth_length(2 * size - 1))
            for n, size in zip(self.shape, self.size, strict=True)
        )
        return ny, nx

    def cut(self, transfer: Values) -> Values:
        """Return the transfer function in the box, scaled for a field sampled in the window."""
        rows, columns = (
            np.arange(start, start + size) % n
            for start, size, n in zip(self.start, self.size, self.shape, strict=True)
        )
        scale = math.prod(self.window) / math.prod(self.shape)
        return np.asarray(transfer[np.ix_(rows, columns)] * scale)


def abbe_image(
    field: Field, transfer: Any, source: Any, *, tolerance: float = 0.0, route: Route = "auto"
) -> AbbeImage:
    """Return the mean image of an object in partially coherent light, in a periodic window.

    I = sum_f S(f) abs(IFFT(O(f' - f) H(f')))^2 with the object's spectrum O. Each point of the
    source illuminates the object by a plane wave (Abbe's approach: Goodman 2015, section 7.2.1).

    Parameters
    ----------
    field : Field
        Object in a plane wave of unit intensity, shape (ny, nx).
    transfer : array_like
        Transfer function H, complex, shape (ny, nx), FFT order: `Pupil.transfer` or `transfer_of`.
    source : array_like
        Power spectrum S of the light, shape (ny, nx), FFT order, sum 1; points of value 0 are
        skipped.
    tolerance : float
        Maximum sum of the omitted weakest terms, at least 0 and below 1. Route "points" omits
        points by S, with an error of at most tolerance in a clear field. Route "lags" omits
        displacements by abs(mu), with an error of at most tolerance max abs(u)^2 sum abs(H)^2/(ny
        nx).
    route : {"auto", "points", "lags"}
        Sum over source points, sum over displacements, or the cheaper of the two.

    Returns
    -------
    AbbeImage
        Mean image. A clear field has the intensity sum_f S(f) abs(H(f))^2, without the light that
        the pupil stops.

    Raises
    ------
    ShapeError
        If the field is a batch, or a transfer function or source has another shape.
    ValueError
        If values are not finite, the source is negative or does not add up to 1, or the tolerance
        or route is invalid.

    Notes
    -----
    The error is at most 1e-5 of the largest intensity in single precision. Source points that
    together send less than 1e-13 of the light through the pupil are skipped.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> clear = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> square = clplen.wave.rectangular_aperture(clear, 105e-6)
    >>> pupil = clplen.wave.Pupil(4e-3, 0.1).transfer(grid, 500e-9)
    >>> source = clplen.wave.RandomPhaseMask(80e-6).power_spectrum(grid, wavelength=500e-9)
    >>> image = clplen.wave.abbe_image(square, pupil, source)
    >>> f"{image.intensity.to_numpy()[16, 16]:.3f} in the middle"
    '0.943 in the middle'
    """
    _check_field(field)
    H, S = _checked_transfer(transfer, field.shape), _checked_source(source, field.shape)
    chosen, _ = _choose(H, S, tolerance, route)
    device = field.device
    if isinstance(chosen, Lags):
        mean = lag_image(field, H, chosen)
        return AbbeImage(_image(mean, device), len(chosen.weights), chosen.dropped)
    spectrum = device.upload(field.to_numpy())
    device.fft.forward(spectrum, device)
    points = chosen.lit(device.download(spectrum), H)
    mean = _sum_of_images(spectrum, H, points, device)
    return AbbeImage(_image(mean, device), len(points.weights), points.dropped)


def incoherent_image(field: Field, transfer: Any) -> Image:
    """Return the image of an object in incoherent light, in a periodic window.

    The autocorrelation of H over N^2 filters abs(t)^2 (Goodman 2005, section 6.3.1); it wraps if H
    is wider than half the lattice. `abbe_image` agrees for the source 1/(ny nx) at each frequency.

    Parameters
    ----------
    field : Field
        Transmission t of the object, shape (ny, nx); its phase has no effect.
    transfer : array_like
        Transfer function H, complex, shape (ny, nx), FFT order: `Pupil.transfer`.

    Returns
    -------
    Image
        Intensity, real, shape (ny, nx). A clear field has the value sum_f abs(H(f))^2/(ny nx).

    Raises
    ------
    ShapeError, ValueError
        In the cases of `abbe_image`.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> bars = np.sqrt((1 + np.cos(2 * np.pi * grid.x / 80e-6)) / 2) * np.ones((64, 1))
    >>> target = clplen.Field.from_array(bars, grid, wavelength=500e-9)
    >>> pupil = clplen.wave.Pupil.of_cutoff(20e3, 500e-9).transfer(grid, 500e-9)
    >>> line = clplen.wave.incoherent_image(target, pupil).to_numpy()[16]
    >>> contrast = (line.max() - line.min()) / (line.max() + line.min())
    >>> f"contrast {contrast:.1f}, by the OTF {clplen.wave.otf(12.5 / 40):.1f}"
    'contrast 0.6, by the OTF 0.6'
    """
    _check_field(field)
    H = _checked_transfer(transfer, field.shape)
    alone = Lags(np.zeros((1, 2), np.int32), np.ones(1, np.complex128), 0.0)
    return _image(lag_image(field, H, alone), field.device)


def abbe_cost(
    grid: Grid, transfer: Any, source: Any, *, tolerance: float = 0.0, route: Route = "auto"
) -> float:
    """Return the number of operations of `abbe_image`, 5 N log2 N per Fourier transform."""
    H, S = _checked_transfer(transfer, grid.shape), _checked_source(source, grid.shape)
    return _choose(H, S, tolerance, route)[1]


def _choose(
    transfer: Values, source: Values, tolerance: float, route: str
) -> tuple[Points | Lags, float]:
    """Return the terms of the cheaper sum, and the number of its operations."""
    if not 0 <= tolerance < 1:
        raise ValueError(f"tolerance must be at least 0 and below 1, got {tolerance!r}.")
    if route not in ("auto", "points", "lags"):
        raise ValueError(f"route must be 'auto', 'points' or 'lags', got {route!r}.")
    candidates: list[tuple[Points | Lags, float]] = []
    if route != "lags":
        points = Points.of(source, tolerance)
        size = math.prod(Box.of(transfer).window)
        each = size * (5 * math.log2(max(size, 2)) + SAMPLE_OPERATIONS)
        candidates.append((points, len(points.weights) * each))
    if route != "points":
        lags = Lags.of(source, tolerance)
        candidates.append((lags, lag_flops(source.shape, len(lags.weights))))
    return min(candidates, key=lambda candidate: candidate[1])


def _sum_of_images(spectrum: Any, transfer: Values, points: Points, device: Device) -> Values:
    """Return sum_f S(f) |IFFT(O(f' - f) H(f'))|^2, float64, shape (ny, nx).

    The device adds blocks of images in the window of the pupil's box, the host adds the blocks.
    """
    box = Box.of(transfer)
    pupil = device.upload(box.cut(transfer).astype(device.complex))
    first = (np.array(box.start) - points.indices) % box.shape
    count = batch_count(math.prod(box.window), device)
    device.require_memory(count * math.prod(box.window) * device.complex.itemsize, "Abbe's sum")
    total = np.zeros(box.window)
    for start in range(0, len(first), BLOCK):
        stop = min(start + BLOCK, len(first))
        sums = device.zeros(box.window, device.real)
        for low in range(start, stop, count):
            part = slice(low, min(low + count, stop))
            images = _images(spectrum, pupil, first[part].astype(np.int32), box, device)
            accumulate(sums, images, points.weights[part], device)
        total += device.download(sums)
    return np.maximum(_resampled(total, box.shape), 0)


def _images(spectrum: Any, pupil: Any, first: Values, box: Box, device: Device) -> Any:
    """Return the fields behind the pupil in the window, shape (count, my, mx)."""
    out = device.empty((len(first), *box.window), device.complex)
    device.launch_rows(
        device.kernel("abbe.cl", "shifted_spectra", **device.wave_defines()),
        out.shape, out, spectrum, pupil, device.upload(first),
        *box.size,
        *box.window,
        *box.shape,
    )  # fmt: skip
    device.fft.inverse(out, device)
    return out


def _resampled(intensity: Values, shape: tuple[int, int]) -> Values:
    """Interpolate a periodic band-limited intensity to a finer lattice with equal sample 0."""
    if intensity.shape == shape:
        return intensity
    spectrum = np.fft.fftshift(np.fft.fft2(intensity))
    wide = [
        (n // 2 - m // 2, n - m - (n // 2 - m // 2))
        for n, m in zip(shape, intensity.shape, strict=True)
    ]
    scale = math.prod(shape) / intensity.size
    padded = np.fft.ifftshift(np.pad(spectrum, wide))
    return np.asarray(np.fft.ifft2(padded).real * scale)


def _shortest(used: Values) -> tuple[int, int]:
    """Return first index and length of the shortest periodic range that holds all used indices."""
    indices = np.flatnonzero(used)
    gaps = np.diff(indices, append=indices[0] + len(used))
    widest = int(np.argmax(gaps))
    return int(indices[(widest + 1) % len(indices)]), len(used) - int(gaps[widest]) + 1


def _image(values: Values, device: Device) -> Image:
    return Image(device.upload(values.astype(device.real)), device)


def _check_field(field: Field) -> None:
    if not isinstance(field, Field):
        raise TypeError(f"field must be a Field, got {type(field).__name__}.")
    if len(field.shape) != 2:
        raise ShapeError(
            f"field must be a single field of shape (ny, nx), got {field.shape}; pass the fields "
            "of a batch separately."
        )


def _checked_transfer(transfer: Any, shape: tuple[int, ...]) -> Values:
    H = np.asarray(host_array(transfer, "transfer"), np.complex128)
    if H.shape != shape:
        raise ShapeError(f"transfer must have the field's shape {shape}, got {H.shape}.")
    if not np.isfinite(H).all():
        raise ValueError("transfer must be finite at every frequency.")
    if not H.any():
        raise ValueError("transfer must not be 0 at every frequency.")
    return H


def _checked_source(source: Any, shape: tuple[int, ...]) -> Values:
    S = real_array(source, "source", np.float64)
    if S.shape != shape:
        raise ShapeError(f"source must have the field's shape {shape}, got {S.shape}.")
    total = S.sum()
    if not (
        np.isfinite(S).all() and S.min() >= -SOURCE_TOLERANCE and abs(total - 1) <= SOURCE_TOLERANCE
    ):
        raise ValueError(
            f"source must be finite, not negative and add up to 1, got a minimum of {S.min():.3g} "
            f"and a sum of {total:.9g}; divide it by its sum."
        )
    return np.maximum(S, 0)
