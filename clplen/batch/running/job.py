"""`Job`: the content of a job file, and the function that runs it."""

from __future__ import annotations

from clplen.batch.jobs.spec import JobSpec
from clplen.batch.running.executors import choose_executor
from clplen.batch.running.runner import SilentWatcher, Summary, Watcher, execute_job
from clplen.files import PathLike


class Job(JobSpec):
    """Many light fields, and what is made of each; a `JobSpec` that runs.

    Attributes and job files are those of `clplen.batch.JobSpec`; see ``clplen batch --example``.
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
    job : JobSpec
        A `Job`, or its content alone.
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
        Folder of `make_certificates`; default: as the job says.
    insecure : bool
        Whether to go without TLS, also beyond this computer: anyone who reaches the ports runs
        programs as this user.
    force : bool
        Whether a job that differs from the one that ran before may go on in its output.
    watcher : Watcher, optional
        Is told about progress; see `clplen.batch.Watcher`.

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
    """
    job = job.with_settings(
        workers=workers, device=device, memory=memory, certificates=certificates
    )
    watcher = watcher or SilentWatcher()
    executor = choose_executor(
        job, scheduler=scheduler, host=host, insecure=insecure, running=watcher.running
    )
    return execute_job(job, executor, watcher=watcher, force=force)
