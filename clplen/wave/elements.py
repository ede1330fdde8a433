"""Optical elements that act in one plane, by name."""

from clplen.wave.apertures import (
    annular_aperture,
    aperture,
    polygonal_aperture,
    rectangular_aperture,
)
from clplen.wave.lens import thin_lens
from clplen.wave.lenslets import MicrolensArray
from clplen.wave.sources import tilt

__all__ = [
    "MicrolensArray",
    "annular_aperture",
    "aperture",
    "polygonal_aperture",
    "rectangular_aperture",
    "thin_lens",
    "tilt",
]
