"""A benchmark of this folder as a command: ``--device``, ``--size``, ``--repeats``, ``--quick``."""

from __future__ import annotations

import click

from clplen import Device
from clplen.bench import (
    Benchmark,
    Report,
    describe_environment,
    device_text,
    quiet_enough,
    report_text,
    run_benchmark,
)


def command(benchmark: Benchmark, words: str | None) -> click.Command:
    """The command of a script whose docstring is ``words``."""

    @click.command(help=words)
    @click.option("--device", "selector", help="As Device.open takes it.")
    @click.option("--size", "sizes", multiple=True, help="Instead of its own; repeatable.")
    @click.option("--repeats", default=5, show_default=True, type=click.IntRange(1))
    @click.option("--quick", is_flag=True, help="A small size, to see that it works.")
    def main(selector: str | None, sizes: tuple[str, ...], repeats: int, quick: bool) -> None:
        device = Device.open(selector)
        default = (benchmark.quick,) if quick else benchmark.sizes
        measure(benchmark, device, sizes or default, repeats)

    return main


def measure(
    benchmark: Benchmark, device: Device, sizes: tuple[str, ...], repeats: int
) -> list[Report]:
    """Run and print a benchmark at some sizes."""
    click.echo(f"{device_text(describe_environment(device))}\n{quiet_enough()}")
    reports = []
    for size in sizes:
        report = run_benchmark(benchmark, device, size=size, repeats=repeats, say=click.echo)
        if report:
            click.echo(report_text(report))
            reports.append(report)
    return reports
