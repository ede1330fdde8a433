"""Executors on the workers of a Dask cluster, on this or several computers.

The scheduler transmits paths, not arrays. Items of a worker that dies are repeated by another
worker.
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
TASKS_PER_WORKER = 4 * PIPELINE_DEPTH  # submitted at a time, so that no worker runs idle
_ANSWER = 20.0  # timeout of the scheduler in seconds
_LOOK = 1.0  # interval of counting workers in seconds
_TLS_OPTIONS = {"--tls-ca-file": "ca_file", "--tls-cert": "cert", "--tls-key": "key"}
_CANCELLED = ("cancelled", "lost")  # states of a future
_LATE = (TimeoutError, asyncio.TimeoutError)  # different classes in Python 3.10


class ClusterExecutor:
    """Executor of tasks on the workers of a Dask client."""

    def __init__(self, client: Any, folder: Path, *, memory: int | None, sharing: int) -> None:
        self._client = client
        self._run = secrets.token_hex(4)
        self._settings = {
            "run": self._run,
            "folder": str(folder),
            "memory": memory,
            "sharing": sharing,
        }
        self._workers = 0
        self._looked = -_LOOK

    def run(self, tasks: Iterable[Task]) -> Iterator[Report]:
        """Execute each task and yield the reports in order of completion.

        All tasks of a worker that dies are lost. They are repeated one by one, so that only a task
        that kills its worker again is reported as failed.
        """
        lost: list[Task] = []
        for task, future in self._completed(iter(tasks), self._window):
            if _was_killed(future) or self._was_dropped(future):
                lost.append(task)
            else:
                yield self._report(task, future)
        for task, future in self._completed(iter(lost), lambda: 1):
            yield self._report(task, future)

    def _completed(
        self, tasks: Iterator[Task], window: Callable[[], int]
    ) -> Iterator[tuple[Task, Any]]:
        """Yield tasks and futures in order of completion; submit up to ``window()`` at a time."""
        from distributed import as_completed

        pending: dict[Any, Task] = {}
        futures = as_completed(loop=self._client.loop, raise_errors=False)
        while True:
            for task in itertools.islice(tasks, max(0, window() - len(pending))):
                future = self._submit(task)
                pending[future.key] = task
                futures.add(future)
            if not pending:
                return
            future = next(futures)
            yield pending.pop(future.key), future

    def _window(self) -> int:
        """Return the number of tasks that keeps the current workers busy."""
        if time.monotonic() >= self._looked + _LOOK:
            self._looked = time.monotonic()
            with suppress(OSError, *_LATE):  # a lost scheduler cancels all tasks
                self._workers = len(self._client.nthreads())
        return max(1, self._workers) * TASKS_PER_WORKER

    def _was_dropped(self, future: Any) -> bool:
        """Return True if a scheduler that still answers has cancelled a task."""
        if future.status not in _CANCELLED:
            return False
        try:
            self._client.nthreads()
        except (OSError, *_LATE):
            return False
        return bool(self._client.status == "running")

    def _submit(self, task: Task) -> Any:
        from clplen.batch.running.worker import execute_on_worker

        key = f"clplen-{self._run}-{secrets.token_hex(4)}-{task.name}"
        return self._client.submit(
            execute_on_worker, asdict(task), self._settings, __version__, key=key, pure=False
        )

    def _report(self, task: Task, future: Any) -> Report:
        try:
            if future.status == "finished":
                return Report(**future.result())
        except (OSError, *_LATE) as error:
            raise _scheduler_lost() from error
        if future.status in _CANCELLED:
            raise _scheduler_lost()
        if _was_killed(future):
            text = "its workers died, possibly for lack of memory: check their logs"
        else:
            text = f"the worker raised an error ({describe_error(future.exception())})"
        passing = not _was_killed(future)  # a killed task was already repeated
        return Report(
            task.name, "failed", task.parameters, time.time(), error=text, passing=passing
        )


def _scheduler_lost() -> DeviceError:
    return DeviceError(
        "The Dask scheduler no longer answers: restart the scheduler if you started it yourself, "
        "and run the job again; finished items are kept."
    )


def _was_killed(future: Any) -> bool:
    """Return True if the workers of a task died."""
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
    """Start worker processes on this computer; divide devices and CPU cores among them."""
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
                f"The {workers} workers did not start ({' '.join(str(error).split())}): use fewer "
                "workers if memory or cores are short."
            ) from error
        check_workers(client, "this computer")
        _invite(cluster.scheduler_address, network)
        yield ClusterExecutor(client, folder, memory=memory, sharing=workers)


def _invite(scheduler: str, network: Network) -> None:
    """Log the command that adds workers on other computers."""
    if not network.is_private:
        option = "--insecure" if network.protocol == "tcp" else "--certificates FOLDER"
        _log.info("Add workers with 'clplen worker %s %s'.", scheduler, option)


def _settings(retries: int) -> dict[str, Any]:
    """Return settings of Dask that override the user's configuration of addresses and pages."""
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
    environment["PYTHONWARNINGS"] = "ignore"  # shown once by the process that runs the job
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
    """Connect to the workers of a running Dask cluster."""
    _, distributed = require_dask()
    check_scheduler(network, _ANSWER)
    try:
        client = distributed.Client(network.scheduler, timeout=_ANSWER, security=network.security)
    except (OSError, ValueError) as error:
        raise _scheduler_lost() from error
    with client:
        sharing = check_workers(client, str(network.scheduler))
        yield ClusterExecutor(client, folder, memory=memory, sharing=sharing)


def check_workers(client: Any, scheduler: str) -> int:
    """Check clplen and device of all workers; return the largest number on one computer."""
    from clplen.batch.running.worker import describe_worker

    try:
        client.wait_for_workers(1, timeout=_ANSWER)
    except _LATE as error:
        raise DeviceError(
            f"The scheduler at {scheduler} has no workers: start them with 'clplen worker "
            f"{scheduler}'."
        ) from error
    problems, hosts = [], Counter[str]()
    for address, worker in client.run(describe_worker, on_error="return").items():
        if isinstance(worker, Exception):
            problems.append(f"{address} has no working clplen ({describe_error(worker)})")
            continue
        hosts[worker["host"]] += 1
        if worker["version"] != __version__:
            problems.append(f"{address} has clplen {worker['version']}, this is {__version__}")
        elif worker["error"]:
            problems.append(f"{address} has no OpenCL device ({worker['error']})")
    if problems:
        raise DeviceError(
            f"{len(problems)} workers of {scheduler} cannot run the job: "
            f"{'; '.join(problems[:4])}. Fix or stop them."
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
        "PYTHONSAFEPATH": "1",  # imports no module from the current folder
    }
    if network.protocol == "tls":
        files = network.security.get_tls_config_for_role("worker")
        for option, name in _TLS_OPTIONS.items():
            arguments += [option, files[name]] if files[name] else []
        environment["DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION"] = "True"
    if selector is not None:
        environment["CLPLEN_DEVICE"] = selector
    return arguments, environment
