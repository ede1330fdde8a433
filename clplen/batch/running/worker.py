"""Execution of tasks on a Dask worker, and the division of CPU cores among workers."""

from __future__ import annotations

import os
import socket
import threading
from dataclasses import asdict
from typing import Any

from clplen import __version__
from clplen.batch.jobs.task import Task
from clplen.batch.work.execution import execute_task
from clplen.batch.work.resources import Resources, default_memory
from clplen.compute.device import Device
from clplen.errors import ClplenError, DeviceError

_RESOURCES = "clplen_resources"  # attribute of the worker: resources and run by folder
_opening = threading.Lock()


def describe_worker() -> dict[str, str]:
    """Return version and host name of this worker, and the error of its device."""
    description = {"version": __version__, "host": socket.gethostname(), "error": ""}
    try:
        Device.open().ensure_usable()
    except ClplenError as error:
        return description | {"error": " ".join(str(error).split())}
    return description


def execute_on_worker(
    task: dict[str, Any], settings: dict[str, Any], version: str
) -> dict[str, Any]:
    """Process an item on this worker."""
    if version != __version__:
        raise DeviceError(f"it has clplen {__version__}, the job {version}")
    from distributed import get_worker

    return asdict(execute_task(Task(**task), _resources_of(get_worker(), settings)))


def _resources_of(worker: Any, settings: dict[str, Any]) -> Resources:
    """Return the worker's resources for an output folder, with the memory of the latest run."""
    with _opening:
        cache: dict[str, tuple[str, Resources]] = worker.__dict__.setdefault(_RESOURCES, {})
        run, resources = cache.get(settings["folder"], ("", None))
        if resources is not None and run == settings["run"]:
            return resources
        memory = settings["memory"]
        if memory is None:
            memory = max(1, default_memory(Device.open()) // settings["sharing"])
        if resources is None:
            resources = Resources(selector=None, memory=memory)
        else:
            resources.limit(memory)
        cache[settings["folder"]] = (settings["run"], resources)
        return resources


# Variables that limit threads; PoCL, OpenMP, BLAS and ducc0 read them when they are loaded.
_VARIABLES = (
    "POCL_MAX_PTHREAD_COUNT",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "DUCC0_NUM_THREADS",
)


def usable_cores() -> list[int]:
    """Return the CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def share_cores(worker: int, workers: int) -> list[int]:
    """Return the CPU cores of a worker; workers share cores if they outnumber them."""
    cores = usable_cores()
    if workers >= len(cores):
        return [cores[worker % len(cores)]]
    return cores[worker * len(cores) // workers : (worker + 1) * len(cores) // workers]


def worker_environment(cores: list[int]) -> dict[str, str]:
    """Return environment variables that restrict a new process and its threads to cores."""
    count = str(len(cores))
    return {CORES: ",".join(map(str, cores))} | dict.fromkeys(_VARIABLES, count)


def restrict_cores() -> None:
    """Restrict this process to the cores of ``$CLPLEN_CORES``, before a device is opened."""
    cores = os.environ.get(CORES)
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {int(core) for core in cores.split(",")})


CORES = "CLPLEN_CORES"
