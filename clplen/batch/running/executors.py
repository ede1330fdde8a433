"""Who does the items of a job: this process, others on this computer, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clplen.batch.running.local import Running, here

if TYPE_CHECKING:
    from clplen.batch.jobs.spec import Job


def executor_of(
    job: Job,
    *,
    scheduler: str | None = None,
    host: str | None = None,
    insecure: bool = False,
    running: Running | None = None,
) -> Callable[[Path], AbstractContextManager[Any]]:
    """What `run_job` takes, as a job says.

    Parameters
    ----------
    job : Job
        Its ``workers``, ``device``, ``memory``, ``retries`` and ``certificates``.
    scheduler : str, optional
        Address of a Dask scheduler whose workers do it.
    host, insecure
        As for `network_of`.
    running : callable, optional
        As for `Here`; other processes do not say how far they have come.

    Returns
    -------
    callable
        Output folder -> what does tasks, as a context.

    Raises
    ------
    ValueError, FormatError, DeviceError
        As `network_of`; if nothing is started here that could listen on ``host``.
    """
    if host is not None and (scheduler is not None or job.workers == 1):
        raise ValueError(
            "--host (host=) is where a job's own workers listen, and this job starts none: give "
            "two --workers (workers=) or more, or name it to 'clplen worker'."
        )
    if scheduler is None and job.workers == 1:
        selector = job.device[0] if job.device else None
        return partial(here, selector=selector, memory=job.memory, running=running)
    from clplen.batch.running.cluster import workers_here, workers_of
    from clplen.batch.running.network import network_of

    network = network_of(
        scheduler, host=host, certificates=job.certificates_folder, insecure=insecure
    )
    if scheduler is not None:
        return partial(workers_of, network=network, memory=job.memory)
    return partial(
        workers_here,
        workers=job.workers,
        devices=job.device,
        memory=job.memory,
        retries=job.retries,
        network=network,
    )
