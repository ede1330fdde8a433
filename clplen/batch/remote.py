"""What runs on a Dask worker."""

from __future__ import annotations

import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clplen import __version__
from clplen.batch.task import Task
from clplen.batch.work import perform
from clplen.batch.workshop import Workshop, default_memory
from clplen.compute.device import Device
from clplen.errors import ClplenError, DeviceError

_SHOPS = "clplen_shops"  # attribute of the worker that keeps its workshops
_opening = threading.Lock()


def describe() -> dict[str, str]:
    """Version and device of this worker."""
    try:
        device = Device.open()
        device.ensure_usable()
    except ClplenError as error:
        return {"version": __version__, "device": "", "error": str(error)}
    return {"version": __version__, "device": repr(device), "error": ""}


def perform_here(words: dict[str, Any], how: dict[str, Any], version: str) -> dict[str, Any]:
    """Do one item on this worker.

    Parameters
    ----------
    words : dict
        Of a `Task`.
    how : dict
        ``folder``, ``memory`` and ``workers``, the number that share this computer.
    version : str
        Of clplen where the job runs.

    Returns
    -------
    dict
        Of a `Report`.

    Raises
    ------
    DeviceError
        If this worker has another version.
    """
    if version != __version__:
        raise DeviceError(f"it has clplen {__version__}, the job {version}")
    from distributed import get_worker

    return asdict(perform(Task(**words), _shop(get_worker(), how)))


def _shop(worker: Any, how: dict[str, Any]) -> Workshop:
    """The workshop of this worker for an output folder, made at its first item."""
    with _opening:
        shops: dict[str, Workshop] = worker.__dict__.setdefault(_SHOPS, {})
        if how["folder"] not in shops:
            memory = how["memory"]
            if memory is None:
                memory = default_memory(Device.open()) // how["workers"]
            shops[how["folder"]] = Workshop(Path(how["folder"]), selector=None, memory=memory)
        return shops[how["folder"]]
