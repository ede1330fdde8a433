"""The command ``clplen``."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from tqdm import tqdm

from clplen import __version__
from clplen.cli import options
from clplen.cli.messages import Commands, note, sentence
from clplen.cli.sampling import sampling
from clplen.errors import ClplenError

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.lightfield.lightfield import LightField

_FAR = 1e3  # metres: as good as infinity, and still a place


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="clplen")
def main() -> None:
    """Light fields by wave optics, on any OpenCL device.

    Begin with 'clplen demo'; 'clplen COMMAND -h' shows an example of each command.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    logger = logging.getLogger("clplen")
    logger.handlers = [handler]
    logger.setLevel(logging.INFO)


main.add_command(sampling)


@main.command()
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


@main.command()
@click.option(
    "-o",
    "--output",
    default="clplen-demo",
    show_default=True,
    metavar="FOLDER",
    help="Folder for tables, pictures and data; made if it is not there.",
)
@options.device
def demo(output: str, selector: str | None) -> None:
    """Simulate three points before a plenoptic camera, refocus them, find their depths.

    \b
    Example:
      clplen demo -o clplen-demo
    """
    from clplen import demo as experiment
    from clplen.io import output_folder

    device = _opened(selector)
    with output_folder(output) as folder, _bar(experiment.STEPS, "step") as bar:
        experiment.run(
            folder,
            device,
            say=lambda text: tqdm.write(f"{text}\n", file=sys.stdout),
            step=lambda name: _next(bar, name),
        )
    click.echo(
        f"Tables, pictures and data are in {folder}. Next: clplen stack {folder}/lightfield.h5 -o "
        "stack.tif"
    )


def _opened(selector: str | None) -> Device:
    """The device and its way to transform, named before anything is computed."""
    from clplen.compute.device import Device

    device = Device.open(selector)
    click.echo(f"Device: {device!r}, FFT by {device.fft.name}\n")
    return device


def _bar(total: int, unit: str) -> tqdm[Any]:
    return tqdm(total=total, unit=unit, disable=not sys.stderr.isatty(), leave=False)


def _next(bar: tqdm[Any], name: str) -> None:
    bar.set_description(name)
    bar.update()


def _reach(bar: tqdm[Any], done: int, total: int) -> None:
    """How far one part of several has come; each begins anew."""
    if done < bar.n:
        bar.reset()
    bar.total = total
    bar.update(done - bar.n)


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
@click.option(
    "--checkpoint",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Keeps the mean of snapshots of partially coherent light, written every 20 s; a run "
    "that finds it goes on from there.",
)
@options.device
def simulate(camera: Path, output: str, checkpoint: Path | None, selector: str | None) -> None:
    """Simulate a camera and a scene of points and pictures: a raw image and its light field.

    \b
    Example:
      clplen simulate --example > camera.toml
      clplen simulate camera.toml -o simulated
    """
    from clplen import plot
    from clplen.config import CoherenceTable, read_camera_file
    from clplen.io import check_writable, output_folder, write_lightfield, write_picture
    from clplen.lightfield.lightfield import LightField

    wanted = read_camera_file(camera)
    how = wanted.coherence or CoherenceTable()
    if checkpoint is not None and not how.is_random:
        raise click.UsageError(
            f"--checkpoint keeps the mean of snapshots, and {camera} asks for none: leave it out, "
            "or set spatial in [coherence]."
        )
    scene, light = wanted.scene.build(), wanted.light()
    device = _opened(selector)
    built = wanted.camera.build(device)
    sensor = wanted.sensor.build() if wanted.sensor is not None else None
    with output_folder(output) as folder:
        if checkpoint is not None:
            check_writable(checkpoint)
        click.echo(built.describe())
        with _bar(0, "step") as bar:
            raw = built.expose(
                scene,
                coherence=light,
                sensor=sensor,
                progress=lambda done, total: _reach(bar, done, total),
                koehler=how.koehler,
                snapshots=how.snapshots,
                rtol=how.rtol,
                checkpoint=checkpoint,
            )
        lf = LightField.from_raw(raw)
        write_picture(folder / "raw.tif", raw.to_numpy())
        plot.save(plot.raw_image(raw), folder / "raw.png")
        write_lightfield(folder / "lightfield.h5", lf)
    click.echo(
        f"Exposure: {raw.exposure}\n{folder} holds raw.tif, raw.png and lightfield.h5, {_size(lf)}."
    )


def _size(lf: LightField) -> str:
    return "(v, u, y, x) = (" + ", ".join(str(n) for n in lf.shape) + ")"


@main.command()
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, metavar="OUT.tif", type=click.Path(path_type=Path))
@options.plane_range
@click.option(
    "--aperture",
    type=options.Aperture(),
    help="Part of the main lens to use: views across "
    "(9), fraction of the diameter (0.5) or f-number (f/66); default: all.",
)
@options.layout
@options.device
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
    is N planes, both ends included; without it the planes suit what the light field knows.

    \b
    Example:
      clplen stack flower -o stack.tif --pattern "IMG_0001_{n}_{u}_{v}.png"
      clplen stack simulated/lightfield.h5 -o stack.tif --alphas 0.7:1.2:21
    """
    from clplen.io import write_stack
    from clplen.lightfield.depth import sharpness_curve
    from clplen.lightfield.refocus import focal_stack

    _check_planes(disparities, alphas)
    _check_suffix(output, (".tif", ".tiff"))
    _check_outputs(source, layout, output)
    lf = _read(source, selector, layout)
    made = focal_stack(lf, aperture=aperture, **_planes(lf, disparities, alphas))
    best = int(sharpness_curve(made).argmax())
    write_stack(output, made, progress=sys.stderr.isatty())
    alpha = made.alphas[best]
    also = f", alpha = {alpha:.4f}" if np.isfinite(alpha) else ""
    click.echo(
        f"{output} holds {options.planes(len(made.disparities))}; the sharpest is number {best} "
        f"(from 0), d = {made.disparities[best]:.4f}{also}."
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
@options.plane_range
@options.layout
@options.device
def depth(
    source: Path, output: Path, disparities: Any, alphas: Any, selector: str | None, **layout: Any
) -> None:
    """Find the disparity of every pixel: values as PFM or TIFF, and a picture.

    \b
    Example:
      clplen depth flower -o flower.pfm --pattern "IMG_0001_{n}_{u}_{v}.png" --disparities -1:0:41
    """
    from clplen import plot
    from clplen.io import write_depth
    from clplen.lightfield.depth import depth_map

    _check_planes(disparities, alphas)
    _check_suffix(output, (".pfm", ".tif", ".tiff"))
    picture = output.with_suffix(".png")
    _check_outputs(source, layout, output, picture)
    lf = _read(source, selector, layout)
    found = depth_map(lf, **_planes(lf, disparities, alphas))
    write_depth(output, found)
    plot.save(plot.depth(found, title=f"disparity of {source.name}"), picture)
    click.echo(f"{output} holds the disparities, {picture} shows them with their confidence.")


def _read(source: Path, selector: str | None, layout: dict[str, Any]) -> LightField:
    from clplen.compute.device import Device
    from clplen.io import read_lightfield

    return read_lightfield(
        source, device=Device.open(selector), progress=sys.stderr.isatty(), **layout
    )


def _check_planes(disparities: Any, alphas: Any) -> None:
    if disparities is not None and alphas is not None:
        raise click.UsageError("Give --disparities or --alphas, not both.")


def _planes(lf: LightField, disparities: Any, alphas: Any) -> dict[str, Any]:
    """The planes that were asked for, else those that suit the light field."""
    from clplen.lightfield.refocus import shifts

    if disparities is None and alphas is None:
        if np.isfinite(lf.alpha(0.0)):
            low, high, count = options.DEFAULT_ALPHAS
            if lf.camera is not None:
                high = min(high, lf.camera.alpha(_FAR))
            alphas = np.linspace(low, high, count)
        else:
            disparities = np.linspace(*options.DEFAULT_DISPARITIES)
    chosen = lf.disparity(alphas) if disparities is None else disparities
    moved = [np.abs(along).max(axis=1) for along in shifts(lf, chosen)]
    beyond = (moved[0] >= lf.shape[2]) | (moved[1] >= lf.shape[3])
    if beyond.any():
        note(
            f"{beyond.sum()} of {options.planes(beyond.size)} move the outermost views by more "
            "than a whole picture, so that parts stay empty: choose planes nearer to disparity 0."
        )
    return {"alphas": alphas} if disparities is None else {"disparities": disparities}


def _check_outputs(source: Path, layout: dict[str, Any], *outputs: Path) -> None:
    """Refuse outputs that cannot be written, or would replace what is read."""
    from clplen.io import check_writable, files_of

    there = [path for path in map(check_writable, outputs) if path.exists()]
    for file in files_of(source, **layout) if there else []:
        for output in there:
            if file.exists() and file.samefile(output):
                raise click.UsageError(
                    f"{output} is one of the files of {source} that are read: name an output "
                    "elsewhere."
                )


def _check_suffix(output: Path, suffixes: tuple[str, ...]) -> None:
    if output.suffix.lower() not in suffixes:
        raise click.UsageError(f"The output ends in {' or '.join(suffixes)}, not as {output.name}.")
