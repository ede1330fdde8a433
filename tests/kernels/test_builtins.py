"""Every built-in function that kernels call, against the standard library's."""

from __future__ import annotations

from array import array

import numpy as np
import pytest

from clplen.compute import builtin_functions
from clplen.compute.device import Device


@pytest.mark.parametrize("double", [False, True])
def test_built_in_functions(device: Device, double: bool) -> None:
    if double and not device.has_fp64:
        pytest.skip(f"{device.name} has no double precision")
    assert builtin_functions.wrong(array("f", run(device, double)), double=double) == []


def run(device: Device, double: bool) -> list[float]:
    """The values that the kernel gives on a device."""
    x, halves, samples, shorts = builtin_functions.inputs()
    count = builtin_functions.COUNT
    y = device.zeros((len(builtin_functions.expected(double=double)), count), np.float32)
    defines = {"DOUBLE": True} if double else {}
    arguments = [
        device.upload(np.frombuffer(x, np.float32)),
        device.upload(np.frombuffer(halves, np.float16)),
        device.upload(np.frombuffer(samples, np.uint8)),
        device.upload(np.frombuffer(shorts, np.uint16)),
    ]
    kernel = device.kernel("builtins.cl", "builtins", **defines)
    device.launch(kernel, (1,), y, *arguments, np.int32(count), group=(1,))
    return device.download(y).ravel().tolist()
