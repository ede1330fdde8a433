"""``clplen depth``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clplen.cli import options
from clplen.cli.common import check_outputs, check_planes, check_suffix, planes_of, read


@click.command()
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

    check_planes(disparities, alphas)
    check_suffix(output, (".pfm", ".tif", ".tiff"))
    picture = output.with_suffix(".png")
    check_outputs(source, layout, output, picture)
    lf = read(source, selector, layout)
    found = depth_map(lf, **planes_of(lf, disparities, alphas))
    write_depth(output, found)
    plot.save(plot.depth(found, title=f"disparity of {source.name}"), picture)
    click.echo(f"{output} holds the disparities, {picture} shows them with their confidence.")
