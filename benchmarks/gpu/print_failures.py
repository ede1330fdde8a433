"""A plugin of pytest: print why a test failed when it fails, not when all have run.

PYTHONPATH=benchmarks/gpu python -m pytest -p print_failures
"""

from __future__ import annotations

import os
import sys

import pytest


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed and "PYTEST_XDIST_WORKER" not in os.environ:
        crash = getattr(report.longrepr, "reprcrash", None)
        reason = crash.message if crash else str(report.longrepr)
        print(f"\n{report.when} of {report.nodeid}: {reason[:300]}", file=sys.stderr, flush=True)
