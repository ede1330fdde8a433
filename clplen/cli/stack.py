"""``clplen stack``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

from clplen.cli.shared import options
from clplen.cli.shared.console import (
    check_outputs,
    check_planes,
    check_suffix,
    note_end,
    planes_of,
    read,
    sharpest_of,
    stored,
    tile_progress,
)
from clplen.cli.shared.focused import (
    check_kept,
    fraction,
    is_meant,
    refuse,
    stack_words,
    suitable_ms,
)
from clplen.cli.shared.focused import read as open_raw

_MS = 11  # planes of a focused raw image where none are said


@click.command(cls=options.Command)
@options.source
@options.output("OUT.tif|OUT.zarr")
@options.plane_range
@options.aperture
@options.interpolation
@stack_words
@options.memory
@options.layout
@options.device
def stack(
    source: Path,
    output: Path,
    disparities: Any,
    alphas: Any,
    aperture: Any,
    interpolation: str,
    ms: Any,
    view: Any,
    focused: bool,
    image: Path | None,
    memory: int | None,
    selector: str | None,
    **layout: Any,
) -> None:
    """Refocus a light field on many planes, into one OME-TIFF (or OME-Zarr) of linear float32.

    INPUT is a light field of any kind: a folder or a zip of views, a mosaic, a raw lenslet image
    or a Lytro container with its --white, HDF5, Zarr, MATLAB or NumPy. START:STOP:N is N planes,
    both ends included; without it the planes suit what the light field knows.

    \b
    Example:
      clplen stack flower -o stack.tif --pattern "IMG_0001_{n}_{u}_{v}.png"
      clplen stack simulated/lightfield.h5 -o stack.tif --alphas 0.7:1.2:21
      clplen stack shot.xml -o stack.tif --m 0.1:0.3:9
    """
    from clplen.io import write_stack
    from clplen.lightfield.stacks import focal_stack

    check_planes(disparities, alphas)
    check_suffix(output, (".tif", ".tiff", ".zarr"))
    check_outputs(source, layout, output)
    if is_meant(source, {"m": ms, "view": view, "focused": focused, "image": image}):
        refuse(disparities=disparities, alphas=alphas, memory=memory)
        refuse(interpolation=None if interpolation == "linear" else interpolation)
        check_kept(source, image, output)
        _of_focused(source, output, ms, view, aperture, image, selector, layout)
        return
    if memory is not None:
        how = {"aperture": aperture, "interpolation": interpolation}
        _stream(source, output, (disparities, alphas), how, memory, selector, layout)
        return
    lf = read(source, selector, layout)
    planes = planes_of(lf, disparities, alphas)
    made = focal_stack(lf, aperture=aperture, interpolation=interpolation, **planes)
    best = sharpest_of(made, lf)
    if not isinstance(best, str):
        note_end(made.disparities, made.disparities[best])
    write_stack(output, made, progress=sys.stderr.isatty(), replace=True)
    if isinstance(best, str):
        count = options.planes(len(made.disparities))
        click.echo(f"{output} holds {count}; none is the sharpest: {best}.")
        return
    alpha = made.alphas[best]
    also = f", alpha = {alpha:.4f}" if np.isfinite(alpha) else ""
    click.echo(
        f"{output} holds {options.planes(len(made.disparities))}; the sharpest is number {best} "
        f"(from 0), d = {made.disparities[best]:.4f}{also}."
    )


def _of_focused(
    source: Path,
    output: Path,
    ms: Any,
    view: Any,
    aperture: Any,
    image: Path | None,
    selector: str | None,
    layout: dict[str, Any],
) -> None:
    """Blended pictures of a focused raw image; which is sharpest says nothing of depth."""
    from clplen.io import write_focused
    from clplen.lightfield.focused.focused_rendering import focused_stack

    share = fraction(aperture)
    opened = open_raw(source, selector, layout, image)
    planes = suitable_ms(opened, _MS) if ms is None else ms
    made = focused_stack(
        opened.raw,
        ms=planes,
        step=layout["step"],
        view=view or (0.0, 0.0),
        aperture=share,
        white=opened.white,
    )
    write_focused(output, made, replace=True)
    where = f"m = {planes[0]:.4g}" + (f" to {planes[-1]:.4g}" if len(planes) > 1 else "")
    click.echo(f"{output} holds {options.planes(len(planes))}, {where}.")


def _stream(
    source: Path,
    output: Path,
    ends: tuple[Any, Any],
    how: dict[str, Any],
    memory: int,
    selector: str | None,
    layout: dict[str, Any],
) -> None:
    """The same tile by tile; nothing is said of the sharpest plane."""
    from clplen.io import write_stack
    from clplen.lightfield.stacks import stack_tiles

    with stored(source, selector, layout) as (lf, device), tile_progress() as progress:
        made = stack_tiles(
            lf,
            memory=memory,
            device=device,
            progress=progress,
            **how,
            **planes_of(lf, *ends),
        )
        click.echo(made.plan, err=True)
        write_stack(output, made, replace=True)
    click.echo(f"{output} holds {options.planes(len(made.disparities))}.")
