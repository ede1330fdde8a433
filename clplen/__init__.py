"""Light fields by wave optics, on any OpenCL device: the names of a first week.

Everything else is public one step down, by topic:

wave          fields, propagation, optical elements, systems of them, coherence
lightfield    calibrate, decode, views, refocus, focal stacks, depth
cameras       scenes and plenoptic cameras: where the two towers meet
microscopy    point images, projector, deconvolution of the light-field microscope
analysis      what a camera resolves; cameras compared
io            files in and out
plot          figures
batch         many light fields: jobs, their items, workers
torch, jax    operators with gradients in programs of PyTorch and JAX, where these are installed

Names and topics are imported when they are asked for; the stub beside this file lists them.
"""

from importlib import import_module
from typing import Any

from lazy_loader import attach_stub

from clplen import interrupts  # noqa: F401 (first: Ctrl-C while the rest is imported)
from clplen.deprecation import warn_caller

__version__ = "0.1.0"
TOPICS = ("analysis", "batch", "cameras", "io", "lightfield", "microscopy", "plot", "wave")
BRIDGES = ("jax", "torch")  # topics that need another library
_find, __dir__, _names = attach_stub(__name__, __file__)
__all__ = [name for name in _names if name not in TOPICS + BRIDGES]
# Names that stood here once, and their topics.
_MOVED = {
    "Aberrations": "cameras",
    "AlphaEstimate": "lightfield",
    "CoherencePlan": "wave",
    "Comparison": "analysis",
    "ConvergingLight": "wave",
    "CoverGlass": "cameras",
    "Curve": "analysis",
    "DeconvolutionResult": "microscopy",
    "Element": "wave",
    "ExtendedSource": "wave",
    "FocusedGeometry": "lightfield",
    "FocusedMaps": "lightfield",
    "IncoherentLight": "wave",
    "Lattice": "lightfield",
    "Lens": "wave",
    "LensletGrid": "lightfield",
    "LensletScatter": "cameras",
    "MeanIntensity": "wave",
    "Microscope": "cameras",
    "OTF": "analysis",
    "PSF": "analysis",
    "PhaseSpace": "lightfield",
    "Plane": "cameras",
    "PointImages": "microscopy",
    "Points": "microscopy",
    "Pupil": "wave",
    "RandomPhaseMask": "wave",
    "Sampling": "analysis",
    "SlantedEdge": "analysis",
    "Space": "wave",
    "Sphere": "cameras",
    "StackTiles": "lightfield",
    "Stop": "wave",
    "StreamPlan": "lightfield",
    "Texture": "cameras",
    "Truth": "cameras",
    "TwoPoints": "analysis",
    "annular_aperture": "wave",
    "axicon": "wave",
    "compare": "analysis",
    "correct_aberrations": "cameras",
    "crosstalk": "analysis",
    "find_points": "microscopy",
    "focused_depth": "lightfield",
    "focused_maps": "lightfield",
    "focused_stack": "lightfield",
    "fourier_stack": "lightfield",
    "gaussian_beam": "wave",
    "grating": "wave",
    "hyperfan": "lightfield",
    "imaging_system": "wave",
    "match_points": "microscopy",
    "measured_degree": "wave",
    "metric_depth": "lightfield",
    "phase_space": "lightfield",
    "plane_through": "lightfield",
    "plane_wave": "wave",
    "point_m": "lightfield",
    "polygonal_aperture": "wave",
    "preparation": "microscopy",
    "propagate_wavelengths": "wave",
    "rectangular_aperture": "wave",
    "rectify": "microscopy",
    "sample_scenes": "cameras",
    "sampling_of": "analysis",
    "sampling_table": "analysis",
    "seam": "lightfield",
    "sharpness_curve": "lightfield",
    "siemens_star": "wave",
    "slanted_edge": "analysis",
    "speckle_contrast": "wave",
    "spherical_wave": "wave",
    "stream_all_in_focus": "lightfield",
    "stream_depth": "lightfield",
    "stream_stack": "lightfield",
    "strehl_of_rms": "analysis",
    "tilt": "wave",
    "transparency": "wave",
    "usaf1951": "wave",
    "wavefront_strehl": "analysis",
}


def __getattr__(name: str) -> Any:
    """Import a name or topic when it is asked for; lead a former name to its topic."""
    if name in _MOVED:
        message = f"clplen.{name} is deprecated: it is clplen.{_MOVED[name]}.{name} now."
        warn_caller(message, DeprecationWarning)
        return getattr(import_module(f"clplen.{_MOVED[name]}"), name)
    return _find(name)
