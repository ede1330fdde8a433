"""Partially coherent images as a sum over the displacements within the coherence length."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.wave.field.field import Field

Values = np.ndarray[Any, Any]

BATCH_BYTES = 2**23  # bytes of an array of a batch; smaller and larger are slower on CPUs
BLOCK = 256  # terms added in the device's precision before they join a sum in double
MIN_DEGREE_SUM = 1e-11  # sum of abs(mu) below which terms are rounding errors


@dataclass(frozen=True, eq=False)
class Lags:
    """Displacements with their degrees of coherence, one of each pair d, -d."""

    shifts: Values  # int32, shape (n, 2): (dy, dx) in samples, 0 to N - 1
    weights: Values  # complex128, shape (n,): mu(d), doubled if -d is a different lag
    dropped: float  # sum of abs(mu) over the omitted lags

    @classmethod
    def of(cls, source: Values, tolerance: float) -> Lags:
        """Return the lags of a source: mu(d) = sum_f S(f) exp(2 pi i f d) (van Cittert-Zernike)."""
        ny, nx = source.shape
        mu = np.fft.ifft2(source) * source.size
        row, column = np.divmod(np.arange(source.size), nx)
        partner = (-row % ny) * nx + -column % nx
        first = np.flatnonzero(np.arange(source.size) <= partner)
        weights = np.where(first == partner[first], 1, 2) * mu.ravel()[first]
        selected, dropped = strongest(np.abs(weights), max(tolerance, MIN_DEGREE_SUM))
        shifts = np.stack([row, column], axis=-1)[first[selected]].astype(np.int32)
        return cls(shifts, weights[selected], dropped)


def strongest(weights: Values, tolerance: float) -> tuple[Values, float]:
    """Return indices of all but the weakest weights, and the sum of those left out.

    The sum is at most ``tolerance``.
    """
    order = np.argsort(weights, kind="stable")
    sums = np.cumsum(weights[order])
    left_out = int(np.searchsorted(sums, tolerance * (1 + 1e-12), side="right"))
    return np.sort(order[left_out:]), float(sums[left_out - 1]) if left_out else 0.0


def lag_image(field: Field, transfer: Values, lags: Lags) -> Values:
    """Return the mean intensity behind a periodic filter, summed over displacements d = x1 - x2.

    I = sum_d mu(d) (g_d * t_d) with t_d(x) = t(x) t*(x - d), g_d(y) = h(y) h*(y + d), the impulse
    response h and circular convolution *. It is the image of the mutual intensity (Goodman 2015,
    section 7.2.2) with the displacement as the outer sum; -d gives the conjugate of d. Each pair of
    displacements needs two transforms; incoherent light has only d = 0.
    """
    device, shape = field.device, field.grid.shape
    h = device.upload(np.fft.ifft2(transfer).astype(device.complex))
    count = batch_count(math.prod(shape), device)
    device.require_memory(
        (2 * count + 3) * math.prod(shape) * device.complex.itemsize, "A mean image"
    )
    shifts = lags.shifts
    opposite = (-shifts % np.array(shape, np.int32)).astype(np.int32)
    total = np.zeros(shape, np.complex128)
    for start in range(0, len(shifts), BLOCK):
        stop = min(start + BLOCK, len(shifts))
        sums = device.zeros(shape, device.complex)
        for low in range(start, stop, count):
            part = slice(low, min(low + count, stop))
            T = _spectra(field.data, opposite[part], device)
            G = _spectra(h, shifts[part], device)
            _add(sums, T, G, lags.weights[part], device)
        total += device.download(sums)
    return np.maximum(np.fft.ifft2(total).real, 0)


def lag_flops(shape: tuple[int, int], count: int) -> float:
    """Return the operations of `lag_image`: two transforms and about 50 per sample and lag."""
    size = math.prod(shape)
    return count * size * (2 * 5 * math.log2(max(size, 2)) + 50)


def batch_count(samples: int, device: Device) -> int:
    """Return the number of windows of complex samples in a batch."""
    return max(1, BATCH_BYTES // (samples * device.complex.itemsize))


def _spectra(a: Any, shifts: Values, device: Device) -> Any:
    """Return the transforms of a(x) a*(x + shift), shape (count, ny, nx)."""
    ny, nx = a.shape
    out = device.empty((len(shifts), ny, nx), device.complex)
    device.launch_rows(
        device.kernel("lags.cl", "lag_products", **device.wave_defines()),
        out.shape, out, a, device.upload(shifts), ny, nx,
    )  # fmt: skip
    device.fft.forward(out, device)
    return out


def _add(sums: Any, T: Any, G: Any, weights: Values, device: Device) -> None:
    ny, nx = sums.shape
    device.launch_rows(
        device.kernel("lags.cl", "add_products", **device.wave_defines()),
        sums.shape, sums, T, G, device.upload(weights.astype(device.complex)),
        len(weights), ny, nx,
    )  # fmt: skip
