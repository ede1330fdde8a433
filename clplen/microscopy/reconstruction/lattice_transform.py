"""Transforms of lenslet pictures to packed spectra and back on CPUs, sixteen pairs at a time.

The kernels of lattice_transform.cl fuse decimation, Fourier transforms and packing in the
second-level cache, without a field of pairs in memory.
"""

from __future__ import annotations

import math

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.microscopy.model.cells import Pair
from clplen.types import Array

LANES = 16  # fields that a work-item transforms together
RADICES = (4, 7, 5, 3, 2)
ITEMS_PER_CORE = 4  # work-items, to balance the load of the cores
_SCRATCH_LINES = 10  # of scratch memory, besides a window


class LatticeTransform:
    """Kernels of lattice_transform.cl for a window of the lattice."""

    def __init__(self, device: Device, window: Pair) -> None:
        self.device, self.window = device, window

    def nbytes(self, batch: int) -> int:
        """Return the scratch memory for a batch of fields, in bytes."""
        ny, nx = self.window
        return 4 * LANES * self._items(batch) * (2 * ny * nx + _SCRATCH_LINES * max(ny, nx))

    def run(
        self,
        name: str,
        out: cla.Array,
        source: cla.Array,
        w: Pair,
        frames: int,
        stack: tuple[int, int, int],
        shape: Pair,
        parts: tuple[int, ...],
        *minimum: float,
    ) -> None:
        """Convert pictures with wy x wx samples per cell to packed "spectra", or to "pictures"."""
        device, (ny, nx) = self.device, self.window
        batch = frames * stack[0] * ((math.prod(w) + 1) // 2)
        scratch = device.empty((self.nbytes(batch) // 4,), np.float32)
        sizes = (batch, *w, *stack, *shape, len(parts), bits_of(parts), ny, nx)
        device.launch(
            device.kernel("lattice_transform.cl", name), (self._items(batch),), out, source,
            scratch, *self._tables(ny), *self._tables(nx), *map(np.float32, minimum),
            *(np.int32(k) for k in sizes),
            group=(1,),
            operations=batch * 5.0 * ny * nx * math.log2(max(2, ny * nx)),
        )  # fmt: skip

    def _tables(self, n: int) -> tuple[cla.Array, cla.Array]:
        """Return the twiddle factors and radices of a transform over n samples, on the device."""
        key = ("lattice transform", n)
        cached: tuple[cla.Array, cla.Array] | None = self.device.tables.get(key)
        if cached is not None:
            return cached
        factors, radices = self.device.upload(_twiddles(n)), self.device.upload(radices_of(n))
        nbytes = int(factors.nbytes + radices.nbytes)
        return self.device.tables.keep(key, (factors, radices), nbytes)

    def _items(self, batch: int) -> int:
        """Return the number of work-items, each with its own scratch memory."""
        cores = int(self.device.cl_device.max_compute_units)
        return min(-(-batch // LANES), ITEMS_PER_CORE * cores)


def radices_of(n: int) -> Array:
    """Return the radices of a transform over n samples, terminated by 0; int32."""
    factors = []
    for radix in RADICES:
        while n % radix == 0:
            n //= radix
            factors.append(radix)
    return np.array([*(factors or [1]), 0], np.int32)


def bits_of(parts: tuple[int, ...]) -> int:
    """Pack the numbers of parts, two bits each."""
    return sum(part << 2 * number for number, part in enumerate(parts))


def _twiddles(n: int) -> Array:
    """Return exp(-2 pi i t/n) for t < n, complex64, computed in complex128."""
    return np.exp(-2j * np.pi * np.arange(n) / n).astype(np.complex64)
