"""Execution of tasks on a Dask worker, and the cores of this computer that workers share."""

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
    """Version and computer of this worker, and what is wrong with its device."""
    known = {"version": __version__, "host": socket.gethostname(), "error": ""}
    try:
        Device.open().ensure_usable()
    except ClplenError as error:
        return known | {"error": " ".join(str(error).split())}
    return known


def execute_on_worker(words: dict[str, Any], how: dict[str, Any], version: str) -> dict[str, Any]:
    """Do one item on this worker."""
    if version != __version__:
        raise DeviceError(f"it has clplen {__version__}, the job {version}")
    from distributed import get_worker

    return asdict(execute_task(Task(**words), _resources_of(get_worker(), how)))


def _resources_of(worker: Any, how: dict[str, Any]) -> Resources:
    """The resources of this worker for an output folder; its memory is that of the latest run."""
    with _opening:
        known: dict[str, tuple[str, Resources]] = worker.__dict__.setdefault(_RESOURCES, {})
        run, resources = known.get(how["folder"], ("", None))
        if resources is not None and run == how["run"]:
            return resources
        memory = how["memory"]
        if memory is None:
            memory = max(1, default_memory(Device.open()) // how["sharing"])
        if resources is None:
            resources = Resources(selector=None, memory=memory)
        else:
            resources.limit(memory)
        known[how["folder"]] = (how["run"], resources)
        return resources


# What bounds threads, read by PoCL, OpenMP, BLAS, ducc0 when they are loaded.
_VARIABLES = (
    "POCL_MAX_PTHREAD_COUNT",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "DUCC0_NUM_THREADS",
)


def usable_cores() -> list[int]:
    """The cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def share_cores(worker: int, workers: int) -> list[int]:
    """The cores of one of several workers; beyond one a core they share them."""
    cores = usable_cores()
    if workers >= len(cores):
        return [cores[worker % len(cores)]]
    return cores[worker * len(cores) // workers : (worker + 1) * len(cores) // workers]


def worker_environment(cores: list[int]) -> dict[str, str]:
    """Return variables that keep a new process and its libraries' threads to these cores."""
    count = str(len(cores))
    return {CORES: ",".join(map(str, cores))} | dict.fromkeys(_VARIABLES, count)


def restrict_cores() -> None:
    """Keep this process to the cores of its environment, before any device is opened."""
    wanted = os.environ.get(CORES)
    if wanted and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {int(core) for core in wanted.split(",")})


CORES = "CLPLEN_CORES"
