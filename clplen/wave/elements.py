"""Optical elements that act in one plane, and what lights them, by name."""

from clplen.wave.apertures import (
    annular_aperture,
    aperture,
    polygonal_aperture,
    rectangular_aperture,
)
from clplen.wave.gratings import axicon, grating
from clplen.wave.lens import thin_lens
from clplen.wave.lenslets import MicrolensArray
from clplen.wave.pictures import transparency
from clplen.wave.sources import gaussian_beam, plane_wave, spherical_wave, tilt
from clplen.wave.targets import siemens_star, usaf1951
from clplen.wave.zernike import phase_plate

__all__ = [
    "MicrolensArray",
    "annular_aperture",
    "aperture",
    "axicon",
    "gaussian_beam",
    "grating",
    "phase_plate",
    "plane_wave",
    "polygonal_aperture",
    "rectangular_aperture",
    "siemens_star",
    "spherical_wave",
    "thin_lens",
    "tilt",
    "transparency",
    "usaf1951",
]
