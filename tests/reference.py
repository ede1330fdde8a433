"""The float64 twins in one place: optics, closed forms, light field (camera: reference_camera)."""

from __future__ import annotations

from reference_closed import (
    gaussian_paraxial,
)
from reference_elements import (
    circle_coverage,
    lens_phase,
    lenslet_centres,
    microlens_array,
    rectangle_coverage,
)
from reference_lightfield import (
    aperture_weights,
    decode_calibrated,
    decode_naive,
    magnify,
    refocus,
    render,
    sampling_matrix,
    thesis_alpha,
    thesis_curve,
    viewpoint_weights,
)
from reference_optics import (
    padded_length,
    propagate,
    transfer_function,
)

__all__ = [
    "aperture_weights",
    "circle_coverage",
    "decode_calibrated",
    "decode_naive",
    "gaussian_paraxial",
    "lens_phase",
    "lenslet_centres",
    "magnify",
    "microlens_array",
    "padded_length",
    "propagate",
    "rectangle_coverage",
    "refocus",
    "render",
    "sampling_matrix",
    "thesis_alpha",
    "thesis_curve",
    "transfer_function",
    "viewpoint_weights",
]
