"""``clplen devices``."""

from __future__ import annotations

import json
import os
import warnings
from typing import TYPE_CHECKING

import click

from clplen.cli.shared import options
from clplen.cli.shared.console import error_sentence
from clplen.errors import ClplenError

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.selftest.report import DeviceReport


@click.command()
@options.device
@click.option(
    "--check",
    is_flag=True,
    help="Compare every kind of computation with NumPy in double precision, on the devices that "
    "--device fits or else on each one; the exit status is 1 if anything is wrong.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON with --check, not a table.")
def devices(selector: str | None, check: bool, as_json: bool) -> None:
    """List the OpenCL devices, and say which one would be taken and why; or check them.

    \b
    Example:
      clplen devices
      clplen devices --device intel
      clplen devices --check
    """
    from clplen.compute.device import Device

    warnings.simplefilter("ignore")  # what they say stands in the list
    if as_json and not check:
        raise click.UsageError("--json belongs to --check: give both.")
    if check:
        if not _checked(selector, as_json):
            click.get_current_context().exit(1)
        return
    wanted = selector or os.environ.get("CLPLEN_DEVICE") or None
    taken, why = _taken(wanted)
    for device in Device.all():
        click.echo(_listed(device, taken))
    click.echo(why)
    if taken is None:
        click.get_current_context().exit(1)


def _listed(device: Device, taken: Device | None) -> str:
    """One device with what can be said about it."""
    from clplen.compute.device import Device

    try:
        note = Device.open(device.place).note
    except ClplenError as error:
        note = error_sentence(error)
    mark = "*" if taken is not None and device.cl_device == taken.cl_device else " "
    route = device.fft.name
    if route != "vkfft":
        route += f" on the host, {device.fft.threads} threads"
    lines = [
        f"{mark} {device.place}  {device.name}",
        f"driver  {device.driver}",
        f"memory  {device.memory_bytes / 2**30:.1f} GiB",
        f"fp64    {'yes' if device.has_fp64 else 'no'}",
        f"FFT     {route}",
    ]
    return "\n       ".join(lines + ([f"note    {note}"] if note else []))


def _taken(wanted: str | None) -> tuple[Device | None, str]:
    """The device that a command would take, and the reason."""
    from clplen.compute.device import Device

    try:
        device = Device.open(wanted)
    except ClplenError as error:
        return None, f"None would be taken: {error_sentence(error)}"
    if wanted is not None:
        reason = f"it fits {wanted!r}"
    elif not device.is_cpu:
        reason = "it is the first GPU"
    else:
        reason = "there is no usable GPU, and it is the first CPU that compiles kernels"
    return device, f"* {device.name} would be taken: {reason}."


def _checked(selector: str | None, as_json: bool) -> bool:
    """Check some devices, print what came of it, and say whether all is well."""
    from clplen.compute.device import Device
    from clplen.compute.drivers.selection import find_devices, select
    from clplen.selftest.report import paste_block
    from clplen.selftest.runner import numbers_of

    there = Device.all()
    if selector is not None:
        fitting = [place for place, _ in select(find_devices(), selector)]
        there = [device for device in there if device.place in fitting]
    reports = [_report_of(device, as_json) for device in there]
    if as_json:
        click.echo(json.dumps(numbers_of(reports), indent=1))
    else:
        click.echo(paste_block(reports))
    return not any(result.failed for report in reports for result in report.results)


def _report_of(device: Device, is_silent: bool) -> DeviceReport:
    """The checks of one device, each row printed when it is there."""
    from clplen.selftest.report import HEAD, row, summary
    from clplen.selftest.runner import run_isolated

    if is_silent:
        return run_isolated(device)
    click.echo(f"{device.place}  {device.name}, {device.driver}\n\n{HEAD}")
    report = run_isolated(device, watch=lambda result: click.echo(row(result)))
    click.echo(f"\n{summary(report.results, report.seconds)}\n")
    return report
