"""Executors on the workers of a Dask cluster, on this computer or on many.

Paths travel through the scheduler, arrays do not. A worker that dies is replaced where Dask does
so, and its items are done again by another.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import os
import secrets
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clplen import __version__
from clplen.batch.jobs.task import Report, Task
from clplen.batch.running.network import (
    STATUS_PAGES,
    Network,
    check_reachable,
    check_scheduler,
    network_of,
    require_dask,
)
from clplen.batch.running.worker import share_cores, worker_environment
from clplen.batch.work.execution import describe_error
from clplen.batch.work.resources import PIPELINE_DEPTH
from clplen.errors import DeviceError

_log = logging.getLogger(__name__)
_IN_FLIGHT = 4 * PIPELINE_DEPTH  # tasks of each worker that the scheduler knows of
_ANSWER = 20.0  # seconds
_LOOK = 1.0  # seconds after which workers are counted again
_TLS_OPTIONS = {"--tls-ca-file": "ca_file", "--tls-cert": "cert", "--tls-key": "key"}
_CANCELLED = ("cancelled", "lost")  # states of a future
_LATE = (TimeoutError, asyncio.TimeoutError)  # two of them in Python 3.10


class ClusterExecutor:
    """Does tasks on the workers of a Dask client."""

    def __init__(self, client: Any, folder: Path, *, memory: int | None, sharing: int) -> None:
        self._client = client
        self._run = secrets.token_hex(4)
        self._how = {
            "run": self._run,
            "folder": str(folder),
            "memory": memory,
            "sharing": sharing,
        }
        self._workers = 0
        self._looked = -_LOOK

    def run(self, tasks: Iterable[Task]) -> Iterator[Report]:
        """Do tasks, each once, and give their reports as they come.

        A worker that dies takes with it all that it was given, and results that were not fetched
        yet: what was lost so is done again alone, so that only what kills its worker fails.
        """
        lost: list[Task] = []
        for task, future in self._ended(iter(tasks), self._window):
            if _was_killed(future) or self._was_dropped(future):
                lost.append(task)
            else:
                yield self._report(task, future)
        for task, future in self._ended(iter(lost), lambda: 1):
            yield self._report(task, future)

    def _ended(self, left: Iterator[Task], window: Callable[[], int]) -> Iterator[tuple[Task, Any]]:
        """Tasks with their futures as they end; so many at a time are known to the scheduler."""
        from distributed import as_completed

        under_way: dict[Any, Task] = {}
        futures = as_completed(loop=self._client.loop, raise_errors=False)
        while True:
            for task in itertools.islice(left, max(0, window() - len(under_way))):
                future = self._submitted(task)
                under_way[future.key] = task
                futures.add(future)
            if not under_way:
                return
            future = next(futures)
            yield under_way.pop(future.key), future

    def _window(self) -> int:
        """How many tasks keep the workers busy that are there now."""
        if time.monotonic() >= self._looked + _LOOK:
            self._looked = time.monotonic()
            with suppress(OSError, *_LATE):  # a scheduler that is lost cancels all tasks
                self._workers = len(self._client.nthreads())
        return max(1, self._workers) * _IN_FLIGHT

    def _was_dropped(self, future: Any) -> bool:
        """Whether a task was cancelled by a scheduler that still answers."""
        if future.status not in _CANCELLED:
            return False
        try:
            self._client.nthreads()
        except (OSError, *_LATE):
            return False
        return bool(self._client.status == "running")

    def _submitted(self, task: Task) -> Any:
        from clplen.batch.running.worker import execute_on_worker

        key = f"clplen-{self._run}-{secrets.token_hex(4)}-{task.name}"
        return self._client.submit(
            execute_on_worker, asdict(task), self._how, __version__, key=key, pure=False
        )

    def _report(self, task: Task, future: Any) -> Report:
        try:
            if future.status == "finished":
                return Report(**future.result())
        except (OSError, *_LATE) as error:
            raise _gone() from error
        if future.status in _CANCELLED:
            raise _gone()
        if _was_killed(future):
            text = "the workers that took it died (too little memory?): see their logs"
        else:
            text = f"the worker could not do it ({describe_error(future.exception())})"
        passing = not _was_killed(future)  # it was tried again already
        return Report(
            task.name, "failed", task.parameters, time.time(), error=text, passing=passing
        )


def _gone() -> DeviceError:
    return DeviceError(
        "The Dask scheduler no longer answers: run the job again (start a scheduler of your own "
        "first); what is done stays done."
    )


def _was_killed(future: Any) -> bool:
    """Whether the workers of a task died, by itself or by another one."""
    return future.status == "error" and type(future.exception()).__name__ == "KilledWorker"


@contextmanager
def local_cluster(
    folder: Path,
    *,
    workers: int,
    devices: list[str] | None,
    memory: int | None,
    retries: int,
    network: Network | None = None,
) -> Iterator[ClusterExecutor]:
    """Worker processes on this computer, one a device; the cores of a CPU are shared out."""
    dask, distributed = require_dask()
    network = network or network_of()
    specification = {
        i: {"cls": distributed.Nanny, "options": network.server | _options(i, workers, devices)}
        for i in range(workers)
    }
    scheduler = {"cls": distributed.Scheduler, "options": network.server}
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_settings(retries)))
        try:
            cluster = stack.enter_context(
                distributed.SpecCluster(
                    workers=specification,
                    scheduler=scheduler,
                    security=network.security,
                    silence_logs=50,
                )
            )
            client = stack.enter_context(distributed.Client(cluster))
        except (OSError, RuntimeError, *_LATE) as error:
            raise DeviceError(
                f"The {workers} workers did not start ({' '.join(str(error).split())}): if memory "
                "or cores are short, try fewer."
            ) from error
        check_workers(client, "this computer")
        _invite(cluster.scheduler_address, network)
        yield ClusterExecutor(client, folder, memory=memory, sharing=workers)


def _invite(scheduler: str, network: Network) -> None:
    """Say how workers of other computers join."""
    if not network.is_private:
        how = "--insecure" if network.protocol == "tcp" else "the same certificates"
        _log.info("More workers join by 'clplen worker %s' with %s.", scheduler, how)


def _settings(retries: int) -> dict[str, Any]:
    """Of Dask; what its configuration says of addresses and pages does not count here."""
    return {
        "distributed.scheduler.allowed-failures": retries,
        "distributed.scheduler.contact-address": None,
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
        "distributed.worker.daemon": False,
        "distributed.logging": {"distributed": "critical"},
    }


def _options(number: int, workers: int, devices: list[str] | None) -> dict[str, Any]:
    environment = worker_environment(share_cores(number, workers))
    environment["PYTHONWARNINGS"] = "ignore"  # said once by the process that runs the job
    if devices:
        environment["CLPLEN_DEVICE"] = devices[number % len(devices)]
    return {
        "nthreads": PIPELINE_DEPTH,
        "memory_limit": 0,
        "env": environment,
        "preload": ["clplen.batch.preload"],
        "silence_logs": 50,
    }


@contextmanager
def existing_cluster(
    folder: Path, *, network: Network, memory: int | None
) -> Iterator[ClusterExecutor]:
    """The workers of a Dask cluster that is there."""
    _, distributed = require_dask()
    check_scheduler(network, _ANSWER)
    try:
        client = distributed.Client(network.scheduler, timeout=_ANSWER, security=network.security)
    except (OSError, ValueError) as error:
        raise _gone() from error
    with client:
        sharing = check_workers(client, str(network.scheduler))
        yield ClusterExecutor(client, folder, memory=memory, sharing=sharing)


def check_workers(client: Any, scheduler: str) -> int:
    """Refuse workers that cannot do the job."""
    from clplen.batch.running.worker import describe_worker

    try:
        client.wait_for_workers(1, timeout=_ANSWER)
    except _LATE as error:
        raise DeviceError(
            f"The scheduler at {scheduler} has no workers: start some with 'clplen worker "
            f"{scheduler}'."
        ) from error
    wrong, hosts = [], Counter[str]()
    for address, found in client.run(describe_worker, on_error="return").items():
        if isinstance(found, Exception):
            wrong.append(f"{address} has no clplen that answers ({describe_error(found)})")
            continue
        hosts[found["host"]] += 1
        if found["version"] != __version__:
            wrong.append(f"{address} has clplen {found['version']}, this is {__version__}")
        elif found["error"]:
            wrong.append(f"{address} has no OpenCL device ({found['error']})")
    if wrong:
        raise DeviceError(
            f"{len(wrong)} workers of {scheduler} cannot do the job: {'; '.join(wrong[:4])}. Mend "
            "or stop them."
        )
    return max(hosts.values(), default=1)


def worker_command(network: Network, selector: str | None) -> tuple[list[str], dict[str, str]]:
    """Return the command that starts a worker of clplen, and its environment."""
    check_reachable(network)
    arguments = [sys.executable, "-m", "distributed.cli.dask_worker", str(network.scheduler)]
    arguments += ["--nthreads", str(PIPELINE_DEPTH), "--nworkers", "1", "--memory-limit", "0"]
    arguments += ["--preload", "clplen.batch.preload"]
    arguments += ["--host", network.host, "--protocol", network.protocol]
    arguments += ["--no-dashboard", "--dashboard-address", STATUS_PAGES]
    environment = {
        **os.environ,
        "DASK_DISTRIBUTED__WORKER__HTTP__ROUTES": "[]",
        "PYTHONSAFEPATH": "1",  # no module of the folder in which it is started
    }
    if network.protocol == "tls":
        files = network.security.get_tls_config_for_role("worker")
        for option, name in _TLS_OPTIONS.items():
            arguments += [option, files[name]] if files[name] else []
        environment["DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION"] = "True"
    if selector is not None:
        environment["CLPLEN_DEVICE"] = selector
    return arguments, environment
