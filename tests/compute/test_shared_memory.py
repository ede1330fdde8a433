"""Memory that host and device share: addresses, lifetimes, what is not to be shared."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pyopencl.array as cla
import pytest

from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.compute.shared_memory import keep, lend, shares_memory

LARGE = 2**21 + 1  # samples: a buffer of the pool


def address(array: cla.Array, device: Device) -> int:
    with device.on_host(array, write=False) as values:
        return values.ctypes.data


@pytest.mark.parametrize("size", [1, 77, LARGE])
def test_a_cpu_reads_the_memory_of_the_host(device: Device, size: int) -> None:
    values = np.arange(size, dtype=np.float32)
    values.flags.writeable = False
    lent = lend(values, device)
    assert (lent.shape, lent.dtype) == (values.shape, values.dtype)
    if "Portable Computing Language" in device.platform:
        assert address(lent, device) == values.ctypes.data
    np.testing.assert_array_equal(device.download(lent), values)
    assert count_bad(lent, device) == 0  # a kernel reads it, too


def test_any_layout_is_lent(device: Device) -> None:
    for values in [
        np.arange(35, dtype=np.float32).reshape(5, 7).T,
        np.arange(35, dtype=np.float64)[::-2],
        np.empty((0, 3), np.float32),
        np.float32(4),
        np.frombuffer(bytes(range(9)), np.uint8)[1:].view(np.uint32),  # not aligned
    ]:
        values = np.asarray(values)
        lent = lend(values, device)
        assert lent.shape == values.shape
        if values.size:
            np.testing.assert_array_equal(device.download(lent), values)


@pytest.mark.parametrize("size", [77, LARGE])
def test_a_result_keeps_its_memory(device: Device, size: int) -> None:
    array = device.upload(np.arange(size, dtype=np.float32))
    where, buffer = address(array, device), weakref.ref(array)
    kept = keep(array, device)
    if device.is_cpu:
        assert kept.ctypes.data == where
    part = kept[5:]
    del array, kept
    gc.collect()
    assert (buffer() is not None) == device.is_cpu
    others = [device.zeros((size,), np.float32) for _ in range(3)]  # of the pool, had it the buffer
    device.finish()
    assert part[0] == 5
    assert part[-1] == size - 1
    part += 1  # it may be written to
    assert part[0] == 6
    del part, others
    gc.collect()
    assert buffer() is None


def test_a_part_of_a_buffer_is_kept(device: Device) -> None:
    array = device.upload(np.arange(24, dtype=np.float32).reshape(4, 6))
    np.testing.assert_array_equal(keep(array[1:3], device), np.arange(6, 18).reshape(2, 6))
    assert keep(device.empty((0, 3), np.float32), device).shape == (0, 3)


def test_arrays_of_one_buffer_are_told(device: Device) -> None:
    a, b = (device.upload(np.zeros((2, 3), np.float32)) for _ in range(2))
    assert shares_memory(a, a[1:])
    assert shares_memory(a, a.reshape(6))
    assert not shares_memory(a, b)
