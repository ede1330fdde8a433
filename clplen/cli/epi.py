"""``clplen epi``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clplen.cli.shared import options
from clplen.cli.shared.console import read
from clplen.cli.shared.pictures import PICTURES, check_output, write


@click.command(cls=options.Command)
@options.source
@options.output(
    "OUT.tif|OUT.png", "Output: TIFF of the samples (linear float32), or PNG figure with axes."
)
@click.option("--y", type=int, help="Row of pixels, with --v: a slice with the axes (u, x).")
@click.option("--v", type=int, help="Row of views, with --y.")
@click.option("--x", type=int, help="Column of pixels, with --u: a slice with the axes (v, y).")
@click.option("--u", type=int, help="Column of views, with --x.")
@options.layout
@options.device
def epi(
    source: Path,
    output: Path,
    y: int | None,
    v: int | None,
    x: int | None,
    u: int | None,
    selector: str | None,
    **layout: Any,
) -> None:
    """Extract an epipolar-plane image.

    It shows a row of pixels over a row of views, or a column of pixels over a column. A point of
    the scene appears as a straight line, displaced by -d pixels from view to view for the disparity
    d. If the light field stores its camera, the axes of the figure are in millimetres and show the
    angle of the rays.

    \b
    Example:
      clplen epi flower -o epi.png --y 128 --v 4
      clplen epi flower -o epi.tif --x 90 --u 5
    """
    axes_set = {name for name, n in (("y", y), ("v", v), ("x", x), ("u", u)) if n is not None}
    if axes_set not in ({"y", "v"}, {"x", "u"}):
        raise click.UsageError("Give --y and --v, or --x and --u.")
    check_output(source, output, layout, PICTURES)
    lf = read(source, selector, layout)
    axes = "(u, x)" if "y" in axes_set else "(v, y)"
    if output.suffix.lower() == ".png":
        from clplen import plot
        from clplen.lightfield.model.phase_space import phase_space

        plot.save(plot.epi(phase_space(lf, y=y, v=v, x=x, u=u)), output)
        description = "a figure for viewing"
    else:
        linear = layout["srgb"] or lf.linear
        values = lf.epi(y=y, v=v, x=x, u=u).to_numpy()
        description = write(output, values, lf, srgb=linear, upsample=None)
    click.echo(f"{output}: the slice {axes}, {description}.")
