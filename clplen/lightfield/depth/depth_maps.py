"""Depth maps of light fields and of focal stacks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import real_array, real_map, require
from clplen.compute.arrays import HostArray
from clplen.errors import SamplingWarning, ShapeError, warn_caller
from clplen.lightfield.depth import (
    combined_cue,
    correspondence_cue,
    energy_cue,
    structure_tensor_cue,
)
from clplen.lightfield.depth.best_focus import default_disparities, high_na_message
from clplen.lightfield.depth.cue import Cue, Map
from clplen.lightfield.depth.energy_cue import LocalEnergy
from clplen.lightfield.model.alpha_law import depth_at, require_overlap
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.raw.raw_image import is_telecentric
from clplen.lightfield.refocusing.focal_stacks import FocalStack, plane_values
from clplen.results import Plottable, Savable
from clplen.settings.declaration import setting_of
from clplen.settings.light_fields import CUES as CUES
from clplen.settings.light_fields import DepthSettings, one_of_planes

_CUES = {
    "energy": energy_cue.CUE,
    "correspondence": correspondence_cue.CUE,
    "structure-tensor": structure_tensor_cue.CUE,
    "combined": combined_cue.CUE,
}

_CURVE_HIGH_PASS = 2.0  # pixels, for the whole picture
_BORDER = 15  # pixels at the border that are excluded, at most a quarter of a picture

Vector = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, eq=False, repr=False)
class DepthMap(Savable, Plottable, HostArray):
    """Depth at every pixel of the centre view; float32, shape (y, x).

    Attributes
    ----------
    disparity : numpy.ndarray
        Pixels a view step, nearer larger.
    alpha : numpy.ndarray
        F/F'; NaN without spacing.
    z : numpy.ndarray
        Metres from the focused plane, farther positive (as in `PointSources`); NaN without a
        camera.
    confidence : numpy.ndarray
        Confidence, 0 to 1, from the sharpness of the extremum and its distance to the second one.
        It is 0 without texture and, for cues that search planes, at the first or last plane.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (48, 48))
    >>> depth = clplen.depth_map(lf, disparities=np.linspace(-1, 1, 9))
    >>> depth.disparity.shape, f"{np.median(depth.disparity):.1f} pixels a view step"
    ((48, 48), '0.5 pixels a view step')
    """

    _writer: ClassVar[str] = "write_depth"
    _figure: ClassVar[str] = "depth"
    _samples: ClassVar[str] = "disparity"

    disparity: Map
    alpha: Map
    z: Map
    confidence: Map

    def __post_init__(self) -> None:
        for name, values in vars(self).items():
            if isinstance(values, np.ma.MaskedArray):  # masked means unknown
                object.__setattr__(self, name, real_map(values, f"The {name} of a depth map"))

    def __repr__(self) -> str:
        finite = self.disparity[np.isfinite(self.disparity)]
        span = f"disparity {finite.min():.4g} to {finite.max():.4g}" if finite.size else "unknown"
        return f"<DepthMap {self.disparity.shape} {self.disparity.dtype}, {span}>"


def as_depth_map(depth: Any) -> DepthMap:
    """Return a depth map unchanged; wrap disparities with NaN in the other maps.

    Masked disparities become NaN (unknown).
    """
    if hasattr(depth, "disparity") and hasattr(depth, "confidence"):
        depth_map: DepthMap = depth
        return depth_map
    disparity = real_map(getattr(depth, "disparity", depth), "A depth map")
    if disparity.ndim != 2:
        raise ShapeError(f"A depth map must have shape (y, x), got {disparity.shape}.")
    unknown = np.full(disparity.shape, np.nan, np.float32)
    return DepthMap(disparity, unknown, unknown, unknown)


def default_cue(source: LightField | FocalStack | StoredLightField) -> str:
    """Return the default cue of `depth_map` for a source."""
    sharpest = isinstance(source, FocalStack) or is_telecentric(source)
    return "energy" if sharpest else "combined"


def cue_named(name: str) -> Cue:
    """Return the cue of a name."""
    return _CUES[setting_of(DepthSettings, "cue").checked(name)]


def sharpness_curve(stack: FocalStack) -> Vector:
    """Compute the sharpness of each picture of a stack.

    The sharpness is the mean square of the difference between a picture and its Gaussian blur of 2
    pixels. Colours are converted to luma. A border is excluded: 15 pixels, or a quarter of a small
    picture. Before, the interpolation blur of all pictures is equalized, as in `depth_map`.

    Parameters
    ----------
    stack : FocalStack
        The focal stack.

    Returns
    -------
    numpy.ndarray
        Sharpness, float64, shape (n,).

    Examples
    --------
    >>> L = np.random.default_rng(1).random((3, 3, 32, 32), np.float32)
    >>> stack = clplen.focal_stack(L, disparities=[-1, 0, 1])
    >>> clplen.lightfield.sharpness_curve(stack).shape
    (3,)
    """
    require(FocalStack, stack, "stack", "focal_stack")
    count, ny, nx = stack.shape[:3]
    measure = LocalEnergy(_CURVE_HIGH_PASS, stack.shape[1:], device=stack.device, luma=True)
    energy = stack.device.empty((1, ny, nx), np.float32)
    top, left = (min(_BORDER, n // 4) for n in (ny, nx))
    curve = []
    for index in range(count):
        measure(energy, stack, start=index, count=1)
        inside = stack.device.download(energy)[0, top : ny - top, left : nx - left]
        curve.append(inside.mean(dtype=np.float64))
    return np.array(curve)


def distinct_planes(
    source: LightField | FocalStack | StoredLightField, alphas: Any, disparities: Any
) -> Vector:
    """Return the disparities to search, ascending, without duplicates."""
    options = {"alphas": alphas, "disparities": disparities}
    names = [name for name, value in options.items() if value is not None]
    if isinstance(source, FocalStack):
        if names:
            raise ValueError(
                f"A focal stack has fixed planes; {' and '.join(names)} can only be combined with "
                "a light field."
            )
        values = source.disparities
    elif alphas is not None:
        one_of_planes(alphas, disparities)
        values = source.disparity(plane_values(alphas, "alphas"))
    else:
        planes = default_disparities(source) if disparities is None else disparities
        values = plane_values(planes)
    if values.ndim != 1 or not np.isfinite(values).all() or np.unique(values).size < 3:
        raise ValueError(
            "A depth map needs a list of at least three different finite planes, got "
            f"{np.unique(values).size} of shape {values.shape}."
        )
    if not isinstance(source, FocalStack):
        require_overlap(source, source.weights, values)
    return np.unique(values)


def with_depth(
    source: LightField | FocalStack | StoredLightField, disparity: Map, confidence: Map
) -> DepthMap:
    """Build a DepthMap; compute alpha and z from the disparity."""
    if isinstance(source, FocalStack):
        disparities, first = np.unique(source.disparities, return_index=True)
        alpha = np.interp(disparity, disparities, source.alphas[first])
    else:
        alpha = source.alpha(disparity)
    if is_telecentric(source):
        _warn_high_na(source.camera, disparity)
    if source.camera is None or is_telecentric(source):
        z = depth_at(source, disparity)
    else:
        z = source.camera.dz(alpha)
    return DepthMap(disparity, alpha.astype(np.float32), np.float32(z), confidence)


def _warn_high_na(camera: Any, disparity: Map) -> None:
    message = high_na_message(camera, float(np.abs(disparity).max()))
    if message:
        warn_caller(
            f"{message}: z by the paraxial law is too far from the native plane by this factor.",
            SamplingWarning,
        )


def metric_depth(
    disparity: ArrayLike,
    *,
    baseline: float,
    focal_length: float,
    pixel_pitch: float,
    focus_distance: float | None = None,
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Compute the distance of points from the cameras along the optical axis.

    Solves d = (b f/p) (1/Z - 1/Z0) for Z, the form of the HCI 4D light field benchmark (Honauer et
    al. 2016), with p the sensor's larger side over its pixels. For a lens with microlenses b is
    the distance between views on the main lens, f the distance from the lens to the image plane
    and p the pitch of the microlenses; the formula is then the lens law, 1/z = 1/z0 + d/(kappa F).

    Parameters
    ----------
    disparity : array_like
        Disparity d in pixels a view step, nearer larger.
    baseline : float
        Distance b between neighbouring cameras in metres, positive.
    focal_length : float
        Distance f from lens to sensor in metres, positive.
    pixel_pitch : float
        Pixel pitch p in metres, positive.
    focus_distance : float, optional
        Distance Z0 of zero disparity in metres, positive. None: infinity, for rectified cameras
        with parallel axes.

    Returns
    -------
    numpy.ndarray
        Distance Z in metres, float64, with the shape of ``disparity``; inf at the disparity of
        infinity, NaN below it and for NaN.

    Raises
    ------
    ValueError
        If a length is not positive and finite.

    Examples
    --------
    >>> lengths = {"baseline": 1e-3, "focal_length": 0.05, "pixel_pitch": 1e-5}
    >>> clplen.lightfield.metric_depth([1.0, 2.0], **lengths).tolist()
    [5.0, 2.5]
    """
    lengths = {"baseline": baseline, "focal_length": focal_length, "pixel_pitch": pixel_pitch}
    if focus_distance is not None:
        lengths["focus_distance"] = focus_distance
    for name, value in lengths.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive and finite, in metres, got {value!r}.")
    at_focus = 0.0 if focus_distance is None else 1 / focus_distance
    d = real_array(disparity, "A disparity", np.float64)
    inverse = d * pixel_pitch / (baseline * focal_length) + at_focus
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(inverse >= 0, 1 / np.abs(inverse), np.nan)
