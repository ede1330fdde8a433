"""The float64 twins in one place: optics, closed forms, light field (camera: reference_camera)."""

from __future__ import annotations

from reference_closed import (
    airy,
    circle_on_axis,
    fresnel_slit,
    gaussian_exact,
    gaussian_paraxial,
    lens_focus,
    point_image,
    rayleigh_sommerfeld,
    slit_exact,
    talbot_distance,
    tilted_plane_wave,
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
    axis,
    blas_limit,
    padded_length,
    propagate,
    radius_squared,
    transfer_function,
)

__all__ = [
    "airy",
    "aperture_weights",
    "axis",
    "blas_limit",
    "circle_coverage",
    "circle_on_axis",
    "decode_calibrated",
    "decode_naive",
    "fresnel_slit",
    "gaussian_exact",
    "gaussian_paraxial",
    "lens_focus",
    "lens_phase",
    "lenslet_centres",
    "magnify",
    "microlens_array",
    "padded_length",
    "point_image",
    "propagate",
    "radius_squared",
    "rayleigh_sommerfeld",
    "rectangle_coverage",
    "refocus",
    "render",
    "sampling_matrix",
    "slit_exact",
    "talbot_distance",
    "thesis_alpha",
    "thesis_curve",
    "tilted_plane_wave",
    "transfer_function",
    "viewpoint_weights",
]
