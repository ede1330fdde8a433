"""``clplen simulate``."""

from __future__ import annotations

from pathlib import Path

import click

from clplen.cli import options
from clplen.cli.common import bar_of, opened, reach, size_of


def _print_example(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from clplen.config import EXAMPLE

        click.echo(EXAMPLE, nl=False)
        ctx.exit()


@click.command()
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
    device = opened(selector)
    built = wanted.camera.build(device)
    sensor = wanted.sensor.build() if wanted.sensor is not None else None
    with output_folder(output) as folder:
        if checkpoint is not None:
            check_writable(checkpoint)
        click.echo(built.describe())
        with bar_of(0, "step") as bar:
            raw = built.expose(
                scene,
                coherence=light,
                sensor=sensor,
                progress=lambda done, total: reach(bar, done, total),
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
        f"Exposure: {raw.exposure}\n{folder} holds raw.tif, raw.png and lightfield.h5, "
        f"{size_of(lf)}."
    )
