"""Light fields by wave optics, on any OpenCL device.

compute/      devices, programs, Fourier transforms
wave/         fields, propagation, lenses, microlens arrays
lightfield/   decode, views, refocus, focal stacks, depth
cameras/      scenes and plenoptic cameras: where the two towers meet
io/           files in and out (``clplen.io``)
"""

from clplen.cameras.camera import PlenopticCamera
from clplen.cameras.scene import PointSources
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
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.raw import LensletGrid, RawImage
from clplen.lightfield.sensor import Sensor
from clplen.wave.elements import aperture, thin_lens
from clplen.wave.field import Field, Grid
from clplen.wave.lenslets import MicrolensArray
from clplen.wave.propagation import Propagator, propagate

__version__ = "0.1.0"
__all__ = [
    "ClplenError", "Device", "DeviceError", "Field", "FormatError", "Grid", "Image",
    "KernelBuildError", "LensletGrid", "LightField", "MicrolensArray", "PlenopticCamera",
    "PointSources", "Propagator", "RawImage", "SamplingError", "SamplingWarning", "Sensor",
    "ShapeError", "aperture", "propagate", "thin_lens",
]
