"""Edges of masks: samples inside of outlines, and the band-limited samples of square pixels."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from clplen.wave.field.field import Grid
from clplen.wave.field.transmission import Vector, offsets

Edges = Literal["samples", "area", "pixels"]
EDGES: tuple[Edges, ...] = ("samples", "area", "pixels")
COORDINATE_TOLERANCE = 1e-9  # in cells: rounding of coordinates up to a million cells away


def check_edges(edges: str) -> None:
    """Raise unless ``edges`` is a known method."""
    if edges not in EDGES:
        raise ValueError(f"edges must be 'samples', 'area' or 'pixels', got {edges!r}.")


def interval_middles(offset: Vector, pitch: float, half: float) -> Vector:
    """Return 1 where the centre of a sample lies within +-half or on its ends, else 0."""
    return (np.abs(offset) <= half + COORDINATE_TOLERANCE * pitch).astype(np.float64)


def disc_middles(
    grid: Grid, radius: float, centre: tuple[float, float], *, inner: float = 0.0
) -> Vector:
    """Return 1 where the centre of a sample lies between two circles or on a circle, (ny, nx)."""
    y, x = offsets(grid, centre)
    r, margin = np.hypot(y[:, None], x), COORDINATE_TOLERANCE * min(grid.pitch)
    return ((r <= radius + margin) & (r >= inner - margin)).astype(np.float64)


def polygon_middles(grid: Grid, vertices: Any) -> Vector:
    """Return 1 where the centre of a sample lies in a polygon or on its outline, shape (ny, nx).

    A centre is inside if the outline crosses the line from it to the left an odd number of times.
    """
    (ny, nx), first = grid.shape, np.array([grid.y[0], grid.x[0]])
    corners = (np.asarray(vertices, np.float64) - first) / grid.pitch
    crossed, outline = np.zeros((ny, nx + 1), bool), np.zeros((ny, nx), bool)
    for (y0, x0), (y1, x1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        low, high = min(y0, y1), max(y0, y1)
        row = np.arange(
            max(np.ceil(low - COORDINATE_TOLERANCE), 0),
            min(np.floor(high + COORDINATE_TOLERANCE), ny - 1) + 1,
        )
        row = row.astype(np.int64)
        if high - low <= COORDINATE_TOLERANCE:  # along x
            left, right = np.clip(
                (min(x0, x1) - COORDINATE_TOLERANCE, max(x0, x1) + COORDINATE_TOLERANCE), -1, nx
            )
            outline[row, int(np.ceil(max(left, 0))) : int(np.floor(right)) + 1] = True
            continue
        x = x0 + np.clip((row - y0) / (y1 - y0), 0, 1) * (x1 - x0)
        nearest = np.clip(np.rint(x), 0, nx - 1).astype(np.int64)
        outline[row, nearest] |= np.abs(x - nearest) <= COORDINATE_TOLERANCE
        through = (row >= low) & (row < high)
        crossed[row[through], np.clip(np.ceil(x[through]), 0, nx).astype(np.int64)] ^= True
    inside = np.logical_xor.accumulate(crossed, axis=1)[:, :nx]
    return (inside | outline).astype(np.float64)


def square_samples(mask: Vector) -> Vector:
    """Return the band-limited samples of a mask of square pixels with the pitch of the samples.

    The spectrum of such a mask is that of its samples times sinc(f dx) along each axis. The result
    has this spectrum up to the Nyquist frequency: it is the mask convolved with w(k) = (Si(pi (k +
    1/2)) - Si(pi (k - 1/2)))/pi. The border values continue beyond the window. Axes of length 1 are
    unchanged.
    """
    for axis, n in enumerate(mask.shape):
        if n > 1:
            mask = np.moveaxis(_square_along_last(np.moveaxis(mask, axis, -1)), -1, axis)
    return mask


def square_samples_adjoint(samples: Vector) -> Vector:
    """Apply the transpose of `square_samples`, with equal shape."""
    for axis, n in enumerate(samples.shape):
        if n > 1:
            last = np.moveaxis(samples, axis, -1)
            mixed, beyond = _convolved(last)
            mixed[..., 0] += last @ beyond
            mixed[..., -1] += last @ beyond[::-1]
            samples = np.moveaxis(mixed, -1, axis)
    return samples


def _square_along_last(mask: Vector) -> Vector:
    mixed, beyond = _convolved(mask)
    return np.asarray(mixed + mask[..., :1] * beyond + mask[..., -1:] * beyond[::-1])


def _convolved(mask: Vector) -> tuple[Vector, Vector]:
    """Convolve a mask along its last axis with w, and return the weights of its border values."""
    from scipy import fft  # a local import, since it is slow

    n = mask.shape[-1]
    length = fft.next_fast_len(2 * n - 1, real=True)
    to_border = sine_integral(np.arange(2 * n) - n + 0.5)  # at borders of pixels from -n to n
    weight = np.zeros(length)
    weight[:n], weight[length - n + 1 :] = np.diff(to_border)[n - 1 :], np.diff(to_border)[: n - 1]
    if np.iscomplexobj(mask):
        mixed = fft.ifft(fft.fft(mask, length) * fft.fft(weight))[..., :n]
    else:
        mixed = fft.irfft(fft.rfft(mask, length) * fft.rfft(weight), length)[..., :n]
    return mixed, 0.5 - to_border[n:]  # weight of all pixels beyond the left border


def sine_integral(samples: Vector) -> Vector:
    """Return Si(pi t)/pi at distances in samples: a band-limited unit step less 1/2."""
    from scipy.special import sici

    return np.asarray(sici(np.pi * samples)[0] / np.pi)
