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
    help="Test every kind of computation against NumPy in double precision, on all devices or "
    "those that match --device. The exit status is 1 if a test fails.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table (--check).")
def devices(selector: str | None, check: bool, as_json: bool) -> None:
    """List or test the OpenCL devices.

    The list marks the default device. --check ends with a sentence that says whether the devices
    are fit for use.

    \b
    Example:
      clplen devices
      clplen devices --device intel
      clplen devices --check
    """
    from clplen.compute.device import Device

    warnings.simplefilter("ignore")  # the list repeats them as notes
    if as_json and not check:
        raise click.UsageError("--json applies to --check: give both.")
    if check:
        if not _check(selector, as_json):
            click.get_current_context().exit(1)
        return
    default, reason = _default_device(selector or os.environ.get("CLPLEN_DEVICE") or None)
    for device in Device.all():
        click.echo(_describe(device, default))
    click.echo(reason)
    if default is None:
        click.get_current_context().exit(1)


def _describe(device: Device, default: Device | None) -> str:
    """Return the properties of a device as lines of text."""
    from clplen.compute.device import Device

    try:
        note = Device.open(device.place).note
    except ClplenError as error:
        note = error_sentence(error)
    is_default = default is not None and device.cl_device == default.cl_device
    mark = "*" if is_default else " "
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


def _default_device(selector: str | None) -> tuple[Device | None, str]:
    """Return the device that commands use, and the reason."""
    from clplen.compute.device import Device

    try:
        device = Device.open(selector)
    except ClplenError as error:
        return None, f"No device can be used: {error_sentence(error)}"
    if selector is not None:
        reason = f"it matches {selector!r}"
    elif not device.is_cpu:
        reason = "it is the first GPU"
    else:
        reason = "no GPU is usable, and it is the first CPU that compiles kernels"
    return device, f"* {device.name} is used: {reason}."


def _check(selector: str | None, as_json: bool) -> bool:
    """Test devices and print the results; return True if every test passed."""
    from clplen.compute.device import Device
    from clplen.compute.drivers.selection import find_devices, select
    from clplen.selftest.report import paste_block
    from clplen.selftest.runner import numbers_of

    devices = Device.all()
    if selector is not None:
        matches = [position for position, _ in select(find_devices(), selector)]
        devices = [device for device in devices if device.place in matches]
    reports = [_report_of(device, as_json) for device in devices]
    if as_json:
        click.echo(json.dumps(numbers_of(reports), indent=1))
    else:
        click.echo(f"{paste_block(reports)}\n\n{_verdict(reports)}")
    return not any(result.failed for report in reports for result in report.results)


def _verdict(reports: list[DeviceReport]) -> str:
    """Return a sentence about the devices that are fit for use and those that are not."""
    failures = [[result.name for result in report.results if result.failed] for report in reports]
    names = [report.facts.get("device", "the device").split("  ")[-1] for report in reports]
    fit = [name for name, failed in zip(names, failures, strict=True) if not failed]
    unfit = [
        f"{name} (failed: {', '.join(failed)})"
        for name, failed in zip(names, failures, strict=True)
        if failed
    ]
    parts = [f"fit for use: {', '.join(fit)}"] if fit else []
    parts += [f"not fit for use: {', '.join(unfit)}"] if unfit else []
    sentence = "; ".join(parts) or "no device was tested"
    return f"{sentence[0].upper()}{sentence[1:]}."


def _report_of(device: Device, is_silent: bool) -> DeviceReport:
    """Test a device and print each row when its test ends."""
    from clplen.selftest.report import HEAD, row, summary
    from clplen.selftest.runner import run_isolated

    if is_silent:
        return run_isolated(device)
    click.echo(f"{device.place}  {device.name}, {device.driver}\n\n{HEAD}")
    report = run_isolated(device, watch=lambda result: click.echo(row(result)))
    click.echo(f"\n{summary(report.results, report.seconds)}\n")
    return report
