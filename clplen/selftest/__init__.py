"""Self-test of devices: all families of kernels, transforms and memory against float64 NumPy.

`run_checks` takes a `Device` and returns a list of `CheckResult`. The references follow the
definitions. Cases are small, and never square, symmetric, even or zero, so that no fault is masked.
"""

from clplen.selftest.check import CheckResult
from clplen.selftest.runner import CHECKS, run_checks, run_isolated

__all__ = ["CHECKS", "CheckResult", "run_checks", "run_isolated"]
