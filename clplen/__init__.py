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
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.camera_aberrations import (
    Aberrations,
    LensletScatter,
    correct_aberrations,
)
from clplen.cameras.optics.objective import CoverGlass
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.scenes.gallery import sample_scenes
from clplen.cameras.scenes.ground_truth import Truth
from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources
from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.cameras.scenes.surfaces import Plane, Sphere
from clplen.cameras.scenes.textures import Texture
from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.errors import (
    ClplenError,
    DeviceError,
    FormatError,
    KernelBuildError,
    SamplingError,
    SamplingWarning,
    ShapeError,
)
from clplen.lightfield.calibration.lattice_fit import estimate_lattice
from clplen.lightfield.calibration.raw_decoding import decode_raw
from clplen.lightfield.depth.alpha_estimate import AlphaEstimate, estimate_alpha
from clplen.lightfield.depth.depth_maps import DepthMap, metric_depth, sharpness_curve
from clplen.lightfield.focus_and_depth import all_in_focus, depth_map, focal_stack
from clplen.lightfield.focused.focused_depth import FocusedMaps, focused_depth, focused_maps
from clplen.lightfield.focused.focused_geometry import FocusedGeometry
from clplen.lightfield.focused.focused_picture import seam
from clplen.lightfield.focused.focused_rendering import focused_stack, render_focused
from clplen.lightfield.focused.focused_spots import point_m
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.phase_space import PhaseSpace, phase_space
from clplen.lightfield.model.rendering import plane_through
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.raw.sensor import Sensor
from clplen.lightfield.refocus.fourier_slice import fourier_stack
from clplen.lightfield.refocus.hyperfan import hyperfan
from clplen.lightfield.refocus.refocusing import FocalStack, refocus
from clplen.lightfield.streaming.streamed_results import (
    StackTiles,
    stream_all_in_focus,
    stream_depth,
    stream_stack,
)
from clplen.lightfield.streaming.tile_plan import StreamPlan
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.coherence.coherence_plan import CoherencePlan
from clplen.wave.coherence.degree import measured_degree, speckle_contrast
from clplen.wave.coherence.extended_source import ExtendedSource
from clplen.wave.coherence.phase_masks import RandomPhaseMask
from clplen.wave.coherence.spatial_models import IncoherentLight
from clplen.wave.elements.beams import gaussian_beam, plane_wave, spherical_wave, tilt
from clplen.wave.elements.gratings import axicon, grating
from clplen.wave.elements.hard_apertures import (
    annular_aperture,
    aperture,
    polygonal_aperture,
    rectangular_aperture,
)
from clplen.wave.elements.lens import thin_lens
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.elements.transparency import siemens_star, transparency, usaf1951
from clplen.wave.elements.zernike import phase_plate
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import MeanIntensity
from clplen.wave.propagation.free_space import propagate, propagate_wavelengths
from clplen.wave.propagation.propagator import Propagator
from clplen.wave.spectrum.spectrum import Spectrum
from clplen.wave.systems.components import ConvergingLight, Element, Lens, Space, Stop
from clplen.wave.systems.optical_system import OpticalSystem, imaging_system
from clplen.wave.systems.pupil_filter import Pupil

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
