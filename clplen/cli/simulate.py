"""``clplen simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from clplen.cli.shared import options
from clplen.cli.shared.console import (
    describe_shape,
    note_link,
    open_device,
    progress_bar,
    update_bar,
)

if TYPE_CHECKING:
    from clplen.lightfield.raw.raw_image import RawImage

_FILES = ("raw.tif", "raw.png", "lightfield.h5", "raw.h5")


def _print_example(ctx: click.Context, _: click.Parameter, is_set: bool) -> None:
    if is_set:
        from clplen.config.example import EXAMPLE

        click.echo(EXAMPLE, nl=False)
        ctx.exit()


@click.command()
@click.argument("camera", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FOLDER",
    help="Output folder for raw.tif, raw.png and lightfield.h5 (raw.h5 for a focused camera); "
    "created if missing.",
)
@click.option(
    "--example",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_example,
    help="Print a commented camera file and exit.",
)
@options.file(
    "--checkpoint",
    help="File that stores the mean of partially coherent snapshots every 20 s; another run "
    "continues from it.",
)
@options.force_output
@options.device
def simulate(
    camera: Path, output: str, checkpoint: Path | None, force: bool, selector: str | None
) -> None:
    """Simulate the raw image of a camera and scene.

    The TOML file CAMERA describes camera, scene and sensor. For a focused camera (plenoptic 2.0),
    raw.h5 with the raw image and the camera takes the place of the light field: pass it to 'clplen
    render', 'stack' or 'depth'.

    \b
    Example:
      clplen simulate --example > camera.toml
      clplen simulate camera.toml -o simulated
    """
    from clplen import plot
    from clplen.config.camera_file import read_camera_file
    from clplen.files import check_writable, output_folder
    from clplen.outputs import check_outputs

    camera_file = read_camera_file(camera)
    if checkpoint is not None and not (camera_file.coherence and camera_file.coherence.is_random):
        raise click.UsageError(
            f"--checkpoint needs partially coherent light, but {camera} does not set it: leave it "
            "out, or set spatial in [coherence]."
        )
    note_link(output)
    check_outputs(output, _FILES, force=force)
    settings = camera_file.exposure()
    device = open_device(selector)
    built = camera_file.camera.build(device)
    with output_folder(output) as folder:
        if checkpoint is not None:
            check_writable(checkpoint)
        click.echo(built.describe())
        with progress_bar(0, "step") as bar:
            raw = built.expose(
                **settings,
                progress=lambda done, total: update_bar(bar, done, total),
                checkpoint=checkpoint and (checkpoint, camera_file.label),
            )
        _write_frame(folder / "raw.tif", raw)
        plot.save(plot.raw_image(raw), folder / "raw.png")
        more = _write_samples(folder, raw)
    click.echo(f"Exposure: {raw.exposure}\n{folder} holds raw.tif, raw.png and {more}.")


def _write_frame(path: Path, raw: RawImage) -> None:
    """Write the raw counts of a colour-filter sensor, or other values as a picture."""
    from clplen.io import write_picture, write_raw

    if raw.mosaic is not None and raw.levels is not None and raw.levels.bit_depth <= 16:
        write_raw(path, raw)
    else:
        write_picture(path, raw.to_numpy())


def _write_samples(folder: Path, raw: RawImage) -> str:
    """Write the light field, or raw.h5 for a focused camera; return its description."""
    from clplen.io import write_lightfield, write_raw
    from clplen.lightfield.model.light_field import LightField

    if raw.camera is not None and raw.camera.kind == "focused":
        write_raw(folder / "raw.h5", raw)
        rows, columns = raw.sub_images.count
        return f"raw.h5, {rows} x {columns} lenslets with their camera"
    lf = LightField.from_raw(raw)
    write_lightfield(folder / "lightfield.h5", lf)
    return f"lightfield.h5, {describe_shape(lf)}"
