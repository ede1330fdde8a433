"""Makes a Dask worker one of clplen: ``dask worker ADDRESS --preload clplen.batch.preload``.

It keeps to the cores of ``$CLPLEN_CORES`` and opens the device of ``$CLPLEN_DEVICE`` before it
takes any item. A job refuses a worker without one. Where there is ``$CLPLEN_CORES`` a job has
started it and will stop it, so that an interrupt from the keyboard is the job's alone.
"""

from __future__ import annotations

import os
import signal
from typing import Any

from clplen.batch.running.worker import CORES, restrict_cores
from clplen.compute.device import Device


def dask_setup(worker: Any) -> None:
    """Called by Dask when the worker starts."""
    if CORES in os.environ:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    restrict_cores()
    Device.open().ensure_usable()
