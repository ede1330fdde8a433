"""Checks of frames and their lattices before point images are computed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clplen.cli.shared.console import note

if TYPE_CHECKING:
    from clplen.config.microscope import MicroscopeFile


def check_frames(file: MicroscopeFile, frame: Path | None, white: Path | None, force: bool) -> None:
    """Raise an error if a frame does not fit the point images of a microscope file."""
    from clplen.microscopy.deconvolution_files import read_picture
    from clplen.microscopy.series_files import pages_of

    n = round((file.camera.pixels_per_lenslet or 0) / file.binning)
    picture = None
    if frame is not None:
        page = pages_of(frame)[0]
        picture = read_picture(page.path, page.number)
    if white is None:
        if picture is not None and any(size % n for size in picture.shape):
            ny, nx = picture.shape
            fitting = [k for k in range(max(3, n - 3), n + 4) if ny % k == 0 and nx % k == 0]
            more = f" --pixels {fitting[0]} divides it." if fitting else ""
            raise click.ClickException(
                f"{frame} must have a whole number of lenslets of {n} x {n} pixels "
                f"({file.pixels:.6g} by the parameters), got {ny} x {nx} pixels.{more} Frames that "
                "are not rectified need a white frame (--white), or --lattice in 'clplen "
                "microscope deconvolve'."
            )
        return
    _check_white(file, n, white, None if picture is None else picture.shape, force)


def _check_white(
    file: MicroscopeFile, n: int, white: Path, shape: tuple[int, ...] | None, force: bool
) -> None:
    """Raise an error if a white frame is from another camera; note a deviating pitch."""
    from clplen.lightfield.calibration.lattice_trust import lattice_of_white
    from clplen.microscopy.deconvolution_files import read_picture
    from clplen.microscopy.frames.nominal_lattice import pitch_sentence
    from clplen.microscopy.frames.prepare import MIN_PIXELS_PER_PITCH

    level = read_picture(white)
    if shape is not None and level.shape != shape:
        raise click.ClickException(
            f"The white frame {white} has shape {level.shape}, the frame {shape}: give a white "
            "frame of equal camera and crop."
        )
    lattice = lattice_of_white(level, white, kind="square", pitch=n, force=force)
    if n < MIN_PIXELS_PER_PITCH * max(lattice.pitch):
        raise click.ClickException(
            f"{white} has lenslets {max(lattice.pitch):.5g} pixels apart, but the point images "
            f"have {n} pixels per lenslet: give --pixels {math.ceil(max(lattice.pitch))}."
        )
    sentence = pitch_sentence(lattice, file.pixels)
    if sentence is not None:
        note(f"{white}: {sentence}")
