"""``clplen demo``."""

from __future__ import annotations

import sys

import click
from tqdm import tqdm

from clplen.cli.shared import options
from clplen.cli.shared.console import advance, note_link, open_device, progress_bar


@click.command()
@click.option(
    "-o",
    "--output",
    default="clplen-demo",
    show_default=True,
    metavar="FOLDER",
    help="Folder for tables, pictures and data; made if it is not there.",
)
@click.option(
    "--lenslets",
    type=click.IntRange(min=53),
    default=101,
    show_default=True,
    metavar="N",
    help="Lenslets across the array; fewer are quicker on a slow device and lose light at the rim.",
)
@options.force_output
@options.device
def demo(output: str, lenslets: int, force: bool, selector: str | None) -> None:
    """Simulate three points before a plenoptic camera, refocus them, find their depths.

    \b
    Example:
      clplen demo -o clplen-demo
      clplen demo --lenslets 53
    """
    from clplen import demo as experiment
    from clplen.files import output_folder
    from clplen.outputs import check_outputs

    note_link(output)
    check_outputs(output, experiment.FILES, force=force)
    device = open_device(selector)
    with output_folder(output) as folder, progress_bar(experiment.STEPS, "step") as bar:
        experiment.run(
            folder,
            device,
            say=lambda text: tqdm.write(f"{text}\n", file=sys.stdout),
            step=lambda name: advance(bar, name),
            count=lenslets,
        )
    click.echo(
        f"Tables, pictures and data are in {folder}. Next: clplen stack {folder}/lightfield.h5 -o "
        f"stack.tif\nOpen {folder}/demo.html in a browser: drag to look around, click to focus."
    )
