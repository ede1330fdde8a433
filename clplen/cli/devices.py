"""``clplen devices``."""

from __future__ import annotations

import os
import warnings
from typing import TYPE_CHECKING

import click

from clplen.cli import options
from clplen.cli.messages import sentence
from clplen.errors import ClplenError

if TYPE_CHECKING:
    from clplen.compute.device import Device


@click.command()
@options.device
def devices(selector: str | None) -> None:
    """List the OpenCL devices, and say which one would be taken and why.

    \b
    Example:
      clplen devices
      clplen devices --device intel
    """
    from clplen.compute.device import Device

    warnings.simplefilter("ignore")  # what they say stands in the list
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
        note = sentence(error)
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
        return None, f"None would be taken: {sentence(error)}"
    if wanted is not None:
        reason = f"it fits {wanted!r}"
    elif not device.is_cpu:
        reason = "it is the first GPU"
    else:
        reason = "there is no usable GPU, and it is the first CPU that compiles kernels"
    return device, f"* {device.name} would be taken: {reason}."
