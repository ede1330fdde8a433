"""Depth maps of light fields and of focal stacks."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from clplen.compute.checks import require
from clplen.compute.hostarray import HostArray
from clplen.errors import SamplingWarning
from clplen.lightfield.arrays.peaks import Map
from clplen.lightfield.depth.best_focus import high_na_words
from clplen.lightfield.depth.correspondence import correspondence_disparity
from clplen.lightfield.depth.local_energy import LocalEnergy
from clplen.lightfield.depth.plane_choice import default_disparities
from clplen.lightfield.depth.sharpness_cue import energy_disparity
from clplen.lightfield.depth.structure_tensor import structure_disparity
from clplen.lightfield.model.alpha_law import depth_at
from clplen.lightfield.model.stored_light_field import StoredLightField, as_lightfield
from clplen.lightfield.raw.raw_image import is_telecentric
from clplen.lightfield.refocus.focal_stack import FocalStack

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clplen.lightfield.model.light_field import LightField

CUES = ("energy", "correspondence", "structure-tensor", "combined")

_CURVE_HIGH_PASS = 2.0  # pixels, for the whole picture
_BORDER = 15  # pixels left out of the whole picture, at most a quarter of it

Vector = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, eq=False, repr=False)
class DepthMap(HostArray):
    """Depth at every pixel of the centre view; float32, shape (y, x). Made by `depth_map`.

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
        0 to 1: how sharp the extremum is and how far from the second one; 0 without texture and,
        for cues that try planes, where the first or the last one is best.
    """

    _samples: ClassVar[str] = "disparity"

    disparity: Map
    alpha: Map
    z: Map
    confidence: Map

    def __repr__(self) -> str:
        known = self.disparity[np.isfinite(self.disparity)]
        span = f"disparity {known.min():.4g} to {known.max():.4g}" if known.size else "unknown"
        return f"<DepthMap {self.disparity.shape} {self.disparity.dtype}, {span}>"


def depth_map(
    source: LightField | FocalStack,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    cue: str | None = None,
) -> DepthMap:
    """Disparity at every pixel of the centre view, finer than the planes that are tried.

    Cues
    ----
    "energy"
        The sharpest plane: highest local energy of detail of the refocused picture
        (`clplen.lightfield.depth.sharpness_cue`). A cue of defocus: strong in noise, weak beside
        occlusions.
    "correspondence"
        The plane on which the views agree: least variance over the views in a box of 9 pixels
        (`clplen.lightfield.depth.correspondence`). Sharp at edges, misled by highlights and noise.
    "structure-tensor"
        The orientation of the epipolar-plane images, sheared in steps, most coherent of both
        directions
        (`clplen.lightfield.depth.structure_tensor`). Of the planes only the range counts.
    "combined"
        Matching past occlusions with adaptive support, refined by least squares
        (`clplen.lightfield.depth.combined_cue`): the most exact, and the slowest.

    Parameters
    ----------
    source : LightField or FocalStack
        A stack brings its own planes, in any order, and allows only "energy"; one without
        `weights` of its views is taken as it is.
    alphas, disparities : array_like, optional
        Planes to try, at least three different ones, not both. For a light field without either:
        33 disparities from -2 to 2; of a microscope, over its depth range (`suitable_planes`).
    cue : {"energy", "correspondence", "structure-tensor", "combined"}, optional
        Default "energy" for a stack, and for the light field of a microscope: what fluoresces is
        transparent, where the other cues look for surfaces and put single points on disparity 0;
        "combined" for other light fields.

    Returns
    -------
    DepthMap

    Raises
    ------
    ValueError
        If the cue is unknown or needs the views that a stack does not have, alphas and disparities
        are both given or given with a stack, or there are fewer than three planes.
    DeviceError
        If what is needed is larger than the device's memory.

    Warns
    -----
    SamplingWarning
        From NA/n = .7 of a microscope on, where ``z`` is too far from the native plane by the
        factor that it names (`clplen.lightfield.depth.best_focus`).
    """
    if not isinstance(source, FocalStack):
        source = as_lightfield(source, "stream_depth")
    cue = default_cue(source) if cue is None else checked_cue(cue)
    planes = distinct_planes(source, alphas, disparities)
    return depth_of(source, *maps_of(source, planes, cue))


def default_cue(source: LightField | FocalStack | StoredLightField) -> str:
    """The cue of `depth_map` where none was given."""
    sharpest = isinstance(source, FocalStack) or is_telecentric(source)
    return "energy" if sharpest else "combined"


def checked_cue(cue: str) -> str:
    """One of the cues.

    Raises
    ------
    ValueError
        If it is none.
    """
    if cue not in CUES:
        raise ValueError(f"The cues of depth_map are {', '.join(map(repr, CUES))}, not {cue!r}.")
    return cue


def maps_of(source: LightField | FocalStack, planes: Vector, cue: str) -> tuple[Map, Map]:
    """(disparity, confidence) by a cue, from rising planes."""
    if cue == "energy":
        return energy_disparity(source, planes)
    if isinstance(source, FocalStack):
        raise ValueError(
            f"cue={cue!r} compares views, which a focal stack does not have: give the light field, "
            "or cue='energy'."
        )
    return _compare_views(cue)(source, planes)


def _compare_views(cue: str) -> Callable[[LightField, Vector], tuple[Map, Map]]:
    """What finds (disparity, confidence) by one of the cues that need a light field."""
    if cue == "combined":
        from clplen.lightfield.depth.combined_cue import combined_disparity

        return combined_disparity
    return correspondence_disparity if cue == "correspondence" else structure_disparity


def sharpness_curve(stack: FocalStack) -> Vector:
    """How sharp each picture of a stack is as a whole.

    The mean square of what a Gaussian of 2 pixels takes away (of the luma, for three colours),
    without a border of 15 pixels (a quarter of a small picture). The pictures are made equally
    blurred by interpolation first, as in `depth_map`.

    Parameters
    ----------
    stack : FocalStack

    Returns
    -------
    numpy.ndarray
        float64, shape (n,).
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
    """The disparities to try, rising, each once."""
    options = {"alphas": alphas, "disparities": disparities}
    given = [name for name, value in options.items() if value is not None]
    if isinstance(source, FocalStack):
        if given:
            raise ValueError(
                f"A focal stack has its own planes; depth_map takes {' and '.join(given)} only "
                "with a light field."
            )
        values = source.disparities
    elif len(given) == 2:
        raise ValueError("Give alphas or disparities, not both.")
    elif alphas is not None:
        values = source.disparity(alphas)
    else:
        values = np.asarray(
            default_disparities(source) if disparities is None else disparities, float
        )
    if values.ndim != 1 or not np.isfinite(values).all() or np.unique(values).size < 3:
        raise ValueError(
            "A depth map needs a list of at least three different finite planes, not "
            f"{np.unique(values).size} of shape {values.shape}."
        )
    return np.unique(values)


def depth_of(
    source: LightField | FocalStack | StoredLightField, disparity: Map, confidence: Map
) -> DepthMap:
    """With alpha and z that follow from the disparity."""
    if isinstance(source, FocalStack):
        known, first = np.unique(source.disparities, return_index=True)
        alpha = np.interp(disparity, known, source.alphas[first])
    else:
        alpha = source.alpha(disparity)
    if is_telecentric(source):
        _say_high_na(source.camera, disparity)
    if source.camera is None or is_telecentric(source):
        z = depth_at(source, disparity)
    else:
        z = source.camera.dz(alpha)
    return DepthMap(disparity, alpha.astype(np.float32), np.float32(z), confidence)


def _say_high_na(camera: Any, disparity: Map) -> None:
    words = high_na_words(camera, float(np.abs(disparity).max()))
    if words:
        warnings.warn(
            f"{words}: z, which is that of the paraxial law, is too far from the native plane by "
            "this factor.",
            SamplingWarning,
            stacklevel=4,
        )
