"""``clplen stereo``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clplen.cli.displays.scene import depth_options, open_scene
from clplen.cli.shared import options
from clplen.cli.shared.pictures import Tone, check_output, tone


@click.command(cls=options.Command)
@options.source
@options.output("OUT.png", "Output picture.")
@click.option(
    "--kind",
    type=click.Choice(["anaglyph", "side-by-side", "cross-eyed"]),
    default="anaglyph",
    show_default=True,
    help="Kind of picture: for red-cyan glasses (anaglyph), for parallel viewing (side-by-side) or "
    "for cross-eyed viewing.",
)
@click.option(
    "--colours",
    type=click.Choice(["dubois", "colour", "grey"]),
    default="dubois",
    show_default=True,
    help="Colours of an anaglyph: least-squares method of Dubois, full colour or grey.",
)
@click.option(
    "--baseline",
    metavar="STEPS",
    type=click.FloatRange(0, min_open=True),
    help="Distance of the eyes in view steps. Default: the recorded baseline.",
)
@depth_options
@tone
@options.plane_range
@options.layout
@options.device
def stereo(
    source: Path,
    output: Path,
    kind: str,
    colours: str,
    baseline: float | None,
    depth_file: Path | None,
    zero: float | None,
    limits: Any,
    curve: Any,
    disparities: Any,
    alphas: Any,
    selector: str | None,
    **layout: Any,
) -> None:
    """Make a stereo picture: an anaglyph, or two views side by side.

    \b
    Example:
      clplen stereo flower.h5 -o flower.png --zero-parallax -0.65
      clplen stereo flower.h5 -o pair.png --kind side-by-side --baseline 4
    """
    from clplen.io import write_picture
    from clplen.io.displays.display_window import display_window
    from clplen.io.displays.stereo import combine_pair

    check_output(source, output, layout, (".png",))
    depth = {"depth_file": depth_file, "zero": zero, "disparities": disparities, "alphas": alphas}
    scene = open_scene(source, selector, layout, Tone(limits, curve), **depth)
    recorded = scene.lf.shape[1] - 1
    steps = float(recorded) if baseline is None else baseline
    if steps > recorded:
        raise click.UsageError(
            f"--baseline must be at most {recorded} view steps, the recorded baseline, got "
            f"{steps:g}."
        )
    eyes = scene.across(steps / recorded, 2)
    shifts = scene.shifts(eyes)
    window = display_window(scene.lf.shape[2:4], shifts)
    size = (max(round(window.size[0]), 1), max(round(window.size[1]), 1))
    pictures = zip(scene.pictures(eyes), shifts, strict=True)
    left, right = (window.render(picture, shift, size) for picture, shift in pictures)
    write_picture(output, combine_pair(left, right, arrangement=kind, colours=colours))
    click.echo(
        f"{output}: {kind} of the views at u = {eyes[0][1]:g} and {eyes[1][1]:g}; disparity "
        f"{scene.zero:.3g} lies in the plane of the picture."
    )
