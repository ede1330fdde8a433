"""Light fields by wave optics, on any OpenCL device.

compute/      devices, programs, Fourier transforms
wave/         fields, propagation, optical elements, systems of them
lightfield/   calibrate, decode, views, refocus, focal stacks, depth
cameras/      scenes and plenoptic cameras: where the two towers meet
analysis/     what a camera resolves; cameras compared
io/           files in and out (imported when asked for, as are analysis, plot and batch)
batch/        many light fields: jobs, their items, workers
"""

from importlib import import_module
from typing import Any

from clplen import interrupts  # noqa: F401 (first: Ctrl-C while the rest is imported)
from clplen.cameras.aberrations import Aberrations, LensletScatter
from clplen.cameras.camera import PlenopticCamera
from clplen.cameras.correction import correct_aberrations
from clplen.cameras.gallery import sample_scenes
from clplen.cameras.microscope import Microscope
from clplen.cameras.objective import CoverGlass
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
from clplen.lightfield.allinfocus import all_in_focus
from clplen.lightfield.calibration import Lattice, decode_raw, estimate_lattice
from clplen.lightfield.depth import DepthMap, depth_map, sharpness_curve
from clplen.lightfield.estimate import AlphaEstimate, estimate_alpha
from clplen.lightfield.focused import focused_stack, render_focused
from clplen.lightfield.focused_depth import focused_depth
from clplen.lightfield.focused_geometry import FocusedGeometry
from clplen.lightfield.focused_maps import FocusedMaps, focused_maps
from clplen.lightfield.focused_picture import seam
from clplen.lightfield.focused_spots import point_m
from clplen.lightfield.fourier import fourier_stack
from clplen.lightfield.hyperfan import hyperfan
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.metric import metric_depth
from clplen.lightfield.phasespace import PhaseSpace, phase_space
from clplen.lightfield.raw import LensletGrid, RawImage
from clplen.lightfield.refocus import FocalStack, focal_stack, refocus
from clplen.lightfield.sensor import Sensor
from clplen.lightfield.stored import StoredLightField
from clplen.lightfield.streaming import (
    StackTiles,
    stream_all_in_focus,
    stream_depth,
    stream_stack,
)
from clplen.lightfield.surface import plane_through
from clplen.lightfield.tiles import StreamPlan
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
    "OTF",
    "PSF",
    "Aberrations",
    "AlphaEstimate",
    "ClplenError",
    "Coherence",
    "CoherencePlan",
    "Comparison",
    "ConvergingLight",
    "CoverGlass",
    "Curve",
    "DeconvolutionResult",
    "DepthMap",
    "Device",
    "DeviceError",
    "Element",
    "ExtendedSource",
    "Field",
    "FocalStack",
    "FocusedGeometry",
    "FocusedMaps",
    "FormatError",
    "Grid",
    "Image",
    "IncoherentLight",
    "KernelBuildError",
    "Lattice",
    "Lens",
    "LensletGrid",
    "LensletScatter",
    "LightField",
    "MeanIntensity",
    "MicrolensArray",
    "Microscope",
    "OpticalSystem",
    "PhaseSpace",
    "PicturePlane",
    "Plane",
    "PlenopticCamera",
    "PointImages",
    "PointSources",
    "Points",
    "Projector",
    "Propagator",
    "Pupil",
    "RandomPhaseMask",
    "RawImage",
    "Sampling",
    "SamplingError",
    "SamplingWarning",
    "Sensor",
    "ShapeError",
    "SlantedEdge",
    "Space",
    "Spectrum",
    "Sphere",
    "StackTiles",
    "Stop",
    "StoredLightField",
    "StreamPlan",
    "SurfaceScene",
    "Texture",
    "Truth",
    "TwoPoints",
    "all_in_focus",
    "annular_aperture",
    "aperture",
    "axicon",
    "compare",
    "correct_aberrations",
    "crosstalk",
    "decode_raw",
    "deconvolve",
    "depth_map",
    "estimate_alpha",
    "estimate_lattice",
    "find_points",
    "focal_stack",
    "focused_depth",
    "focused_maps",
    "focused_stack",
    "fourier_stack",
    "gaussian_beam",
    "grating",
    "hyperfan",
    "imaging_system",
    "match_points",
    "measured_degree",
    "metric_depth",
    "open_lightfield",
    "phase_plate",
    "phase_space",
    "plane_through",
    "plane_wave",
    "point_images",
    "point_m",
    "polygonal_aperture",
    "preparation",
    "propagate",
    "propagate_wavelengths",
    "read_lightfield",
    "rectangular_aperture",
    "rectify",
    "refocus",
    "render_focused",
    "sample_scenes",
    "sampling_of",
    "sampling_table",
    "seam",
    "sharpness_curve",
    "siemens_star",
    "slanted_edge",
    "speckle_contrast",
    "spherical_wave",
    "stream_all_in_focus",
    "stream_depth",
    "stream_stack",
    "strehl_of_rms",
    "thin_lens",
    "tilt",
    "transparency",
    "usaf1951",
    "wavefront_strehl",
]


_LAZY = {
    "Comparison": "analysis.cameras.comparison",
    "Curve": "analysis.point.otf",
    "DeconvolutionResult": "microscopy.deconvolution",
    "OTF": "analysis.point.otf",
    "PSF": "analysis.point.psf",
    "PointImages": "microscopy.images",
    "Points": "microscopy.points",
    "Projector": "microscopy.projector",
    "Sampling": "analysis.cameras.sampling",
    "SlantedEdge": "analysis.point.edge",
    "TwoPoints": "analysis.point.twopoint",
    "compare": "analysis.cameras.comparison",
    "crosstalk": "analysis.cameras.crosstalk",
    "deconvolve": "microscopy.deconvolution",
    "find_points": "microscopy.points",
    "match_points": "microscopy.points",
    "open_lightfield": "io",
    "point_images": "microscopy.psf",
    "preparation": "microscopy.prepare",
    "read_lightfield": "io",
    "rectify": "microscopy.rectify",
    "sampling_of": "analysis.cameras.sampling",
    "sampling_table": "analysis.cameras.sampling",
    "slanted_edge": "analysis.point.edge",
    "strehl_of_rms": "analysis.point.strehl",
    "wavefront_strehl": "analysis.point.strehl",
}  # the module of each name
_FOLDERS = ("analysis", "batch", "io", "microscopy", "plot")


def __getattr__(name: str) -> Any:
    """What needs more than NumPy, SciPy and pyopencl is imported when it is asked for."""
    if name in _LAZY:
        return getattr(import_module(f"clplen.{_LAZY[name]}"), name)
    if name in _FOLDERS:
        return import_module(f"clplen.{name}")
    raise AttributeError(f"module 'clplen' has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*__all__, *_FOLDERS])
