"""``clplen demo``."""

from __future__ import annotations

import sys
from types import ModuleType

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
    help="Folder for the page, pictures, tables and data; created if it does not exist.",
)
@click.option("--points", is_flag=True, help="Simulate three points with exact alphas instead.")
@click.option(
    "--lenslets",
    type=click.IntRange(min=53),
    default=101,
    show_default=True,
    metavar="N",
    help="Number of lenslets across the array.",
)
@options.force_output
@options.device
def demo(output: str, points: bool, lenslets: int, force: bool, selector: str | None) -> None:
    """Simulate a plenoptic camera; refocus its picture and estimate depth.

    The scene holds a heart, a star and a moon of lights at three distances. With --points it holds
    three points of light, and the tables compare their estimated with their exact alphas.

    \b
    Example:
      clplen demo -o clplen-demo
      clplen demo --points -o three-points
    """
    from clplen.demo import lights, three_points
    from clplen.files import output_folder
    from clplen.outputs import check_outputs

    experiment: ModuleType = three_points if points else lights
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
    pictures = ", ".join(name for name in experiment.FILES if name.endswith(".png"))
    click.echo(
        f"Open {folder}/demo.html in a browser: drag to look around, click to focus.\n"
        f"Pictures: {pictures} in {folder}.\n"
        f"Next: clplen stack {folder}/lightfield.h5 -o stack.tif"
    )
