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

_MAX_LISTED_ITEMS = 20  # fits on a screen


class _RunFirst(click.Group):
    """Group that runs ``clplen batch JOB.toml`` as ``clplen batch run JOB.toml``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands:
            args = ["run", *args]
        return super().parse_args(ctx, args)


@click.group(cls=_RunFirst)
def batch() -> None:
    """Process many light fields: 'clplen batch JOB.toml'."""


def _print_example(ctx: click.Context, _: click.Parameter, is_set: bool) -> None:
    if is_set:
        from clplen.batch.jobs.spec import commented_job

        click.echo(commented_job(), nl=False)
        ctx.exit()


_CERTIFICATES = click.option(
    "--certificates",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="Folder with certificate.pem and key.pem that authenticate workers on several computers. "
    "A job that starts its own scheduler creates missing ones.",
)
_INSECURE = click.option(
    "--insecure",
    is_flag=True,
    help="Disable TLS, also for other computers: ANYONE who reaches a port can run programs as "
    "you. Use it only in networks where you trust every user of every computer.",
)


@batch.command()
@click.argument("path", metavar="JOB.toml", type=click.Path(path_type=Path))
@click.option(
    "--example",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_example,
    help="Print a commented job file and exit.",
)
@click.option(
    "--dry-run",
    is_flag=True,
    help="List the items with their sizes and states, and estimate the time from one item, "
    "processed in a temporary folder.",
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    help="Number of processes on this computer. Default: the value in the job file.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Address of a running Dask scheduler, for example tls://host:8786.",
)
@click.option(
    "--host",
    metavar="ADDRESS",
    help="Network address of this computer on which the scheduler listens, so that workers on "
    "other computers can join. Default: 127.0.0.1, this computer only.",
)
@_CERTIFICATES
@_INSECURE
@click.option(
    "--memory",
    metavar="SIZE",
    help='Memory limit of each worker ("4 GiB"). Default: the value in the job file.',
)
@click.option("--force", is_flag=True, help="Continue although the job file has changed.")
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
    """Run a job file; compute only items that are missing, changed or failed.

    Each item has a folder in the job's output, with a record of its inputs and settings
    (item.json). manifest.sqlite lists the finished items; 'clplen batch status JOB.toml' shows it.

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
            watcher: Any = bar  # no base class: importing it is slow
            summary = job.run(
                scheduler=scheduler,
                host=host,
                certificates=certificates,
                insecure=insecure,
                force=force,
                watcher=watcher,
            )
        _print_summary(summary, job, path)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence the log lines of each item and of Dask; the summary reports lost items."""
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
    """Progress bar of the items, with the progress of the current item."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None
        self._failed = self._done = self._total = 0

    def begin(self, *, total: int, skipped: int) -> None:
        """Open the bar; ``skipped`` of ``total`` items are already done."""
        self._done, self._total = skipped, total
        if skipped:
            click.echo(f"{skipped} of {total} items are already done.", err=True)
        self._bar = tqdm(
            total=total - skipped, unit="item", disable=not sys.stderr.isatty(), dynamic_ncols=True
        )

    def running(self, name: str, done: int, total: int) -> None:
        """Show the progress of an item."""
        if self._bar is not None:
            self._bar.set_postfix_str(f"{name} {100 * done // max(total, 1)} %")

    def report(self, report: Report) -> None:
        """Advance by an item that finished or failed."""
        assert self._bar is not None
        if report.state == "failed":
            self._failed += 1
            with tqdm.external_write_mode(sys.stderr):
                click.echo(f"{report.name} failed: {report.error}", err=True)
        else:
            self._done += 1
        postfix = f"{self._failed} failed" if self._failed else report.name
        self._bar.set_postfix_str(postfix, refresh=False)
        self._bar.update()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._bar is None:
            return
        self._bar.close()
        if kind is KeyboardInterrupt:
            click.echo(
                f"\n{self._done} of {self._total} items are done; the next run continues.",
                err=True,
            )


def _print_summary(summary: Summary, job: Job, path: Path) -> None:
    """Print the outcome of the job, and set the exit status."""
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
            f"'clplen batch status {path}' lists the failures; the next run retries them.",
            err=True,
        )
    if not summary.is_good:
        click.get_current_context().exit(1)


def _print_estimate(job: Job) -> None:
    from clplen.batch.running.estimate import estimate_job

    estimate = estimate_job(job)
    for line in estimate.lines[:_MAX_LISTED_ITEMS]:
        sizes_text = f"fails: {line.problem}" if line.problem else _sizes(line.read, line.written)
        sizes_text = sizes_text if line.problem or line.written else "size of the outputs unknown"
        click.echo(f"  {line.name}: {sizes_text}{', streamed' if line.streamed else ''}")
    if estimate.todo > _MAX_LISTED_ITEMS:
        click.echo(f"  and {estimate.todo - _MAX_LISTED_ITEMS} more")
    sizes = _sizes(estimate.read, estimate.written)
    if estimate.lines and not estimate.written:
        sizes = f"{_size(estimate.read)} to read, size of the outputs unknown"
    click.echo(
        f"{estimate.todo} items to do ({sizes}), {estimate.skipped} already "
        f"done; the results go to {job.output_folder}."
    )
    click.echo(_time(estimate, job.workers))


def _time(estimate: JobEstimate, workers: int) -> str:
    if not estimate.todo:
        return "Every item is done."
    if math.isnan(estimate.seconds):
        return f"Time: unknown, {estimate.sample.rstrip('.')}."
    shared = f", {_clock(estimate.seconds / workers)} with {workers} workers" if workers > 1 else ""
    return f"Time: about {_clock(estimate.seconds)}{shared}, estimated from {estimate.sample}."


def _sizes(read: float, written: float) -> str:
    return f"{_size(read)} to read, {_size(written)} to write"


def _size(count: float) -> str:
    if count < 1000:
        return f"{count:.0f} B"
    text = str(tqdm.format_sizeof(count, divisor=1000))
    return f"{text[:-1]} {text[-1]}B"


def _clock(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds < 60 else str(tqdm.format_interval(int(seconds)))


@batch.command()
@click.argument("path", metavar="JOB.toml", type=click.Path(path_type=Path))
@click.option("--verify", is_flag=True, help="Read outputs and inputs again, and compare digests.")
def status(path: Path, verify: bool) -> None:
    """List the items of a job that failed, changed, are damaged or missing; change no file.

    The exit status is 0 if every item is done, else 1.

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
    help="Network address of this computer for the scheduler. Default: 127.0.0.1.",
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
    """Start a worker for batch jobs with a scheduler.

    Start 'dask scheduler' first, then one worker for each device, then 'clplen batch JOB.toml
    --scheduler ADDRESS'. Press Ctrl-C to stop the worker. The command runs 'dask worker
    ADDRESS --preload clplen.batch.preload' with three threads: one item is read, one computed and
    one written at a time. A worker executes any code that its scheduler sends: with several
    computers, both need the certificate.

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
