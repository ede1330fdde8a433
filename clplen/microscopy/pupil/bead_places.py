"""About where the beads of a frame lie, from a volume of it: where `fit_pupil` begins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clplen.cameras.light_field_microscope import Microscope
from clplen.checks import real_array
from clplen.errors import ShapeError
from clplen.microscopy.model.psf import point_images
from clplen.microscopy.objects.points import find_points
from clplen.microscopy.reconstruction.deconvolution import deconvolve
from clplen.microscopy.reconstruction.projector import Projector

Vector = np.ndarray[Any, Any]

LEAST = 3  # planes that a bead is found among
DIMMEST = 0.05  # of the brightest one: what is dimmer is rather a part of another one's image


def find_beads(
    frame: Any,
    camera: Microscope,
    planes: Sequence[float] | Vector,
    *,
    background: Any = 0.0,
    white: Any = None,
    voxels_per_lenslet: int = 3,
    binning: int = 1,
    cut: float = 5e-3,
    iterations: int = 15,
) -> Vector:
    """Find beads in a frame, by the maxima of its volume.

    Parameters
    ----------
    frame : array_like
        Counts, shape (rows n, columns n), rectified.
    camera : Microscope
        As of `point_images`.
    planes : sequence of float
        z in metres, rising, at least three: beyond the beads on both sides.
    background : float or array_like
        As of `deconvolve`.
    white : array_like, optional
        As of `deconvolve`.
    voxels_per_lenslet, binning : int
        As of `point_images`.
    cut : float
        As of `point_images`.
    iterations : int
        Of Richardson and Lucy, with acceleration.

    Returns
    -------
    numpy.ndarray
        (x, y, z) in metres from the middle of the frame, float64, shape (n, 3), the brightest
        first.

    Raises
    ------
    ShapeError
        If there are fewer than three planes, or the frame does not fit.
    ValueError
        If no bead is found, or a number is out of range.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=20, na=0.4, wavelength=525e-9, pixels_per_lenslet=15,
    ...     mla=clplen.MicrolensArray(75e-6, 1.875e-3, count=9, fill="full"))
    >>> bead = clplen.PointSources([(2e-6, -3e-6, 20e-6)], power=1e6)
    >>> planes = np.array([0, 10, 20, 30, 40]) * 1e-6
    >>> found = clplen.microscopy.find_beads(camera.expose(bead).to_numpy(), camera, planes)
    >>> bool(np.abs(found[0] - (2e-6, -3e-6, 20e-6)).max() < 2e-6)
    True
    """
    counts = real_array(frame, "A frame", np.float64)
    images = point_images(
        camera, planes, voxels_per_lenslet=voxels_per_lenslet, binning=binning, cut=cut
    )
    if len(images.planes) < LEAST:
        raise ShapeError(
            f"Beads are found among {LEAST} planes or more, not {len(images.planes)}: give planes "
            "on both sides of them."
        )
    n = images.pixels
    if counts.ndim != 2 or any(size % n or size < 5 * n for size in counts.shape):
        raise ShapeError(
            f"A frame has whole lenslets of {n} x {n} pixels, at least 5 along an axis, not shape "
            f"{counts.shape}: rectify it."
        )
    rows, columns = (size // n for size in counts.shape)
    projector = Projector(images, (rows, columns), device=camera.device)
    volume = deconvolve(
        counts, projector, iterations=iterations, background=background, white=white,
        accelerate=True,
    ).volume  # fmt: skip
    y, x = ((np.arange(k) - (k - 1) / 2) * images.side for k in volume.shape[1:])
    found = find_points(volume, axes=(images.planes, y, x), size=(0.5, 1.0))
    bright = found.peaks > DIMMEST * found.peaks.max(initial=0.0)
    if not bright.any():
        raise ValueError(
            "No bead is found in the frame: give planes that reach beyond the beads on both sides, "
            "or fit it without beads."
        )
    return np.ascontiguousarray(found.positions[bright][:, ::-1])
