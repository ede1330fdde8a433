"""What runs on a Dask worker."""

from __future__ import annotations

import socket
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clplen import __version__
from clplen.batch.task import Task
from clplen.batch.execution import perform
from clplen.batch.workshop import Workshop, default_memory
from clplen.compute.device import Device
from clplen.errors import ClplenError, DeviceError

_SHOPS = "clplen_shops"  # attribute of the worker that keeps its workshops, with their run
_opening = threading.Lock()


def describe() -> dict[str, str]:
    """Version and computer of this worker, and what is wrong with its device."""
    known = {"version": __version__, "host": socket.gethostname(), "error": ""}
    try:
        Device.open().ensure_usable()
    except ClplenError as error:
        return known | {"error": " ".join(str(error).split())}
    return known


def perform_here(words: dict[str, Any], how: dict[str, Any], version: str) -> dict[str, Any]:
    """Do one item on this worker.

    Parameters
    ----------
    words : dict
        Of a `Task`.
    how : dict
        ``folder``, ``memory``, ``sharing``, the number of workers of a computer, and ``run``, a
        word of its own for each run of a job.
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
    """The workshop of this worker for an output folder; its memory is that of the latest run."""
    with _opening:
        shops: dict[str, tuple[str, Workshop]] = worker.__dict__.setdefault(_SHOPS, {})
        run, shop = shops.get(how["folder"], ("", None))
        if shop is not None and run == how["run"]:
            return shop
        memory = how["memory"]
        if memory is None:
            memory = max(1, default_memory(Device.open()) // how["sharing"])
        if shop is None:
            shop = Workshop(Path(how["folder"]), selector=None, memory=memory)
        else:
            shop.limit(memory)
        shops[how["folder"]] = (how["run"], shop)
        return shop
