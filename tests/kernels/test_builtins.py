"""``builtins.cl``: every built-in function that kernels call, against the standard library's."""

from __future__ import annotations

from array import array

from clplen.compute.device import Device
from clplen.compute.drivers import builtin_functions
from clplen.selftest.basics import built_in_values


def test_built_in_functions(device: Device) -> None:
    values = array("f", built_in_values(device).ravel().tolist())
    assert builtin_functions.wrong(values, double=device.has_fp64) == []
