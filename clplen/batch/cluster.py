"""Items done by the workers of a Dask cluster, on this computer or on many.

Paths travel through the scheduler, arrays do not. A worker that dies is replaced where Dask does
so, and its items are done again by another.
"""

from __future__ import annotations

import itertools
import os
import secrets
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clplen import __version__
from clplen.batch.cores import environment_of, share_of
from clplen.batch.task import Report, Task
from clplen.batch.workshop import LANES
from clplen.errors import DeviceError, FormatError

_IN_FLIGHT = 4 * LANES  # tasks of each worker that the scheduler knows of
_ANSWER = 20.0  # seconds


class Cluster:
    """Does tasks on the workers of a Dask client.

    Parameters
    ----------
    client : distributed.Client
    how : dict
        Output folder, memory of each worker, and how many workers share this computer.
    """

    def __init__(self, client: Any, how: dict[str, Any]) -> None:
        self._client = client
        self._how = how
        self._run = secrets.token_hex(4)

    def run(self, tasks: Iterable[Task]) -> Iterator[Report]:
        """Do tasks, each once, and give their reports as they come."""
        from distributed import as_completed

        left = iter(tasks)
        names: dict[Any, Task] = {}
        window = max(1, len(self._client.scheduler_info()["workers"])) * _IN_FLIGHT
        futures = as_completed(raise_errors=False)
        for task in itertools.islice(left, window):
            self._submit(task, futures, names)
        while names:
            future = next(futures)
            task = names.pop(future.key)
            yield self._report(task, future)
            for more in itertools.islice(left, 1):
                self._submit(more, futures, names)

    def _submit(self, task: Task, futures: Any, names: dict[Any, Task]) -> None:
        from clplen.batch.remote import perform_here

        key = f"clplen-{self._run}-{secrets.token_hex(4)}-{task.name}"
        future = self._client.submit(
            perform_here, asdict(task), self._how, __version__, key=key, pure=False
        )
        names[future.key] = task
        futures.add(future)

    def _report(self, task: Task, future: Any) -> Report:
        if future.status == "finished":
            return Report(**future.result())
        if future.status in ("cancelled", "lost"):
            raise DeviceError(
                "The Dask scheduler no longer answers: start it and run the job again; what is "
                "done stays done."
            )
        return _lost(task, future.exception())


def _lost(task: Task, error: Any) -> Report:
    """A task that killed its workers, or that they could not take."""
    killed = type(error).__name__ == "KilledWorker"
    text = (
        "the workers that took it died (too little memory?): see their logs"
        if killed
        else f"the worker could not do it ({' '.join(str(error).split())})"
    )
    return Report(task.name, "failed", task.parameters, time.time(), error=text, passing=True)


@contextmanager
def workers_here(
    folder: Path, *, workers: int, devices: list[str] | None, memory: int | None, retries: int
) -> Iterator[Cluster]:
    """Worker processes on this computer, one a device; the cores of a CPU are shared out.

    Parameters
    ----------
    folder : pathlib.Path
        Of the job's output.
    workers : int
    devices : list of str or None
        Of the workers in turn; None: $CLPLEN_DEVICE, or what `Device.open` takes.
    memory : int or None
        Bytes for each worker.
    retries : int
        How many workers an item may lose.

    Raises
    ------
    FormatError
        If the extra ``batch`` is not installed.
    """
    dask, distributed = require_dask()
    settings = {
        "distributed.scheduler.allowed-failures": max(retries, 1),
        "distributed.worker.daemon": False,
        "distributed.logging": {"distributed": "critical"},
    }
    specification = {
        i: {"cls": distributed.Nanny, "options": _options(i, workers, devices)}
        for i in range(workers)
    }
    with (
        dask.config.set(settings),
        distributed.SpecCluster(
            workers=specification,
            scheduler={
                "cls": distributed.Scheduler,
                "options": {"dashboard": False, "dashboard_address": None, "host": "127.0.0.1"},
            },
            silence_logs=50,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        share = memory if memory is not None else None
        yield Cluster(
            client, {"folder": str(folder), "selector": None, "memory": share, "workers": workers}
        )


def _options(number: int, workers: int, devices: list[str] | None) -> dict[str, Any]:
    environment = environment_of(share_of(number, workers))
    if devices:
        environment["CLPLEN_DEVICE"] = devices[number % len(devices)]
    return {
        "nthreads": LANES,
        "memory_limit": 0,
        "env": environment,
        "preload": ["clplen.batch.preload"],
        "silence_logs": 50,
    }


@contextmanager
def workers_of(folder: Path, *, scheduler: str, memory: int | None) -> Iterator[Cluster]:
    """The workers of a Dask cluster that is there.

    Parameters
    ----------
    folder : pathlib.Path
        Of the job's output; all workers see it and the inputs under the same names.
    scheduler : str
        Its address, ``tcp://host:8786``.
    memory : int or None
        Bytes for each worker.

    Raises
    ------
    FormatError
        If the extra ``batch`` is not installed.
    DeviceError
        If the scheduler does not answer, has no workers, or its workers cannot do the job.
    """
    _, distributed = require_dask()
    try:
        client = distributed.Client(scheduler, timeout=_ANSWER)
    except (OSError, ValueError) as error:
        raise DeviceError(
            f"No Dask scheduler answers at {scheduler} within {_ANSWER:g} s: start one with "
            "'dask scheduler', or mend the address."
        ) from error
    with client:
        check_workers(client, scheduler)
        yield Cluster(
            client, {"folder": str(folder), "selector": None, "memory": memory, "workers": 1}
        )


def check_workers(client: Any, scheduler: str) -> None:
    """Refuse workers that cannot do the job.

    Raises
    ------
    DeviceError
        If there are none, or some have no device, no clplen or another version of it.
    """
    from clplen.batch.remote import describe

    try:
        client.wait_for_workers(1, timeout=_ANSWER)
    except TimeoutError as error:
        raise DeviceError(
            f"The scheduler at {scheduler} has no workers: start some with 'clplen worker "
            f"{scheduler}'."
        ) from error
    wrong = []
    for address, found in client.run(describe, on_error="return").items():
        if isinstance(found, Exception):
            wrong.append(f"{address} has no clplen that answers ({' '.join(str(found).split())})")
        elif found["version"] != __version__:
            wrong.append(f"{address} has clplen {found['version']}, this is {__version__}")
        elif found["error"]:
            wrong.append(f"{address} has no OpenCL device ({found['error']})")
    if wrong:
        raise DeviceError(
            f"{len(wrong)} workers of {scheduler} cannot do the job: {'; '.join(wrong[:4])}. Mend "
            "or stop them."
        )


def worker_command(scheduler: str, selector: str | None) -> tuple[list[str], dict[str, str]]:
    """The command that starts a worker of clplen, and its environment.

    Parameters
    ----------
    scheduler : str
        Address.
    selector : str or None
        As for `Device.open`.
    """
    arguments = [sys.executable, "-m", "distributed.cli.dask_worker", scheduler]
    arguments += ["--nthreads", str(LANES), "--nworkers", "1", "--no-dashboard"]
    arguments += ["--memory-limit", "0", "--preload", "clplen.batch.preload"]
    chosen = {} if selector is None else {"CLPLEN_DEVICE": selector}
    return arguments, {**os.environ, **chosen}


def require_dask() -> tuple[Any, Any]:
    """The packages dask and distributed.

    Raises
    ------
    FormatError
        If they are not installed.
    """
    try:
        import dask
        import distributed
    except ImportError as error:
        raise FormatError(
            'Several workers need the package distributed: pip install "clplen[batch]", or leave '
            "workers at 1."
        ) from error
    return dask, distributed
