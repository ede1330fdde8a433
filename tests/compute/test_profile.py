"""What ran on a device, and for how long."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.compute.profile import label


def multiply(device: Device, n: int, operations: float = 0.0) -> None:
    """A product of two complex fields of n x n samples."""
    fields = [device.zeros((n, n), device.complex) for _ in range(3)]
    kernel = device.kernel("multiply.cl", "multiply", **device.wave_defines())
    sizes = (np.int32(n), np.int32(n))
    device.launch_rows(kernel, (n, n), *fields, *sizes, operations=operations)


def test_a_kernel_is_noted_with_its_bytes_and_operations(device: Device) -> None:
    n = 40
    with device.profiling() as profile:
        multiply(device, n, operations=6.0 * n * n)
    (run,) = (run for run in profile.runs if run.name.startswith("multiply"))
    assert run.nbytes == 3 * n * n * device.complex.itemsize
    assert run.operations == 6 * n * n
    assert 0 < run.seconds < 60
    field = device.zeros((n, n), device.complex)
    kernel = device.kernel("multiply.cl", "multiply", **device.wave_defines())
    with device.profiling() as profile:  # an array given three times counts once
        device.launch_rows(kernel, (n, n), field, field, field, np.int32(n), np.int32(n))
    assert profile.runs[-1].nbytes == field.nbytes


def test_copies_of_lines_are_noted_and_right(device: Device) -> None:
    values = np.arange(24.0, dtype=np.float32).reshape(4, 6)
    there, twin = device.upload(values), device.zeros((4, 3), np.float32)
    with device.profiling() as profile:
        device.copy_lines(twin, there, (8, 4), (12, 24), (4, 12))
    expected = np.pad(values[:, 3:5], ((0, 0), (1, 0)))
    assert np.array_equal(device.download(twin), expected)
    assert [(run.name, run.nbytes) for run in profile.runs] == [("copy", 64)]


def test_a_transform_is_noted_with_its_operations(device: Device) -> None:
    field = device.zeros((16, 32), device.complex)
    with device.profiling() as profile:
        device.fft.forward(field, device)
    (run,) = (run for run in profile.runs if run.name.startswith("FFT"))
    assert run.operations == 5 * 16 * 32 * (4 + 5)  # 5 N log2 N along each axis
    assert run.seconds > 0
    assert run.nbytes == 2 * field.nbytes


def test_the_plain_queue_comes_back(device: Device) -> None:
    before = device.queue
    with device.profiling():
        assert device.queue is not before
    assert device.queue is before
    with pytest.raises(ZeroDivisionError), device.profiling():
        raise ZeroDivisionError
    assert device.queue is before


def test_profiles_within_each_other(device: Device) -> None:
    with device.profiling() as outer:
        multiply(device, 8)
        with device.profiling() as inner:
            multiply(device, 8)
    assert len(inner.runs) == 1
    assert len(outer.runs) == 1


def test_labels_tell_what_a_kernel_was_specialised_by() -> None:
    assert (
        label("shear", (("LANES", 16), ("ROWS", True), ("CLAMP", True))) == "shear LANES=16 CLAMP"
    )
