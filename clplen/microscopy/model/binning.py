"""Into how many parts a pixel must be divided, and what point images still lack then.

Intensity behind a lenslet has frequencies up to nu = 2 s/lam with the slope s = NA/M + d/(2 f_mu):
the pupil's rays and those of the lenslet's own aperture. A pixel dx integrates it; the sum of b
points in its place passes a frequency nu by (pi nu dx/b)/sin(pi nu dx/b) times as much. The parts
dx/b are taken small against 1/nu, and the error is measured: by one image with parts half as large.
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

FINE = 1.85  # samples of 1/nu, with which images are right to some 1 %
AROUND = 4  # lenslets about the blur, on which two images are compared
LARGEST = 1500  # samples along an axis of the finer image
PHASE = (-0.3, 0.2)  # of a lenslet, the place of the point


def suitable_binning(
    na: float, magnification: float, wavelength: float, diameter: float, focal_length: float,
    pixel: float,
) -> int:  # fmt: skip
    """Return parts of a pixel along an axis, with which point images are right to some 1 %.

    Wavelength, diameter and focal length of lenslets, and the pixel are in one unit.
    """
    slope = na / magnification + diameter / (2 * focal_length)
    parts = FINE * pixel * 2 * slope / wavelength
    return max(1, math.ceil(round(parts, 6)))


def binning_error(camera: Microscope, planes: Vector, binning: int) -> float:
    """Compare an image with that of parts half as large: norm of the difference over norm.

    The image is that of the farthest plane whose image is small enough, because errors grow with z.
    """
    z = np.asarray(planes, np.float64)
    counts = np.array([lenslets_across(camera, float(one)) + 2 * AROUND for one in z])
    pixels = round(camera.pixels_per_lenslet)
    small = np.flatnonzero(2 * counts * pixels <= LARGEST)
    chosen = small[abs(z[small]).argmax()] if small.size else abs(z).argmin()
    one, other = (
        _image(camera, float(z[chosen]), int(counts[chosen]), pixels * finer, binning * finer)
        for finer in (1, 2)
    )
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def _image(camera: Microscope, z: float, count: int, pixels: int, binning: int) -> Vector:
    """Energy on the sensor's pixels, of lenslets with so many finer ones."""
    mla = array_of(camera.mla, count)
    some = replace(
        camera, mla=mla, grid=sensor_grid(mla, pixels), pixels_per_lenslet=float(pixels),
        pixel_pitch=mla.pitch / pixels,
    )  # fmt: skip
    y, x = (part * mla.pitch / camera.magnification for part in PHASE)
    fine = some.sensor_fields(PointSources([(x, y, z)]), some.grid).intensity().to_numpy()
    return binned(fine, binning)[0]
