"""Light fields by wave optics, on any OpenCL device.

compute/      devices, programs, Fourier transforms
wave/         fields, propagation, optical elements, systems of them
lightfield/   decode, views, refocus, focal stacks, depth
cameras/      scenes and plenoptic cameras: where the two towers meet
io/           files in and out (imported when asked for, as is plot)
"""

from importlib import import_module
from typing import Any

from clplen.cameras.camera import PlenopticCamera
from clplen.cameras.gallery import sample_scenes
from clplen.cameras.pictures import PicturePlane
from clplen.cameras.scene import PointSources
from clplen.cameras.surfaces import Plane, Sphere, SurfaceScene
from clplen.cameras.textures import Texture
from clplen.cameras.truth import Truth
from clplen.compute.device import Device
from clplen.compute.image import Image
from clplen.errors import (
    ClplenError,
    DeviceError,
    FormatError,
    KernelBuildError,
    SamplingError,
    SamplingWarning,
    ShapeError,
)
from clplen.lightfield.depth import DepthMap, depth_map
from clplen.lightfield.estimate import AlphaEstimate, estimate_alpha
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.raw import LensletGrid, RawImage
from clplen.lightfield.refocus import FocalStack, focal_stack, refocus
from clplen.lightfield.sensor import Sensor
from clplen.wave.average import MeanIntensity
from clplen.wave.coherence import Coherence
from clplen.wave.degree import measured_degree, speckle_contrast
from clplen.wave.elements import (
    MicrolensArray,
    annular_aperture,
    aperture,
    axicon,
    gaussian_beam,
    grating,
    phase_plate,
    plane_wave,
    polygonal_aperture,
    rectangular_aperture,
    siemens_star,
    spherical_wave,
    thin_lens,
    tilt,
    transparency,
    usaf1951,
)
from clplen.wave.extended import ExtendedSource
from clplen.wave.field import Field, Grid
from clplen.wave.masks import RandomPhaseMask
from clplen.wave.parts import ConvergingLight, Element, Lens, Space, Stop
from clplen.wave.planning import CoherencePlan
from clplen.wave.propagation import Propagator, propagate, propagate_wavelengths
from clplen.wave.pupil import Pupil
from clplen.wave.spatial import IncoherentLight
from clplen.wave.spectrum import Spectrum
from clplen.wave.system import OpticalSystem, imaging_system

__version__ = "0.1.0"
__all__ = [
    "AlphaEstimate",
    "ClplenError",
    "Coherence",
    "CoherencePlan",
    "ConvergingLight",
    "DepthMap",
    "Device",
    "DeviceError",
    "Element",
    "ExtendedSource",
    "Field",
    "FocalStack",
    "FormatError",
    "Grid",
    "Image",
    "IncoherentLight",
    "KernelBuildError",
    "Lens",
    "LensletGrid",
    "LightField",
    "MeanIntensity",
    "MicrolensArray",
    "OpticalSystem",
    "PicturePlane",
    "Plane",
    "PlenopticCamera",
    "PointSources",
    "Propagator",
    "Pupil",
    "RandomPhaseMask",
    "RawImage",
    "SamplingError",
    "SamplingWarning",
    "Sensor",
    "ShapeError",
    "Space",
    "Spectrum",
    "Sphere",
    "Stop",
    "SurfaceScene",
    "Texture",
    "Truth",
    "annular_aperture",
    "aperture",
    "axicon",
    "depth_map",
    "estimate_alpha",
    "focal_stack",
    "gaussian_beam",
    "grating",
    "imaging_system",
    "measured_degree",
    "phase_plate",
    "plane_wave",
    "polygonal_aperture",
    "propagate",
    "propagate_wavelengths",
    "read_lightfield",
    "rectangular_aperture",
    "refocus",
    "sample_scenes",
    "siemens_star",
    "speckle_contrast",
    "spherical_wave",
    "thin_lens",
    "tilt",
    "transparency",
    "usaf1951",
]


def __getattr__(name: str) -> Any:
    """What needs more than NumPy, SciPy and pyopencl is imported when it is asked for."""
    if name == "read_lightfield":
        return import_module("clplen.io").read_lightfield
    if name in ("io", "plot"):
        return import_module(f"clplen.{name}")
    raise AttributeError(f"module 'clplen' has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*__all__, "io", "plot"])
