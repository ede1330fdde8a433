"""Number of samples per pixel that point images need, and the error that remains.

Intensity behind a lenslet contains frequencies up to nu = 2 s/lam with the slope
s = NA/M + d/(2 f_mu), from the pupil and from the lenslet's aperture. A pixel dx integrates it; a
sum of b samples instead passes a frequency nu by (pi nu dx/b)/sin(pi nu dx/b) times as much. The
sampling dx/b is chosen small against 1/nu. Halving it for one image measures the error.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.lenslet_camera import sensor_grid
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.microscopy.model.psf import array_of, binned, lenslets_across

Vector = np.ndarray[Any, Any]

SAMPLES_PER_PERIOD = 1.85  # samples per 1/nu, for errors of about 1 % (`binning_error`)
MARGIN_LENSLETS = 4  # around the blur, in the comparison of two images
MAX_SAMPLES = 1500  # along an axis of the finer image, for time and memory
POINT_OFFSET = (-0.3, 0.2)  # of the test point from a lenslet centre, over the pitch; no symmetry


def suitable_binning(
    na: float, magnification: float, wavelength: float, diameter: float, focal_length: float,
    pixel: float,
) -> int:  # fmt: skip
    """Return the samples per pixel along an axis for an error of about 1 % of point images.

    All lengths are in a common unit.
    """
    slope = na / magnification + diameter / (2 * focal_length)
    parts = SAMPLES_PER_PERIOD * pixel * 2 * slope / wavelength
    return max(1, math.ceil(round(parts, 6)))


def binning_error(camera: Microscope, planes: Vector, binning: int) -> float:
    """Return the relative difference (norm over norm) to an image with twice the binning.

    It is evaluated on the farthest plane with an image of manageable size: errors grow with z.
    """
    z = np.asarray(planes, np.float64)
    counts = np.array([lenslets_across(camera, float(d)) + 2 * MARGIN_LENSLETS for d in z])
    pixels = round(camera.pixels_per_lenslet)
    small = np.flatnonzero(2 * counts * pixels <= MAX_SAMPLES)
    chosen = small[abs(z[small]).argmax()] if small.size else abs(z).argmin()
    coarse, fine = (
        _image(camera, float(z[chosen]), int(counts[chosen]), pixels * finer, binning * finer)
        for finer in (1, 2)
    )
    return float(np.linalg.norm(coarse - fine) / np.linalg.norm(fine))


def _image(camera: Microscope, z: float, count: int, pixels: int, binning: int) -> Vector:
    """Simulate the energy on sensor pixels, each the sum of ``binning`` squared finer pixels."""
    mla = array_of(camera.mla, count)
    sampled = replace(
        camera, mla=mla, grid=sensor_grid(mla, pixels), pixels_per_lenslet=float(pixels),
        pixel_pitch=mla.pitch / pixels,
    )  # fmt: skip
    y, x = (offset * mla.pitch / camera.magnification for offset in POINT_OFFSET)
    fine = sampled.sensor_fields(PointSources([(x, y, z)]), sampled.grid).intensity().to_numpy()
    return binned(fine, binning)[0]
