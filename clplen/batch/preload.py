"""Set up a Dask worker for clplen: ``dask worker ADDRESS --preload clplen.batch.preload``.

The worker is restricted to the cores of ``$CLPLEN_CORES`` and opens the device of
``$CLPLEN_DEVICE`` before its first item. A worker with ``$CLPLEN_CORES`` was started by a job and
ignores keyboard interrupts, because the job stops it.
"""

from __future__ import annotations

import os
import signal
from typing import Any

from clplen.batch.running.worker import CORES, restrict_cores
from clplen.compute.device import Device


def dask_setup(worker: Any) -> None:
    """Set up the worker; Dask calls this function at its start."""
    if CORES in os.environ:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    restrict_cores()
    Device.open().ensure_usable()
