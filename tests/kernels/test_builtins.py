"""``builtins.cl``: every built-in function that kernels call, against NumPy's."""

from __future__ import annotations

from clplen.compute.device import Device
from clplen.compute.drivers import builtin_functions
from clplen.selftest.basics import built_in_values


def test_built_in_functions(device: Device) -> None:
    assert builtin_functions.wrong(built_in_values(device), double=device.has_fp64) == []
