"""``clplen bench``."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clplen.bench.report import Benchmark
from clplen.cli.shared import options
from clplen.cli.shared.console import note

if TYPE_CHECKING:
    from clplen.bench.report import Report
    from clplen.compute.device import Device


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@options.device
@click.option("--list", "listed", is_flag=True, help="List the benchmarks and exit.")
@click.option(
    "--size",
    "sizes",
    multiple=True,
    help="Problem size, instead of the benchmark's defaults; may be repeated.",
)
@click.option(
    "--repeats",
    default=5,
    show_default=True,
    type=click.IntRange(1),
    help="Number of timed repetitions.",
)
@click.option(
    "--quick",
    is_flag=True,
    help="Use small sizes, to test that the benchmarks run; the timings mean little.",
)
@click.option(
    "--profile",
    "profiled",
    is_flag=True,
    help="Time every kernel, and compare with the measured limits of the device.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON, which --compare reads.")
@click.option(
    "--compare",
    "saved",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="FILE",
    help="JSON file of an earlier run whose ratios are compared.",
)
def bench(
    names: tuple[str, ...],
    selector: str | None,
    listed: bool,
    sizes: tuple[str, ...],
    repeats: int,
    quick: bool,
    profiled: bool,
    as_json: bool,
    saved: Path | None,
) -> None:
    """Measure the speed of the device.

    Each rate is printed with its ratio to that of a simple operation on the same computer. Compare
    these ratios, not seconds, between computers. Without NAME every benchmark runs.

    \b
    Example:
      clplen bench stack
      clplen bench propagation --profile
      clplen bench --json > before.json
      clplen bench --compare before.json
    """
    from clplen.bench import registry
    from clplen.bench import report as results
    from clplen.bench.environment import describe_environment, quiet_enough
    from clplen.compute.device import Device

    selection = names or registry.NAMES
    benchmarks = {name: registry.find_benchmark(name) for name in selection}
    if listed:
        click.echo(
            "\n".join(f"{name:12s} {benchmark.summary}" for name, benchmark in benchmarks.items())
        )
        return
    if sizes and len(selection) != 1:
        raise click.UsageError("--size applies to a single benchmark: give its NAME.")
    if profiled and as_json:
        raise click.UsageError("--profile cannot be combined with --json: give one of them.")
    logging.getLogger("clplen").setLevel(logging.WARNING)  # hides the readers' log lines
    before = results.read_run(saved) if saved else None
    device = Device.open(selector)
    environment, busy = describe_environment(device), quiet_enough()
    if not as_json:
        click.echo(f"{results.device_text(environment)}\n")
    reports = []
    for benchmark in benchmarks.values():
        for size in sizes or ((benchmark.quick,) if quick else benchmark.sizes):
            report, lines = _measure(device, benchmark, size, repeats, profiled)
            reports += [report] if report else []
            if report and not as_json:
                click.echo("\n".join([results.report_text(report), *lines, ""]))
    if as_json:
        click.echo(results.run_as_json(reports, environment))
    if before is not None:
        click.echo(results.compare_runs(reports, before), err=as_json)
    if busy:
        note(busy)
    if not reports:
        raise click.ClickException("No benchmark fits into the memory: try --quick.")


def _measure(
    device: Device, benchmark: Benchmark, size: str, repeats: int, profiled: bool
) -> tuple[Report | None, list[str]]:
    """Run a benchmark at one size; return its report and the lines of its profile."""
    from clplen.bench import ceilings, registry
    from clplen.bench import report as results

    if not profiled:
        return registry.run_benchmark(benchmark, device, size=size, repeats=repeats, say=note), []
    limits = ceilings.measure(device)
    with device.profiling() as profile:
        report = registry.run_benchmark(benchmark, device, size=size, repeats=repeats, say=note)
    return report, [results.profile_text(profile.runs, limits)]
