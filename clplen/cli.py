"""The command ``clplen``."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from tqdm import tqdm

from clplen import __version__
from clplen.errors import ClplenError

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.lightfield.lightfield import LightField

INTERRUPTED = 130  # 128 + SIGINT, as shells count
DEFAULT_PLANES = "-2:2:33"


class _Commands(click.Group):
    """Commands whose expected failures are one sentence, not a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt:
                click.echo("\nInterrupted; no file was left half-written.", err=True)
                ctx.exit(INTERRUPTED)
            except BrokenPipeError:
                raise
            except (ClplenError, ValueError, OSError, MemoryError) as error:
                raise click.ClickException(_sentence(error)) from error


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    click.echo(f"Note: {message}", err=True)


def _sentence(error: BaseException) -> str:
    """What went wrong, without a compiler's log."""
    if isinstance(error, OSError) and error.errno is not None:
        return str(error)
    first = str(error.args[0]) if error.args else type(error).__name__
    return "There is not enough memory on this computer." if isinstance(error, MemoryError) else first


class _Planes(click.ParamType):
    """START:STOP:N, N values with both ends included."""

    name = "START:STOP:N"

    def convert(self, value: Any, param: Any, ctx: Any) -> np.ndarray[Any, Any]:
        parts = str(value).split(":")
        try:
            start, stop, count = float(parts[0]), float(parts[1]), int(parts[2])
        except (ValueError, IndexError):
            count = 0 if len(parts) != 3 else -1
        if len(parts) != 3 or count < 0 or not np.isfinite([start, stop]).all():
            self.fail(f"{value!r} is not START:STOP:N, for example -2:2:33.", param, ctx)
        if count == 0 or (count == 1) != (start == stop):
            self.fail(
                f"{value!r} is an empty range: give at least 2 planes between two different ends, "
                "or 1 plane with START equal to STOP.", param, ctx,
            )
        return np.linspace(start, stop, count)


class _Aperture(click.ParamType):
    """A number of views, a fraction of the full diameter, or an f-number."""

    name = "N|FRACTION|f/NUMBER"

    def convert(self, value: Any, param: Any, ctx: Any) -> int | float | str:
        text = str(value)
        if text.lower().startswith("f/"):
            return text
        try:
            return float(text) if "." in text else int(text)
        except ValueError:
            self.fail(
                f"{text!r} is no aperture: give a number of views (9), a fraction of the full "
                "diameter (0.5) or an f-number (f/66).", param, ctx,
            )


def _with_options(*options: Any) -> Callable[[Any], Any]:
    def add(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return add


_device = click.option(
    "--device", "selector", metavar="DEVICE", default=None,
    help="cpu, gpu, platform:device (0:1) or part of a name; default: $CLPLEN_DEVICE, else the "
    "first GPU, else the first CPU. See 'clplen devices'.",
)
_layout = _with_options(
    click.option("--pattern", metavar="NAMES", help="Names of the views in a folder: {v} and {u} "
                 "row and column, or {i} row by row; {n} a counter to ignore; * anything."),
    click.option("--views", type=int, nargs=2, metavar="V U", default=None,
                 help="Rows and columns of views, as the names count them."),
    click.option("--swap-uv", is_flag=True, help="The names count columns before rows."),
    click.option("--flip-v", is_flag=True, help="Reverse the rows of views (after --swap-uv)."),
    click.option("--flip-u", is_flag=True, help="Reverse the columns of views."),
    click.option("--allow-missing", is_flag=True, help="Leave out views that are missing."),
)
_planes = _with_options(
    click.option("--disparities", type=_Planes(),
                 help="Planes by disparity, pixels a view step, nearer is larger; default "
                 f"{DEFAULT_PLANES}."),
    click.option("--alphas", type=_Planes(), help="Planes by alpha = F/F', where the light field "
                 "knows its spacing."),
)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
def main() -> None:
    """Light fields by wave optics, on any OpenCL device.

    Begin with 'clplen demo'; 'clplen COMMAND -h' shows an example of each command.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    logger = logging.getLogger("clplen.io")
    logger.handlers = [handler]
    logger.setLevel(logging.INFO)


@main.command()
@_device
def devices(selector: str | None) -> None:
    """List the OpenCL devices, and say which one would be taken and why.

    \b
    Example:
      clplen devices
      clplen devices --device intel
    """
    from clplen.compute.device import Device
    from clplen.compute.listing import list_devices

    wanted = selector or os.environ.get("CLPLEN_DEVICE") or None
    taken, why = _taken(wanted)
    for place, device, fault in list_devices():
        mark = "*" if taken is not None and device.cl_device == taken.cl_device else " "
        fp64 = "yes" if device.has_fp64 else "no"
        route = f"{device.fft.name}" + ("" if device.fft.name == "vkfft" else
                                        f", {device.fft.threads} threads")
        click.echo(f"{mark} {place}  {device.name}")
        click.echo(f"       driver   {device.driver}")
        click.echo(f"       memory   {device.memory_bytes / 2**30:.1f} GiB")
        click.echo(f"       fp64     {fp64}")
        click.echo(f"       FFT      {route}")
        if device.note or fault:
            click.echo(f"       note     {device.note or fault}")
    click.echo(why)


def _taken(wanted: str | None) -> tuple[Device | None, str]:
    """The device that a command would take, and the reason."""
    from clplen.compute.device import Device

    try:
        device = Device.open(wanted)
    except ClplenError as error:
        return None, f"None would be taken: {_sentence(error)}"
    if wanted is not None:
        reason = f"it fits {wanted!r}"
    elif not device.is_cpu:
        reason = "it is the first GPU"
    else:
        reason = "there is no usable GPU, and it is the first CPU that compiles kernels"
    return device, f"* {device.name} would be taken: {reason}."
