"""Cores of this computer, shared out among worker processes."""

from __future__ import annotations

import os

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


def share_of(worker: int, workers: int) -> list[int]:
    """The cores of one of several workers; beyond one a core they share them.

    Parameters
    ----------
    worker : int
        From 0.
    workers : int
    """
    cores = usable_cores()
    if workers >= len(cores):
        return [cores[worker % len(cores)]]
    return cores[worker * len(cores) // workers : (worker + 1) * len(cores) // workers]


def environment_of(cores: list[int]) -> dict[str, str]:
    """Variables that keep a new process to these cores; `keep_to` reads the first."""
    count = str(len(cores))
    return {CORES: ",".join(map(str, cores))} | dict.fromkeys(_VARIABLES, count)


def keep_to() -> None:
    """Keep this process to the cores of its environment, before any device is opened."""
    wanted = os.environ.get(CORES)
    if wanted and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {int(core) for core in wanted.split(",")})


CORES = "CLPLEN_CORES"
