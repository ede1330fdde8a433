"""``clplen stack``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

from clplen.cli import options
from clplen.cli.common import (
    check_outputs,
    check_planes,
    check_suffix,
    note_end,
    planes_of,
    read,
)


@click.command()
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

    INPUT is a light field of any kind: a folder or a zip of views, a mosaic, a raw lenslet image
    or a Lytro container with its --white, HDF5, Zarr, MATLAB or NumPy. START:STOP:N is N planes,
    both ends included; without it the planes suit what the light field knows.

    \b
    Example:
      clplen stack flower -o stack.tif --pattern "IMG_0001_{n}_{u}_{v}.png"
      clplen stack simulated/lightfield.h5 -o stack.tif --alphas 0.7:1.2:21
    """
    from clplen.io import write_stack
    from clplen.lightfield.depth import sharpness_curve
    from clplen.lightfield.refocus import focal_stack

    check_planes(disparities, alphas)
    check_suffix(output, (".tif", ".tiff"))
    check_outputs(source, layout, output)
    lf = read(source, selector, layout)
    made = focal_stack(lf, aperture=aperture, **planes_of(lf, disparities, alphas))
    best = int(sharpness_curve(made).argmax())
    note_end(made.disparities, made.disparities[best])
    write_stack(output, made, progress=sys.stderr.isatty())
    alpha = made.alphas[best]
    also = f", alpha = {alpha:.4f}" if np.isfinite(alpha) else ""
    click.echo(
        f"{output} holds {options.planes(len(made.disparities))}; the sharpest is number {best} "
        f"(from 0), d = {made.disparities[best]:.4f}{also}."
    )
