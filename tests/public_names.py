"""Every public name: those on top and those of the topics one step down."""

from __future__ import annotations

import importlib.util
import inspect
from typing import Any

import clplen

TOPICS = ("analysis", "batch", "cameras", "io", "lightfield", "microscopy", "plot", "wave")

# Classes that users hold, since calls return them, but do not name: by module.
RETURNED = {
    "analysis.cameras.camera_psf": ("DepthTransfer",),
    "analysis.cameras.comparison": ("Measured",),
    "analysis.cameras.depth_scan": ("DepthErrors",),
    "analysis.cameras.imaging": ("Rendered",),
    "batch.jobs.spec": ("StackTable",),
    "batch.jobs.tables": ("InputTable",),
    "batch.jobs.task": ("Report",),
    "batch.running.estimate": ("JobEstimate",),
    "cameras.exposure.exposure_jacobian": ("ExposureJacobian",),
    "cameras.exposure.point_gradients": ("ExposureGradient",),
    "cameras.optics.wave_optics": ("WaveOptics",),
    "cameras.scenes.gallery": ("SampleScene",),
    "lightfield.stacks": ("StackTiles",),
    "lightfield.focused.focused_picture": ("PictureGrid",),
    "lightfield.raw.raw_image": ("Exposure",),
    "lightfield.streaming.tile_plan": ("StreamPlan", "Tile"),
    "microscopy.fourier.bead_stack": ("BeadCalibration",),
    "microscopy.frames.prepare": ("Prepared",),
    "microscopy.frames.raw_frames": ("RawPreparation",),
    "microscopy.pupil.even_light": ("EvenLight",),
    "wave.coherence.abbe": ("AbbeImage",),
    "wave.coherence.mean_gradient": ("MeanPullback",),
    "wave.propagation.plan_report": ("PlanReport",),
    "wave.spectrum.lineshapes": ("SpectralSamples",),
    "wave.systems.system_operator": ("SystemGradient", "SystemPullback", "SystemOperator"),
}


def topic_names() -> dict[str, Any]:
    """From ``topic.name`` to the object."""
    found = {}
    for topic in TOPICS:
        module = importlib.import_module(f"clplen.{topic}")
        found |= {f"{topic}.{name}": getattr(module, name) for name in module.__all__}
    return found


def bridge_names() -> dict[str, Any]:
    """From ``torch.name`` to the object, of topics whose library is installed."""
    found = {}
    for topic in filter(importlib.util.find_spec, clplen.BRIDGES):
        module = importlib.import_module(f"clplen.{topic}")
        found |= {f"{topic}.{name}": getattr(module, name) for name in module.__all__}
    return found


def public_objects() -> dict[str, Any]:
    """Every public object once, by its shortest name: ``LightField``, ``cameras.Aberrations``."""
    found = {name: getattr(clplen, name) for name in clplen.__all__}
    known = {id(value) for value in found.values()}
    return found | {name: value for name, value in topic_names().items() if id(value) not in known}


def public_classes() -> dict[str, type]:
    """The public classes, and those that calls return."""
    found = public_objects()
    for module, names in RETURNED.items():
        inside = importlib.import_module(f"clplen.{module}")
        found |= {f"{module}.{name}": getattr(inside, name) for name in names}
    return {name: value for name, value in found.items() if inspect.isclass(value)}


def public_functions() -> dict[str, Any]:
    """The public functions among them."""
    found = public_objects().items()
    return {name: value for name, value in found if inspect.isroutine(value)}
