"""A self-test of devices: every family of kernels, transforms and memory against NumPy in float64.

A `Device` comes in, a list of `CheckResult` leaves. The twins are written from the definitions and
the cases are small, with nothing square, symmetric, even or zero that could hide a fault.
"""

from clplen.selftest.check import CheckResult
from clplen.selftest.runner import CHECKS, run_checks, run_isolated

__all__ = ["CHECKS", "CheckResult", "run_checks", "run_isolated"]
