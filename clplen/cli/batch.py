"""``clplen batch`` and ``clplen worker``."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from tqdm import tqdm

from clplen.cli.shared import options

if TYPE_CHECKING:
    from clplen.batch import Job
    from clplen.batch.jobs.task import Report
    from clplen.batch.running.estimate import JobEstimate
    from clplen.batch.running.runner import Summary

_SHOWN = 20  # items of a list


class _RunFirst(click.Group):
    """``clplen batch JOB.toml`` is ``clplen batch run JOB.toml``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands:
            args = ["run", *args]
        return super().parse_args(ctx, args)


@click.group(cls=_RunFirst)
def batch() -> None:
    """Make stacks, depth maps and pictures of many light fields: 'clplen batch JOB.toml'."""


def _print_example(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from clplen.batch.jobs.spec import commented_job

        click.echo(commented_job(), nl=False)
        ctx.exit()


_CERTIFICATES = click.option(
    "--certificates",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="Folder with certificate.pem and key.pem, by which workers on several computers know each "
    "other; a job that starts its own scheduler makes it if there is none.",
)
_INSECURE = click.option(
    "--insecure",
    is_flag=True,
    help="Go without TLS, also beyond this computer: ANYONE who reaches a port runs programs as "
    "you. Only for networks where you trust every user of every computer.",
)


@batch.command()
@click.argument("path", metavar="JOB.toml", type=click.Path(path_type=Path))
@click.option(
    "--example",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_example,
    help="Print a commented job file and stop.",
)
@click.option(
    "--dry-run",
    is_flag=True,
    help="Show items, sizes, what is done already, and the time that one measured item tells.",
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    help="Number of processes on this computer; default: as the job says.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Address of a Dask scheduler whose workers do the job: tls://host:8786.",
)
@click.option(
    "--host",
    metavar="ADDRESS",
    help="Address of this computer on which --workers listen, so that others may join; "
    "default: 127.0.0.1, for this computer alone.",
)
@_CERTIFICATES
@_INSECURE
@click.option(
    "--memory", metavar="SIZE", help='Memory of each worker ("4 GiB"); default: as the job says.'
)
@click.option("--force", is_flag=True, help="Continue although the job was changed.")
@options.device
def run(
    path: Path,
    dry_run: bool,
    workers: int | None,
    scheduler: str | None,
    host: str | None,
    certificates: Path | None,
    insecure: bool,
    memory: str | None,
    force: bool,
    selector: str | None,
) -> None:
    """Do what a job file says, and only what is missing, changed or failed.

    Each item has a folder in the job's output, with a record (item.json) of what it was made of;
    manifest.sqlite there says what is done. 'clplen batch status JOB.toml' shows it.

    \b
    Example:
      clplen batch --example > job.toml
      clplen batch job.toml --dry-run
      clplen batch job.toml
    """
    from clplen.batch import Job

    with _quiet():
        job = Job.read(path).with_settings(workers=workers, device=selector, memory=memory)
        if dry_run:
            _print_estimate(job)
            return
        with _Bar() as bar:
            watcher: Any = bar  # the class of watchers takes long to import
            summary = job.run(
                scheduler=scheduler,
                host=host,
                certificates=certificates,
                insecure=insecure,
                force=force,
                watcher=watcher,
            )
        _tell(summary, job, path)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Not a line for each item, and none of Dask's: what is lost is said in our words."""
    levels = dict.fromkeys(("clplen.io", "clplen.config"), logging.WARNING)
    levels |= dict.fromkeys(("distributed", "tornado", "asyncio"), logging.CRITICAL)
    loggers = {logging.getLogger(name): level for name, level in levels.items()}
    before = {logger: logger.level for logger in loggers}
    for logger, level in loggers.items():
        logger.setLevel(level)
    try:
        yield
    finally:
        for logger, level in before.items():
            logger.setLevel(level)


class _Bar(contextlib.AbstractContextManager["_Bar"]):
    """Progress of the items, and of the one that is under way."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None
        self._failed = 0

    def begin(self, *, total: int, skipped: int) -> None:
        """How many items there are, and how many of them are done already."""
        if skipped:
            click.echo(f"{skipped} of {total} items are done already.", err=True)
        self._bar = tqdm(
            total=total - skipped, unit="item", disable=not sys.stderr.isatty(), dynamic_ncols=True
        )

    def running(self, name: str, done: int, total: int) -> None:
        """How far one item has come."""
        if self._bar is not None:
            self._bar.set_postfix_str(f"{name} {100 * done // max(total, 1)} %")

    def report(self, report: Report) -> None:
        """One is done or has failed."""
        assert self._bar is not None
        if report.state == "failed":
            self._failed += 1
            with tqdm.external_write_mode(sys.stderr):
                click.echo(f"{report.name} failed: {report.error}", err=True)
        words = f"{self._failed} failed" if self._failed else report.name
        self._bar.set_postfix_str(words, refresh=False)
        self._bar.update()

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


def _tell(summary: Summary, job: Job, path: Path) -> None:
    """What became of the job; the exit status too."""
    parts = [f"{summary.done} items done"]
    if summary.skipped:
        parts.append(f"{summary.skipped} done before")
    if summary.failed:
        parts.append(f"{len(summary.failed)} failed")
    click.echo(f"{', '.join(parts)}; the results are in {job.output_folder}.")
    if summary.unsaved:
        click.echo(f"Error: {summary.unsaved}", err=True)
    if summary.failed:
        click.echo(
            f"'clplen batch status {path}' shows what failed; the next run tries it again.",
            err=True,
        )
    if not summary.is_good:
        click.get_current_context().exit(1)


def _print_estimate(job: Job) -> None:
    from clplen.batch.running.estimate import estimate_job

    found = estimate_job(job)
    for line in found.lines[:_SHOWN]:
        how = f"fails: {line.problem}" if line.problem else _sizes(line.read, line.written)
        how = how if line.problem or line.written else "how much it writes is not known"
        click.echo(f"  {line.name}: {how}{', streamed' if line.streamed else ''}")
    if found.todo > _SHOWN:
        click.echo(f"  and {found.todo - _SHOWN} more")
    sizes = _sizes(found.read, found.written)
    if found.lines and not found.written:
        sizes = f"{_size(found.read)} to read, how much they write is not known"
    click.echo(
        f"{found.todo} items to do ({sizes}), {found.skipped} done "
        f"already; the results go to {job.output_folder}."
    )
    click.echo(_time(found, job.workers))


def _time(found: JobEstimate, workers: int) -> str:
    if not found.todo:
        return "Nothing is to be done."
    if math.isnan(found.seconds):
        return f"Time: not known, {found.sample.rstrip('.')}."
    shared = f", {_clock(found.seconds / workers)} by {workers} workers" if workers > 1 else ""
    return f"Time: about {_clock(found.seconds)}{shared}, for {found.sample}."


def _sizes(read: float, written: float) -> str:
    return f"{_size(read)} to read, {_size(written)} to write"


def _size(count: float) -> str:
    return str(tqdm.format_sizeof(count, suffix="B", divisor=1000))


def _clock(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds < 60 else str(tqdm.format_interval(int(seconds)))


@batch.command()
@click.argument("path", metavar="JOB.toml", type=click.Path(path_type=Path))
@click.option("--verify", is_flag=True, help="Read outputs and inputs again and compare digests.")
def status(path: Path, verify: bool) -> None:
    """Show what is done, failed, changed, damaged or missing of a job; nothing is changed.

    The exit status is 1 unless everything is done.

    \b
    Example:
      clplen batch status job.toml --verify
    """
    from clplen.batch import Job
    from clplen.batch.running.manifest import count_states, status_of

    states = []
    for name, state, why in status_of(Job.read(path), verify=verify):
        states.append(state)
        if state != "done":
            click.echo(f"{name}: {state}: {why}")
    click.echo(f"{len(states)} items: {count_states(states)}.")
    if set(states) - {"done"}:
        click.get_current_context().exit(1)


@click.command()
@click.argument("scheduler", metavar="ADDRESS")
@click.option(
    "--host",
    metavar="ADDRESS",
    help="Address of this computer at which the scheduler reaches the worker; default: 127.0.0.1.",
)
@_CERTIFICATES
@_INSECURE
@options.device
def worker(
    scheduler: str,
    host: str | None,
    certificates: Path | None,
    insecure: bool,
    selector: str | None,
) -> None:
    """Start a worker for 'clplen batch JOB.toml --scheduler ADDRESS'; it runs until it is stopped.

    It is 'dask worker ADDRESS --preload clplen.batch.preload' with as many threads as items
    overlap (one is read, one computed, one written); start one for each
    device, after 'dask scheduler'. A worker runs what its scheduler sends: beyond this computer
    both need the certificate.

    \b
    Example:
      clplen worker tcp://localhost:8786 --device 0:0
      clplen worker tls://10.0.0.1:8786 --host 10.0.0.2 --certificates FOLDER
    """
    from clplen.batch.running.cluster import worker_command
    from clplen.batch.running.network import check_scheduler, network_of
    from clplen.compute.device import Device

    network = network_of(scheduler, host=host, certificates=certificates, insecure=insecure)
    arguments, environment = worker_command(network, selector)
    check_scheduler(network)
    Device.open(selector).ensure_usable()
    if os.name == "posix":  # signals reach the worker itself
        os.execve(arguments[0], arguments, environment)
    click.get_current_context().exit(subprocess.call(arguments, env=environment))
