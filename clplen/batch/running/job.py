"""`Job`: the content of a job file, the function that runs it, and who executes its tasks."""

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
        """Do tasks, each once, and give their reports as they come."""
        waiting: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        found: queue.SimpleQueue[Report | BaseException | None] = queue.SimpleQueue()
        for task in tasks:
            waiting.put(task)
        threads = [
            threading.Thread(target=self._consume, args=(waiting, found), name=f"item-{i}")
            for i in range(self._depth)
        ]
        for thread in threads:
            waiting.put(None)
            thread.start()
        try:
            yield from _reports(found, self._depth)
        except BaseException:
            self._resources.stop()
            raise
        finally:
            for thread in threads:
                thread.join()

    def _consume(
        self,
        waiting: queue.SimpleQueue[Task | None],
        found: queue.SimpleQueue[Report | BaseException | None],
    ) -> None:
        try:
            while (task := waiting.get()) is not None:
                found.put(
                    execute_task(task, self._resources, advance=partial(self._say, task.name))
                )
        except StoppedError:
            pass
        except BaseException as error:
            found.put(error)
        finally:
            found.put(None)

    def _say(self, name: str, done: int, total: int) -> None:
        self._resources.check()
        if self._running is not None:
            self._running(name, done, total)


def _reports(
    found: queue.SimpleQueue[Report | BaseException | None], depth: int
) -> Iterator[Report]:
    ended = 0
    while ended < depth:
        report = found.get()
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
    """Open an executor in this process; ``memory`` None is half of the free memory."""
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
    """What `execute_job` takes, as a job says."""
    if host is not None and (scheduler is not None or job.workers == 1):
        raise ValueError(
            f"{argument('host')} is where a job's own workers listen, and this job starts none: "
            f"give {argument('workers')} of 2 or more, or name it to 'clplen worker'."
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
    """Many light fields, and what is made of each; see ``clplen batch --example``.

    Attributes
    ----------
    output : str
        Folder of the results, a folder in it for each item; seen from the job file.
    formats : list of str
        Of stacks, depth maps and pictures: "ome-tiff", "ome-zarr" or both.
    inputs, simulations, scenes : list
        Where light fields come from; at least one.
    stack, depth, all_in_focus, views, light_field, deconvolve, raw
        What is made; at least one, or simulations and scenes, which write all that they know.
    device : str or None
        As for `Device.open`; a list gives each worker its own.
    memory : int or None
        Bytes that light field, results and what lies between may take in each worker; beyond it
        light fields are streamed. None: half of the free memory, shared by the workers.
    workers : int
        Processes on this computer; more than one needs the extra ``batch``.
    retries : int
        How often an item that failed for a reason that may pass, or was lost, is tried again.

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
        """Do what is missing, changed or failed: `run_job` of this job, with its parameters."""
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
    """Do what is missing, changed or failed.

    Parameters
    ----------
    job : Job
        Content of a job file.
    workers : int, optional
        Processes on this computer, at least 1; default: as the job says. With more than one, a
        script must call this below ``if __name__ == "__main__":``, as its workers import it.
    scheduler : str, optional
        Address of a Dask scheduler whose workers do it, ``tls://host:8786``.
    device : str or list of str, optional
        As for `Device.open`, a list for each worker its own; default: as the job says. Workers
        of a scheduler have theirs.
    memory : int or str, optional
        Bytes or a size such as "4 GiB" of each worker; default: as the job says.
    host : str, optional
        Address or name of this computer on which workers listen, so that others may join;
        default: 127.0.0.1.
    certificates : path-like, optional
        Folder of the certificate by which workers on several computers know each other, as for
        `security_of`; it is made if there is none and the job starts the scheduler.
    insecure : bool
        Whether to go without TLS, also beyond this computer: anyone who reaches the ports runs
        programs as this user.
    force : bool
        Whether a job that differs from the one that ran before may go on in its output.
    watcher : Watcher, optional
        Object whose ``begin(total=, skipped=)`` is called at the start, ``report(report)`` for each
        item that is done or failed, and ``running(name, done, total)`` from other threads.

    Returns
    -------
    Summary
        ``failed`` has a sentence for each item that failed; the others are done.

    Raises
    ------
    FormatError
        If a value is out of range, the items cannot be told, the job differs from the one that
        ran before, certificates cannot be used, or the extra ``batch`` is needed and not
        installed.
    ValueError
        If ``host`` or ``scheduler`` is reached from beyond this computer without certificates
        and not ``insecure``, or ``host`` is no address of it.
    DeviceError
        If there is no such device, or the workers cannot do the job.
    BlockingIOError
        If another process is at work on the output.
    OSError
        If the output takes no files.

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
