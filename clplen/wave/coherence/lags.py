"""Partially coherent images as a sum over the displacements over which light is coherent."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.wave.field.field import Field

Values = np.ndarray[Any, Any]

BATCH_BYTES = 2**23  # of one array of a batch; less and more are slower on CPUs
BLOCK = 256  # terms added up in the device's precision before they join a sum in double
NOTHING = 1e-11  # sum of degrees of coherence that counts as rounding of their transform


@dataclass(frozen=True, eq=False)
class Lags:
    """Displacements that matter, one of each pair d, -d."""

    places: Values  # int32, shape (n, 2): (dy, dx) in samples, 0 to N - 1
    weights: Values  # complex128, shape (n,): mu(d), twice that for one of a pair
    dropped: float  # sum of abs(mu) over what was left out

    @classmethod
    def of(cls, source: Values, tolerance: float) -> Lags:
        """The lags of a source: mu(d) = sum_f S(f) exp(2 pi i f d) (van Cittert and Zernike)."""
        ny, nx = source.shape
        mu = np.fft.ifft2(source) * source.size
        row, column = np.divmod(np.arange(source.size), nx)
        partner = (-row % ny) * nx + -column % nx
        first = np.flatnonzero(np.arange(source.size) <= partner)
        weights = np.where(first == partner[first], 1, 2) * mu.ravel()[first]
        selected, dropped = strongest(np.abs(weights), max(tolerance, NOTHING))
        places = np.stack([row, column], axis=-1)[first[selected]].astype(np.int32)
        return cls(places, weights[selected], dropped)


def strongest(weights: Values, tolerance: float) -> tuple[Values, float]:
    """Places of all weights but the weakest that add up to at most ``tolerance``; their sum."""
    order = np.argsort(weights, kind="stable")
    sums = np.cumsum(weights[order])
    left_out = int(np.searchsorted(sums, tolerance * (1 + 1e-12), side="right"))
    return np.sort(order[left_out:]), float(sums[left_out - 1]) if left_out else 0.0


def lag_image(field: Field, transfer: Values, lags: Lags) -> Values:
    """Mean intensity behind a periodic filter, by displacements d = x1 - x2 of pairs of points.

    I = sum_d mu(d) (g_d * t_d), t_d(x) = t(x) t*(x - d), g_d(y) = h(y) h*(y + d), h the impulse
    response, * a circular convolution: the image of the mutual intensity (Goodman 2015, section
    7.2.2) with the displacement as the outer sum. -d gives the conjugate of d. Two transforms a
    pair of displacements; of incoherent light, mu(d) = 0 but for d = 0, two in all.
    """
    device, shape = field.device, field.grid.shape
    h = device.upload(np.fft.ifft2(transfer).astype(device.complex))
    count = batch_count(math.prod(shape), device)
    device.require_memory(
        (2 * count + 3) * math.prod(shape) * device.complex.itemsize, "A mean image"
    )
    back = lags.places
    there = (-back % np.array(shape, np.int32)).astype(np.int32)
    total = np.zeros(shape, np.complex128)
    for start in range(0, len(back), BLOCK):
        stop = min(start + BLOCK, len(back))
        sums = device.zeros(shape, device.complex)
        for low in range(start, stop, count):
            part = slice(low, min(low + count, stop))
            T = _spectra(field.data, there[part], device)
            G = _spectra(h, back[part], device)
            _add(sums, T, G, lags.weights[part], device)
        total += device.download(sums)
    return np.maximum(np.fft.ifft2(total).real, 0)


def lag_flops(shape: tuple[int, int], count: int) -> float:
    """Operations of `lag_image`: two transforms and about 50 operations a sample and lag."""
    size = math.prod(shape)
    return count * size * (2 * 5 * math.log2(max(size, 2)) + 50)


def batch_count(samples: int, device: Device) -> int:
    """How many windows of so many complex samples go together."""
    return max(1, BATCH_BYTES // (samples * device.complex.itemsize))


def _spectra(a: Any, shifts: Values, device: Device) -> Any:
    """Transforms of a(x) a*(x + shift), shape (count, ny, nx)."""
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
