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
    open_stored,
    planes_of,
    read,
    sharpest_plane,
    tile_progress,
)
from clplen.cli.shared.focused import (
    check_raw_picture,
    fraction,
    is_focused_raw,
    refuse_options,
    stack_options,
    suitable_ms,
)
from clplen.cli.shared.focused import read as open_raw

DEFAULT_PLANES = 11  # number of planes of a focused raw image without --m


@click.command(cls=options.Command)
@options.source
@options.output("OUT.tif|OUT.zarr", "Output: OME-TIFF or OME-Zarr.")
@options.plane_range
@options.aperture
@options.interpolation
@stack_options
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
    """Refocus a light field on a series of planes.

    The stack is linear float32. INPUT is a folder or zip of views, a mosaic of views, an HDF5,
    Zarr, MATLAB or NumPy file, or a raw lenslet image or Lytro container with its --white.
    START:STOP:N means N planes, both ends included. By default the planes cover the depth range of
    the light field.

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
    if is_focused_raw(source, {"m": ms, "view": view, "focused": focused, "image": image}):
        refuse_options(disparities=disparities, alphas=alphas, memory=memory)
        refuse_options(interpolation=None if interpolation == "linear" else interpolation)
        check_raw_picture(source, image, output)
        _stack_focused(source, output, ms, view, aperture, image, selector, layout)
        return
    if memory is not None:
        settings = {"aperture": aperture, "interpolation": interpolation}
        _stream(source, output, (disparities, alphas), settings, memory, selector, layout)
        return
    lf = read(source, selector, layout)
    planes = planes_of(lf, disparities, alphas)
    images = focal_stack(lf, aperture=aperture, interpolation=interpolation, **planes)
    best = sharpest_plane(images, lf)
    if not isinstance(best, str):
        note_end(images.disparities, images.disparities[best])
    write_stack(output, images, progress=sys.stderr.isatty(), replace=True)
    if isinstance(best, str):
        count = options.planes(len(images.disparities))
        click.echo(f"{output} holds {count}; no plane is the sharpest: {best}.")
        return
    alpha = images.alphas[best]
    also = f", alpha = {alpha:.4f}" if np.isfinite(alpha) else ""
    click.echo(
        f"{output} holds {options.planes(len(images.disparities))}; the sharpest is number {best} "
        f"(from 0), d = {images.disparities[best]:.4f}{also}."
    )


def _stack_focused(
    source: Path,
    output: Path,
    ms: Any,
    view: Any,
    aperture: Any,
    image: Path | None,
    selector: str | None,
    layout: dict[str, Any],
) -> None:
    """Write blended pictures of a focused raw image, without naming a sharpest plane."""
    from clplen.io import write_focused
    from clplen.lightfield.focused.focused_rendering import focused_stack

    share = fraction(aperture)
    raw_input = open_raw(source, selector, layout, image)
    planes = suitable_ms(raw_input, DEFAULT_PLANES) if ms is None else ms
    images = focused_stack(
        raw_input.raw,
        ms=planes,
        step=layout["step"],
        view=view or (0.0, 0.0),
        aperture=share,
        white=raw_input.white,
    )
    write_focused(output, images, replace=True)
    planes_text = f"m = {planes[0]:.4g}" + (f" to {planes[-1]:.4g}" if len(planes) > 1 else "")
    click.echo(f"{output} holds {options.planes(len(planes))}, {planes_text}.")


def _stream(
    source: Path,
    output: Path,
    planes: tuple[Any, Any],
    settings: dict[str, Any],
    memory: int,
    selector: str | None,
    layout: dict[str, Any],
) -> None:
    """Write the stack tile by tile, without naming the sharpest plane."""
    from clplen.io import write_stack
    from clplen.lightfield.stacks import stack_tiles

    with open_stored(source, selector, layout) as (lf, device), tile_progress() as progress:
        images = stack_tiles(
            lf,
            memory=memory,
            device=device,
            progress=progress,
            **settings,
            **planes_of(lf, *planes),
        )
        click.echo(images.plan, err=True)
        write_stack(output, images, replace=True)
    click.echo(f"{output} holds {options.planes(len(images.disparities))}.")
