"""Makes a Dask worker one of clplen: ``dask worker ADDRESS --preload clplen.batch.preload``.

It keeps to the cores of ``$CLPLEN_CORES`` and opens the device of ``$CLPLEN_DEVICE`` before it
takes any item. A job refuses a worker without one.
"""

from __future__ import annotations

from typing import Any

from clplen.batch.cores import keep_to
from clplen.compute.device import Device


def dask_setup(worker: Any) -> None:
    """Called by Dask when the worker starts."""
    keep_to()
    Device.open().ensure_usable()
