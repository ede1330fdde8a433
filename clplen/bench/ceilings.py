"""Ceilings of a machine: memory copies, multiply-adds, transforms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.bench.measure import Case, finished, in_turn
from clplen.compute.device import Device

_INPUTS = 256  # floats, which fit the first cache
_CHAINS = {16: 12, 8: 10, 4: 10, 1: 16}  # independent sums, by floats of a vector


@dataclass(frozen=True)
class Ceilings:
    """Bytes per second of a copy, and float32 operations per second in registers."""

    bytes_per_second: float
    operations_per_second: float

    def fraction(self, seconds: float, nbytes: float, operations: float) -> tuple[float, str]:
        """Return the share of the limiting ceiling and its name, "memory" or "arithmetic"."""
        memory = nbytes / self.bytes_per_second
        arithmetic = operations / self.operations_per_second
        limit, name = max((memory, "memory"), (arithmetic, "arithmetic"))
        return (limit / seconds if seconds else math.nan), name


def measure(device: Device, *, nbytes: int = 2**28, repeats: int = 5) -> Ceilings:
    """Measure both ceilings in turn."""
    cases = [copy(device, nbytes), multiply_add(device)]
    memory, arithmetic = in_turn(cases, repeats)
    return Ceilings(memory.rate, arithmetic.rate)


def copy(device: Device, nbytes: int, name: str = "copy of as many bytes") -> Case:
    """Create a copy within the device's memory; its work counts bytes read and written."""
    count = max(1, nbytes // 4)
    source, target = (device.zeros((count,), np.float32) for _ in range(2))
    run = finished(lambda: device.copy_into(target, source, 0), device)
    return Case(name, run, 8.0 * count, "bytes")


def multiply_add(device: Device, *, rounds: int | None = None) -> Case:
    """Create multiply-adds in registers on every core, two operations each."""
    lanes = min(max(int(device.cl_device.native_vector_width_float), 4), 16) if device.rows else 1
    chains = _CHAINS[max(n for n in _CHAINS if n <= lanes)]
    units = int(device.cl_device.max_compute_units)
    items = (4 if device.rows else 4096) * units
    rounds = rounds or (1 << 20 if device.rows else 1 << 14)
    kernel = device.kernel("ceiling.cl", "multiply_add", LANES=lanes, CHAINS=chains)
    inputs = device.upload(np.linspace(0.1, 0.9, _INPUTS, dtype=np.float32))
    out = device.empty((items,), np.float32)
    numbers = (np.int32(_INPUTS - 1), np.int32(rounds), np.float32(0.5))
    operations = 2.0 * lanes * chains * rounds * items

    def run() -> None:
        device.launch(kernel, (items,), out, inputs, *numbers, operations=operations)

    return Case("multiply-adds in registers", finished(run, device), operations, "operations")


def bare_fft(
    shape: tuple[int, ...], device: Device, *, count: int = 1, axes: tuple[int, ...] = (-2, -1)
) -> Case:
    """Create `count` in-place transforms of a complex array by the device's FFT route."""
    rng = np.random.default_rng(1)
    values = rng.random(shape, dtype=np.float32).astype(device.complex)
    array: Any = device.upload(values)

    def run() -> None:
        for n in range(count):
            device.fft.transform(array, device, axes=axes, forward=n % 2 == 0)

    times = "x".join(str(n) for n in shape)
    name = f"{count} bare FFT{'s' * (count != 1)} of {times}"
    return Case(name, finished(run, device), float(count), "transforms")
