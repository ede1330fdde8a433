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
    if isinstance(error, MemoryError):
        return "This computer has not enough memory for it."
    if isinstance(error, OSError) and error.errno is not None:
        return str(error)
    return str(error.args[0]) if error.args else type(error).__name__


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
                "or 1 plane with START equal to STOP.",
                param,
                ctx,
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
                "diameter (0.5) or an f-number (f/66).",
                param,
                ctx,
            )


def _with_options(*options: Any) -> Callable[[Any], Any]:
    def add(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return add


_device = click.option(
    "--device",
    "selector",
    metavar="DEVICE",
    default=None,
    help="cpu, gpu, platform:device (0:1) or part of a name; default: $CLPLEN_DEVICE, else the "
    "first GPU, else the first CPU. See 'clplen devices'.",
)
_layout = _with_options(
    click.option(
        "--pattern",
        metavar="NAMES",
        help="Names of the views in a folder: {v} and {u} "
        "row and column, or {i} row by row; {n} a counter to ignore; * anything.",
    ),
    click.option(
        "--views",
        type=int,
        nargs=2,
        metavar="V U",
        default=None,
        help="Rows and columns of views, as the names count them.",
    ),
    click.option("--swap-uv", is_flag=True, help="The names count columns before rows."),
    click.option("--flip-v", is_flag=True, help="Reverse the rows of views (after --swap-uv)."),
    click.option("--flip-u", is_flag=True, help="Reverse the columns of views."),
    click.option("--allow-missing", is_flag=True, help="Leave out views that are missing."),
)
_planes = _with_options(
    click.option(
        "--disparities",
        type=_Planes(),
        help="Planes by disparity, pixels a view step, nearer is larger; default "
        f"{DEFAULT_PLANES}.",
    ),
    click.option(
        "--alphas",
        type=_Planes(),
        help="Planes by alpha = F/F', where the light field knows its spacing.",
    ),
)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="clplen")
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

    warnings.simplefilter("ignore")  # what they say stands in the list
    wanted = selector or os.environ.get("CLPLEN_DEVICE") or None
    taken, why = _taken(wanted)
    for device in Device.all():
        click.echo(_listed(device, taken))
    click.echo(why)


def _listed(device: Device, taken: Device | None) -> str:
    """One device with what can be said about it."""
    from clplen.compute.device import Device

    try:
        note = Device.open(device.place).note
    except ClplenError as error:
        note = _sentence(error)
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
        return None, f"None would be taken: {_sentence(error)}"
    if wanted is not None:
        reason = f"it fits {wanted!r}"
    elif not device.is_cpu:
        reason = "it is the first GPU"
    else:
        reason = "there is no usable GPU, and it is the first CPU that compiles kernels"
    return device, f"* {device.name} would be taken: {reason}."


@main.command()
@click.option(
    "-o",
    "--output",
    default="clplen-demo",
    show_default=True,
    metavar="FOLDER",
    help="Folder for tables' pictures and data; made if it is not there.",
)
@_device
def demo(output: str, selector: str | None) -> None:
    """Simulate three points before a plenoptic camera, refocus them, find their depths.

    \b
    Example:
      clplen demo -o clplen-demo
    """
    from clplen import demo as experiment
    from clplen.compute.device import Device
    from clplen.io import check_folder

    folder = check_folder(output)
    device = Device.open(selector)
    click.echo(f"Device: {device!r}\n")
    with _bar(experiment.STEPS, "step") as bar:
        experiment.run(
            folder,
            device,
            say=lambda text: tqdm.write(f"{text}\n", file=sys.stdout),
            step=lambda name: _next(bar, name),
        )
    click.echo(f"Pictures and data are in {folder}.")


def _bar(total: int, unit: str) -> tqdm[Any]:
    return tqdm(total=total, unit=unit, disable=not sys.stderr.isatty(), leave=False)


def _next(bar: tqdm[Any], name: str) -> None:
    bar.set_description(name)
    bar.update()


def _print_example(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from clplen.config import EXAMPLE

        click.echo(EXAMPLE, nl=False)
        ctx.exit()


@main.command()
@click.argument("camera", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FOLDER",
    help="Folder for raw.tif, raw.png and lightfield.h5; made if it is not there.",
)
@click.option(
    "--example",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_example,
    help="Print a commented camera file and stop.",
)
@_device
def simulate(camera: Path, output: str, selector: str | None) -> None:
    """Simulate a camera and a scene: a raw image and its light field.

    \b
    Example:
      clplen simulate --example > camera.toml
      clplen simulate camera.toml -o simulated
    """
    from clplen import plot
    from clplen.compute.device import Device
    from clplen.config import read_camera_file
    from clplen.io import check_folder, write_lightfield, write_picture
    from clplen.lightfield.lightfield import LightField

    wanted = read_camera_file(camera)
    device = Device.open(selector)
    built, scene = wanted.camera.build(device), wanted.scene.build()
    sensor = wanted.sensor.build() if wanted.sensor is not None else None
    folder = check_folder(output)
    click.echo(built.describe())
    with _bar(len(scene), "point") as bar:
        raw = built.expose(
            scene, sensor=sensor, progress=lambda done, _: bar.update(done - bar.n) and None
        )
    lf = LightField.from_raw(raw)
    write_picture(folder / "raw.tif", raw.to_numpy())
    plot.save(plot.raw_image(raw), folder / "raw.png")
    write_lightfield(folder / "lightfield.h5", lf)
    click.echo(f"{folder} holds raw.tif, raw.png and lightfield.h5, {_size(lf)}.")


def _size(lf: LightField) -> str:
    return "(v, u, y, x) = (" + ", ".join(str(n) for n in lf.shape) + ")"


@main.command()
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, metavar="OUT.tif", type=click.Path(path_type=Path))
@_planes
@click.option(
    "--aperture",
    type=_Aperture(),
    help="Part of the main lens to use: views across "
    "(9), fraction of the diameter (0.5) or f-number (f/66); default: all.",
)
@_layout
@_device
def stack(
    source: Path,
    output: Path,
    disparities: Any,
    alphas: Any,
    aperture: Any,
    selector: str | None,
    **layout: Any,
) -> None:
    """Refocus a light field on many planes, into one TIFF of linear float32 pictures.

    INPUT is a folder with one picture a view, or an .h5 file of 'clplen simulate'. START:STOP:N
    is N planes, both ends included.

    \b
    Example:
      clplen stack flower -o stack.tif --pattern "IMG_0001_{n}_{u}_{v}.png"
      clplen stack simulated/lightfield.h5 -o stack.tif --alphas 0.7:1.2:21
    """
    from clplen.io import check_writable, write_stack
    from clplen.lightfield.depth import sharpness_curve
    from clplen.lightfield.refocus import focal_stack

    planes = _chosen_planes(disparities, alphas)
    _check_suffix(output, (".tif", ".tiff"))
    check_writable(output)
    lf = _read(source, selector, layout)
    made = focal_stack(lf, aperture=aperture, **planes)
    best = int(sharpness_curve(made).argmax())
    write_stack(output, made, progress=sys.stderr.isatty())
    alpha = made.alphas[best]
    also = f", alpha = {alpha:.4f}" if np.isfinite(alpha) else ""
    click.echo(
        f"{output} holds {len(made.disparities)} planes; the sharpest is number {best} (from 0), "
        f"d = {made.disparities[best]:.4f}{also}."
    )


@main.command()
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT.pfm|OUT.tif",
    type=click.Path(path_type=Path),
    help="Disparities; a picture of the same name in .png is written beside them.",
)
@_planes
@_layout
@_device
def depth(
    source: Path, output: Path, disparities: Any, alphas: Any, selector: str | None, **layout: Any
) -> None:
    """Find the disparity of every pixel: values as PFM or TIFF, and a picture.

    \b
    Example:
      clplen depth flower -o flower.pfm --pattern "IMG_0001_{n}_{u}_{v}.png" --disparities -1:0:41
    """
    from clplen import plot
    from clplen.io import check_writable, write_depth
    from clplen.lightfield.depth import depth_map

    planes = _chosen_planes(disparities, alphas)
    _check_suffix(output, (".pfm", ".tif", ".tiff"))
    check_writable(output)
    found = depth_map(_read(source, selector, layout), **planes)
    write_depth(output, found)
    picture = output.with_suffix(".png")
    plot.save(plot.depth(found, title=f"disparity of {source.name}"), picture)
    click.echo(f"{output} holds the disparities, {picture} shows them with their confidence.")


def _read(source: Path, selector: str | None, layout: dict[str, Any]) -> LightField:
    from clplen.compute.device import Device
    from clplen.io import read_lightfield

    return read_lightfield(
        source, device=Device.open(selector), progress=sys.stderr.isatty(), **layout
    )


def _chosen_planes(disparities: Any, alphas: Any) -> dict[str, Any]:
    if disparities is not None and alphas is not None:
        raise click.UsageError("Give --disparities or --alphas, not both.")
    if alphas is not None:
        return {"alphas": alphas}
    default = _Planes().convert(DEFAULT_PLANES, None, None)
    return {"disparities": default if disparities is None else disparities}


def _check_suffix(output: Path, suffixes: tuple[str, ...]) -> None:
    if output.suffix.lower() not in suffixes:
        raise click.UsageError(f"The output ends in {' or '.join(suffixes)}, not as {output.name}.")
