"""Small arrays on their way to a device with memory of its own."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.compute.device import Device


@pytest.fixture
def gpu(device: Device) -> Device:
    """The device taken for a GPU."""
    mock = Device(device.cl_device)
    mock.is_cpu = mock.rows = False
    return mock


def test_an_array_may_be_changed_after_it_was_uploaded(gpu: Device) -> None:
    values = np.arange(300, dtype=np.float32)
    kept = [gpu.upload(values)]
    for _ in range(200):
        values += 1
        kept.append(gpu.upload(values))
    first = np.arange(300, dtype=np.float32)
    for t, array in enumerate(kept):
        assert np.array_equal(gpu.download(array), first + t)


def test_memory_that_comes_back_is_written_in_order(gpu: Device) -> None:
    """A buffer that is let go while a kernel reads it goes to the next array of its size."""
    kernel = gpu.kernel("multiply.cl", "multiply")
    shape = (64, 96)
    one = gpu.upload(np.ones(shape, np.complex64))
    size = np.int32(64), np.int32(96)
    products = []
    for t in range(50):
        factor = gpu.upload(np.full(shape, t + 1j, np.complex64))
        products.append(gpu.empty(shape, np.complex64))
        gpu.launch_rows(kernel, shape, products[-1], one, factor, *size)
        del factor
    for t, product in enumerate(products):
        assert np.array_equal(gpu.download(product), np.full(shape, t + 1j, np.complex64))
