"""Errors of `estimate_alpha` beside the standard deviations that it states.

Points at random places and depths before nine standard cameras with square and hexagonal arrays,
upright and turned, two of them with fast lenses and pixels that integrate; a quarter of the raw
images without noise, the others of 10^3 to 10^7 photons and 0 to 2 electrons of read noise.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clplen import (
    Device,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    Sensor,
    estimate_alpha,
    read_camera,
)
from clplen.cameras import Plenoptic1

METHODS = ("slope", "compensated", "energy")
COUNT = 45  # lenslets across
WINDOW = 11  # on either side of a point, which stay on the array
MOST = 0.26  # of abs(1 - alpha),
C_MAX = 0.3  # of the disparity that is searched,
REACH = 0.9  # of which points lie within, and
BLUR = 7.0  # lenslets
QUIET = 0.25  # of the raw images have no noise

# lattice, fill, widest turn, pitch, f_mu, pixels, f, object distance, wavelength
CAMERAS = (
    ("square", "full", 0.0, 150e-6, 10e-3, 30, 0.120, 0.24, 532e-9),
    ("square", "full", 0.3, 150e-6, 10e-3, 30, 0.120, 0.24, 532e-9),
    ("hexagonal", "full", 0.0, 150e-6, 10e-3, 30, 0.120, 0.24, 532e-9),
    ("hexagonal", "full", 0.5, 150e-6, 10e-3, 30, 0.120, 0.24, 532e-9),
    ("square", "full", 0.0, 100e-6, 6e-3, 20, 0.120, 0.24, 532e-9),
    ("hexagonal", "circular", 0.0, 200e-6, 12e-3, 32, 0.100, 0.20, 633e-9),
    ("square", "full", 0.0, 125e-6, 5e-3, 25, 0.080, 0.30, 532e-9),
)


FILES = ("lytro_illum", "canon_50mm")  # in examples/cameras
FILES_C_MAX = 0.5  # of theirs, for the same blurs behind fewer pixels


@dataclass(frozen=True)
class Estimate:
    """One point by one method; errors and deviations of alpha over p/D."""

    method: str
    lattice: str
    error: float
    deviation: float


def estimates(device: Device, count: int, seed: int) -> Iterator[Estimate]:
    """Random points, each by all methods; those without a stated deviation are left out."""
    random = np.random.default_rng(seed)
    for number in range(count):
        camera, c_max = _camera(number % (len(CAMERAS) + len(FILES)), device, random)
        lf, alpha = _recorded(camera, c_max, random)
        tolerance = camera.mla.pitch / camera.aperture_diameter
        for method in METHODS:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = estimate_alpha(lf, method=method, c_max=c_max)
            if math.isfinite(found.uncertainty):
                error = found.alpha - found.bias - alpha
                stated = found.uncertainty / tolerance
                yield Estimate(method, camera.mla.lattice, error / tolerance, stated)


def _camera(
    number: int, device: Device, random: np.random.Generator
) -> tuple[Plenoptic1, float]:
    """One of the cameras, and how far is searched."""
    if number >= len(CAMERAS):
        file = Path(__file__).parents[1] / f"examples/cameras/{FILES[number - len(CAMERAS)]}.toml"
        camera = read_camera(file, device=device, count=COUNT)
        assert isinstance(camera, Plenoptic1)
        return camera, FILES_C_MAX
    lattice, fill, turn, pitch, f_mu, pixels, f, z, wavelength = CAMERAS[number]
    array = MicrolensArray(
        pitch,
        f_mu,
        count=COUNT,
        lattice=lattice,
        fill=fill,
        rotation=random.uniform(-turn, turn),
    )
    camera = PlenopticCamera.type1(
        focal_length=f,
        mla=array,
        wavelength=wavelength,
        pixels_per_lenslet=pixels,
        device=device,
        object_distance=z,
    )
    return camera, C_MAX


def _recorded(
    camera: Plenoptic1, c_max: float, random: np.random.Generator
) -> tuple[LightField, float]:
    """A light field of one point, and its alpha."""
    pitch, F = camera.mla.pitch, camera.image_distance
    most = min(
        MOST,
        REACH * c_max * camera.mla.focal_length * camera.pixels_per_lenslet / F,
        BLUR * pitch / camera.aperture_diameter,
    )
    alpha = 1 + random.uniform(-most, most)
    dz = float(camera.dz(alpha))
    side = 0.85 * (COUNT / 2 - WINDOW) * pitch * (camera.object_distance + dz) / F
    raw = camera.expose(PointSources([(*random.uniform(-side, side, 2), dz)], diameter=10e-6))
    photons, read = 10 ** random.uniform(3, 7), random.choice([0.0, 0.5, 2.0])
    if random.random() > QUIET:
        sensor = Sensor(
            exposure=photons, shot_noise=True, read_noise=read, seed=int(random.integers(2**30))
        )
        raw = sensor.record(raw)
    return LightField.from_raw(raw), alpha


def cover(found: list[Estimate]) -> tuple[float, float]:
    """Shares within one and two stated deviations."""
    ratio = np.array([abs(one.error) / one.deviation for one in found])
    return float((ratio <= 1).mean()), float((ratio <= 2).mean())
