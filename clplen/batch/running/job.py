"""`Job`, the function that runs it, and the choice of the executor of its tasks."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from clplen.batch.jobs.spec import JobSpec
from clplen.batch.jobs.task import Report, Task
from clplen.batch.running.runner import Summary, Watcher, execute_job
from clplen.batch.work.execution import execute_task
from clplen.batch.work.resources import PIPELINE_DEPTH, Resources, StoppedError
from clplen.errors import argument
from clplen.files import PathLike

Running = Callable[[str, int, int], None]


class LocalExecutor:
    """Executor of tasks in threads of this process, ``depth`` items at a time."""

    def __init__(
        self, resources: Resources, running: Running | None = None, *, depth: int = PIPELINE_DEPTH
    ) -> None:
        self._resources = resources
        self._depth = depth
        self._running = running

    def run(self, tasks: Iterable[Task]) -> Iterator[Report]:
        """Execute each task and yield the reports in order of completion."""
        waiting: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        reports: queue.SimpleQueue[Report | BaseException | None] = queue.SimpleQueue()
        for task in tasks:
            waiting.put(task)
        threads = [
            threading.Thread(target=self._consume, args=(waiting, reports), name=f"item-{i}")
            for i in range(self._depth)
        ]
        for thread in threads:
            waiting.put(None)
            thread.start()
        try:
            yield from _reports(reports, self._depth)
        except BaseException:
            self._resources.stop()
            raise
        finally:
            for thread in threads:
                thread.join()

    def _consume(
        self,
        waiting: queue.SimpleQueue[Task | None],
        reports: queue.SimpleQueue[Report | BaseException | None],
    ) -> None:
        try:
            while (task := waiting.get()) is not None:
                reports.put(
                    execute_task(task, self._resources, advance=partial(self._advance, task.name))
                )
        except StoppedError:
            pass
        except BaseException as error:
            reports.put(error)
        finally:
            reports.put(None)

    def _advance(self, name: str, done: int, total: int) -> None:
        self._resources.check()
        if self._running is not None:
            self._running(name, done, total)


def _reports(
    reports: queue.SimpleQueue[Report | BaseException | None], depth: int
) -> Iterator[Report]:
    ended = 0
    while ended < depth:
        report = reports.get()
        if report is None:
            ended += 1
        elif isinstance(report, BaseException):
            raise report
        else:
            yield report


@contextmanager
def local_executor(
    folder: Path,
    *,
    selector: str | None,
    memory: int | None,
    running: Running | None = None,
    depth: int = PIPELINE_DEPTH,
) -> Iterator[LocalExecutor]:
    """Open an executor in this process; ``memory`` None means half of the free memory."""
    yield LocalExecutor(Resources(selector=selector, memory=memory), running, depth=depth)


def choose_executor(
    job: JobSpec,
    *,
    scheduler: str | None = None,
    host: str | None = None,
    certificates: PathLike | None = None,
    insecure: bool = False,
    running: Running | None = None,
) -> Callable[[Path], AbstractContextManager[Any]]:
    """Return the executor for `execute_job` by the settings of a job."""
    if host is not None and (scheduler is not None or job.workers == 1):
        raise ValueError(
            f"{argument('host')} applies to workers that the job starts, but this job starts none: "
            f"set {argument('workers')} to 2 or more, or pass the host to 'clplen worker'."
        )
    if scheduler is None and job.workers == 1:
        selector = job.device[0] if job.device else None
        return partial(local_executor, selector=selector, memory=job.memory, running=running)
    from clplen.batch.running.cluster import existing_cluster, local_cluster
    from clplen.batch.running.network import network_of

    network = network_of(scheduler, host=host, certificates=certificates, insecure=insecure)
    if scheduler is not None:
        return partial(existing_cluster, network=network, memory=job.memory)
    return partial(
        local_cluster,
        workers=job.workers,
        devices=job.device,
        memory=job.memory,
        retries=job.retries,
        network=network,
    )


class Job(JobSpec):
    """Inputs, operations and output of a batch job; see ``clplen batch --example``.

    Attributes
    ----------
    output : str
        Folder of the results, relative to the job file; each item has its own folder inside.
    formats : list of str
        Formats of stacks, depth maps and pictures: "ome-tiff", "ome-zarr" or both.
    inputs, simulations, scenes : list
        Sources of light fields; at least one.
    stack, depth, all_in_focus, views, light_field, deconvolve, raw
        Operations; at least one for inputs, optional for simulations and scenes.
    device : str or None
        Device as in `Device.open`, or a list with a device for each worker.
    memory : int or None
        Memory limit of each worker in bytes; larger light fields are processed in tiles. None:
        half of the free memory, shared by the workers.
    workers : int
        Number of processes on this computer; values above 1 need the extra ``batch``.
    retries : int
        Number of retries of an item that was lost or failed for a temporary reason.

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> job = clplen.batch.Job(
    ...     output="out", inputs={"files": "*.npy"}, stack={"disparities": "-1:1:3"})
    >>> job.run().done
    1
    >>> sorted(path.name for path in (job.output_folder / "a").iterdir())
    ['item.json', 'stack.ome.tif']
    """

    def run(
        self,
        *,
        workers: int | None = None,
        scheduler: str | None = None,
        device: str | list[str] | None = None,
        memory: int | str | None = None,
        host: str | None = None,
        certificates: PathLike | None = None,
        insecure: bool = False,
        force: bool = False,
        watcher: Watcher | None = None,
    ) -> Summary:
        """Process the items that are missing, changed or failed; see `run_job`."""
        return run_job(
            self,
            workers=workers,
            scheduler=scheduler,
            device=device,
            memory=memory,
            host=host,
            certificates=certificates,
            insecure=insecure,
            force=force,
            watcher=watcher,
        )


def run_job(
    job: JobSpec,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    device: str | list[str] | None = None,
    memory: int | str | None = None,
    host: str | None = None,
    certificates: PathLike | None = None,
    insecure: bool = False,
    force: bool = False,
    watcher: Watcher | None = None,
) -> Summary:
    """Process the items of a job that are missing, changed or failed.

    Parameters
    ----------
    job : Job
        Content of a job file.
    workers : int, optional
        Number of processes on this computer, at least 1; default: the value of the job. With
        several processes, scripts must call it below ``if __name__ == "__main__":``, because the
        workers import the script.
    scheduler : str, optional
        Address of a running Dask scheduler, such as ``tls://host:8786``.
    device : str or list of str, optional
        Device as in `Device.open`, or a list with a device for each worker; default: the value
        of the job. The workers of a scheduler use their own devices.
    memory : int or str, optional
        Memory limit of each worker in bytes, or text such as "4 GiB"; default: the value of the
        job.
    host : str, optional
        Network address or name of this computer on which the scheduler listens, so that workers
        on other computers can join; default: 127.0.0.1.
    certificates : path-like, optional
        Folder of the certificate that authenticates workers on several computers, as in
        `security_of`; created if it is missing and the job starts the scheduler.
    insecure : bool
        True to disable TLS: anyone who reaches the ports can run programs as this user.
    force : bool
        True to continue in an output of a job with other settings.
    watcher : Watcher, optional
        Object whose ``begin(total=, skipped=)`` is called at the start, ``report(report)`` for each
        finished or failed item, and ``running(name, done, total)`` from other threads.

    Returns
    -------
    Summary
        Numbers of items; ``failed`` has the error message of each failed item.

    Raises
    ------
    FormatError
        If a value is out of range, items have no unique names, the settings differ from those of
        the last run, certificates are invalid, or the extra ``batch`` is missing.
    ValueError
        If ``host`` or ``scheduler`` is accessible from other computers without certificates
        and not ``insecure``, or ``host`` is not an address of this computer.
    DeviceError
        If the device does not exist, or the workers cannot run the job.
    BlockingIOError
        If another process uses the output.
    OSError
        If the output folder is not writable.

    Examples
    --------
    >>> np.save("a.npy", np.random.default_rng(1).random((3, 3, 16, 16)))
    >>> job = clplen.batch.Job(
    ...     output="out", inputs={"files": "*.npy"}, stack={"disparities": "-1:1:3"})
    >>> clplen.batch.run_job(job)
    Summary(done=1, skipped=0, failed={}, unsaved='')
    >>> clplen.batch.run_job(job).skipped
    1
    """
    job = job.with_settings(workers=workers, device=device, memory=memory)
    watcher = watcher or Watcher()
    executor = choose_executor(
        job,
        scheduler=scheduler,
        host=host,
        certificates=certificates,
        insecure=insecure,
        running=watcher.running,
    )
    return execute_job(job, executor, watcher=watcher, force=force)
