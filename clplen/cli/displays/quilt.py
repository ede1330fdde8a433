"""``clplen quilt``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from clplen.cli.displays.scene import Scene, Width, depth_options, open_scene
from clplen.cli.shared import options
from clplen.cli.shared.console import advance, progress_bar
from clplen.cli.shared.pictures import Tone, check_output, tone

if TYPE_CHECKING:
    from clplen.io.displays.display_window import DisplayWindow
    from clplen.io.displays.quilt import QuiltLayout

_NAMES = ("go", "portrait", "16-landscape", "16-portrait", "32-landscape", "32-portrait", "65")


@click.command(cls=options.Command)
@options.source
@options.output("OUT.png", "Quilt; _qsCOLUMNSxROWSaASPECT is added to the name where it lacks.")
@click.option(
    "--display",
    type=click.Choice(_NAMES),
    default="portrait",
    show_default=True,
    help="Model of the Looking Glass, which sets tiles, size and aspect.",
)
@click.option("--columns", type=int, help="Number of columns of tiles, in place of the display's.")
@click.option("--rows", type=int, help="Number of rows of tiles.")
@click.option("--size", type=Width(), help="Size of the quilt in pixels.")
@click.option("--aspect", type=options.FINITE, help="Ratio of width to height of the picture.")
@click.option(
    "--span",
    type=click.FloatRange(0, 1, min_open=True),
    default=1.0,
    show_default=True,
    help="Part of the recorded baseline between the first view and the last.",
)
@depth_options
@tone
@options.plane_range
@options.layout
@options.device
def quilt(
    source: Path,
    output: Path,
    display: str,
    columns: int | None,
    rows: int | None,
    size: tuple[int, int] | None,
    aspect: float | None,
    span: float,
    depth_file: Path | None,
    zero: float | None,
    limits: Any,
    curve: Any,
    disparities: Any,
    alphas: Any,
    selector: str | None,
    **layout: Any,
) -> None:
    """Make a quilt for a Looking Glass display: views from left to right as tiles of one picture.

    Views between the recorded ones are rendered along the depth of the scene.

    \b
    Example:
      clplen quilt flower -o flower.png --display portrait
      clplen quilt flower.h5 -o flower.png --disparity depth.pfm --zero-parallax -0.6 --span 0.8
      clplen quilt flower.h5 -o small.png --columns 5 --rows 4 --size 1500x1600 --aspect 0.75
    """
    from clplen.io.displays.display_window import display_window
    from clplen.io.displays.quilt import DISPLAYS, QuiltLayout, check_memory, write_quilt

    known = DISPLAYS[display]
    chosen = QuiltLayout(
        known.columns if columns is None else columns,
        known.rows if rows is None else rows,
        size or known.size,
        known.aspect if aspect is None else aspect,
    )
    target = chosen.name(output)
    check_output(source, target, layout, (".png",))
    check_memory(chosen, 3)
    scene = open_scene(
        source,
        selector,
        layout,
        Tone(limits, curve),
        depth_file=depth_file,
        zero=zero,
        disparities=disparities,
        alphas=alphas,
    )
    viewpoints = scene.across(span, chosen.views)
    shifts = scene.shifts(viewpoints)
    window = display_window(scene.lf.shape[2:4], shifts, chosen.aspect)
    scene.note_parallax(viewpoints, window, chosen.tile[1], "pixel of a tile")
    write_quilt(target, _tiles(scene, viewpoints, shifts, window, chosen), chosen)
    first, last = viewpoints[0][1], viewpoints[-1][1]
    click.echo(
        f"{target}: {chosen.views} views from u = {first:g} to {last:g} in {chosen.columns} x "
        f"{chosen.rows} tiles of {chosen.tile[1]} x {chosen.tile[0]} pixels; disparity "
        f"{scene.zero:.3g} lies in the display's plane, {window.size[1]:.0f} x "
        f"{window.size[0]:.0f} of {scene.lf.shape[3]} x {scene.lf.shape[2]} pixels of a view are "
        "shown."
    )


def _tiles(
    scene: Scene,
    viewpoints: list[tuple[float, float]],
    shifts: np.ndarray[Any, Any],
    window: DisplayWindow,
    layout: QuiltLayout,
) -> Iterator[np.ndarray[Any, Any]]:
    with progress_bar(layout.views, "view") as bar:
        for picture, shift in zip(scene.pictures(viewpoints), shifts, strict=True):
            advance(bar, "views")
            yield window.render(picture, shift, layout.tile)
