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
@options.output("OUT.png", "Output: the suffix _qsCOLUMNSxROWSaASPECT is added if missing.")
@click.option(
    "--display",
    type=click.Choice(_NAMES),
    default="portrait",
    show_default=True,
    help="Model of the Looking Glass; sets the defaults of --columns, --rows, --size and --aspect.",
)
@click.option("--columns", type=int, help="Number of columns of tiles. Default: by --display.")
@click.option("--rows", type=int, help="Number of rows of tiles. Default: by --display.")
@click.option("--size", type=Width(), help="Size of the quilt in pixels. Default: by --display.")
@click.option(
    "--aspect",
    type=options.FINITE,
    help="Ratio of width to height of the picture. Default: by --display.",
)
@click.option(
    "--span",
    type=click.FloatRange(0, 1, min_open=True),
    default=1.0,
    show_default=True,
    help="Fraction of the recorded baseline that the views span.",
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
    """Make a quilt for a Looking Glass display.

    A quilt is a picture with the views as tiles. Intermediate views are rendered with the depth of
    the scene.

    \b
    Example:
      clplen quilt flower -o flower.png --display portrait
      clplen quilt flower.h5 -o flower.png --disparity depth.pfm --zero-parallax -0.6 --span 0.8
      clplen quilt flower.h5 -o small.png --columns 5 --rows 4 --size 1500x1600 --aspect 0.75
    """
    from clplen.io.displays.display_window import display_window
    from clplen.io.displays.quilt import DISPLAYS, QuiltLayout, check_memory, write_quilt

    default = DISPLAYS[display]
    quilt_layout = QuiltLayout(
        default.columns if columns is None else columns,
        default.rows if rows is None else rows,
        size or default.size,
        default.aspect if aspect is None else aspect,
    )
    target = quilt_layout.name(output)
    check_output(source, target, layout, (".png",))
    check_memory(quilt_layout, 3)
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
    viewpoints = scene.across(span, quilt_layout.views)
    shifts = scene.shifts(viewpoints)
    window = display_window(scene.lf.shape[2:4], shifts, quilt_layout.aspect)
    scene.note_parallax(viewpoints, window, quilt_layout.tile[1], "pixel of a tile")
    write_quilt(target, _tiles(scene, viewpoints, shifts, window, quilt_layout), quilt_layout)
    first, last = viewpoints[0][1], viewpoints[-1][1]
    click.echo(
        f"{target}: {quilt_layout.views} views from u = {first:g} to {last:g} in "
        f"{quilt_layout.columns} x {quilt_layout.rows} tiles of {quilt_layout.tile[1]} x "
        f"{quilt_layout.tile[0]} pixels; disparity {scene.zero:.3g} lies in the plane of the "
        f"display, which shows {window.size[1]:.0f} x {window.size[0]:.0f} of the "
        f"{scene.lf.shape[3]} x {scene.lf.shape[2]} pixels of a view."
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
