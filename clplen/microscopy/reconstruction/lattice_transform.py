"""Pictures of lenslets to packed spectra and back on CPUs, sixteen pairs of samples at a time.

What decimate, the Fourier transforms and pack do one after the other, kernels of
lattice_transform.cl do in the second-level cache: a field of pairs never is in memory.
"""

from __future__ import annotations

import math

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.microscopy.model.cells import Pair
from clplen.types import Array

LANES = 16  # fields that are transformed together
RADICES = (4, 7, 5, 3, 2)
OF_CORE = 4  # items, so that cores end at the same time
_LINES = 10  # of scratch, besides a window


class LatticeTransform:
    """The kernels of lattice_transform.cl for one window of the lattice."""

    def __init__(self, device: Device, window: Pair) -> None:
        self.device, self.window = device, window

    def nbytes(self, batch: int) -> int:
        """Bytes of scratch for so many fields."""
        ny, nx = self.window
        return 4 * LANES * self._items(batch) * (2 * ny * nx + _LINES * max(ny, nx))

    def run(
        self,
        name: str,
        out: cla.Array,
        given: cla.Array,
        w: Pair,
        frames: int,
        stack: tuple[int, int, int],
        shape: Pair,
        parts: tuple[int, ...],
        *least: float,
    ) -> None:
        """Make packed "spectra" of pictures with wy x wx samples a cell, or "pictures" of them."""
        device, (ny, nx) = self.device, self.window
        batch = frames * stack[0] * ((math.prod(w) + 1) // 2)
        scratch = device.empty((self.nbytes(batch) // 4,), np.float32)
        sizes = (batch, *w, *stack, *shape, len(parts), bits_of(parts), ny, nx)
        device.launch(
            device.kernel("lattice_transform.cl", name), (self._items(batch),), out, given,
            scratch, *self._tables(ny), *self._tables(nx), *map(np.float32, least),
            *(np.int32(k) for k in sizes),
            group=(1,),
            operations=batch * 5.0 * ny * nx * math.log2(max(2, ny * nx)),
        )  # fmt: skip

    def _tables(self, n: int) -> tuple[cla.Array, cla.Array]:
        """Of a transform over n samples, on the device."""
        kept: tuple[cla.Array, cla.Array] | None = self.device.tables.get(("lattice transform", n))
        if kept is not None:
            return kept
        turns, radices = self.device.upload(_turns(n)), self.device.upload(radices_of(n))
        nbytes = int(turns.nbytes + radices.nbytes)
        return self.device.tables.keep(("lattice transform", n), (turns, radices), nbytes)

    def _items(self, batch: int) -> int:
        """Work-items, each of which has scratch of its own."""
        return min(-(-batch // LANES), OF_CORE * int(self.device.cl_device.max_compute_units))


def radices_of(n: int) -> Array:
    """The radices of a transform over n samples, in order, and 0; int32."""
    found = []
    for radix in RADICES:
        while n % radix == 0:
            n //= radix
            found.append(radix)
    return np.array([*(found or [1]), 0], np.int32)


def bits_of(parts: tuple[int, ...]) -> int:
    """The numbers of parts, two bits each."""
    return sum(part << 2 * number for number, part in enumerate(parts))


def _turns(n: int) -> Array:
    """exp(-2 pi i t/n), t < n, complex64, each rounded once."""
    return np.exp(-2j * np.pi * np.arange(n) / n).astype(np.complex64)
