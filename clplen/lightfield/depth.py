"""Depth maps from the sharpness of a focal stack."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.focus import HighPass, Map, PeakTracker
from clplen.lightfield.gaussian import GaussianBlur
from clplen.lightfield.interpolation import EvenBlur
from clplen.lightfield.refocus import FocalStack, focal_stack

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clplen.lightfield.lightfield import LightField

CUES = ("energy",)
DEFAULT_DISPARITIES = np.linspace(-2, 2, 33)

_HIGH_PASS = 1.5  # pixels: what a wider Gaussian leaves is no detail
_WINDOW = 4.0  # pixels: Gaussian over which the energy is gathered
_CURVE_HIGH_PASS = 2.0  # pixels, for the whole picture
_BORDER = 15  # pixels left out of the whole picture, at most a quarter of it
_AT_ONCE = 8  # planes refocused in one pass over the light field

Vector = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class DepthMap:
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
        0 to 1, from the curvature of the peak and its margin to the second highest; 0 without
        texture and where the first or the last plane is the sharpest.
    """

    disparity: Map
    alpha: Map
    z: Map
    confidence: Map


def depth_map(
    source: LightField | FocalStack,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    cue: str = "energy",
) -> DepthMap:
    """Disparity of the sharpest plane at every pixel, refined between the planes.

    The cue "energy" is E_d = G_w * (R_d - G_s * R_d)^2, the squares added over the colours, with
    R_d the picture refocused on disparity d and G Gaussians of s = 1.5 and w = 4 pixels: by
    Parseval the windowed spectral energy above a cut-off. First every R_d is blurred until it has
    lost as much to interpolation as a shift of half a pixel loses (`EvenBlur`), or else whole
    disparities would be preferred. The peak is refined by the parabola through the highest plane
    and its two neighbours.

    Parameters
    ----------
    source : LightField or FocalStack
        A stack brings its own planes, in any order; one without `weights` of its views is taken
        as it is.
    alphas, disparities : array_like, optional
        Planes to try, at least three different ones, not both. For a light field without either:
        33 disparities from -2 to 2.
    cue : {"energy"}

    Returns
    -------
    DepthMap

    Raises
    ------
    ValueError
        If the cue is unknown, alphas and disparities are both given or given with a stack, or
        there are fewer than three planes.
    DeviceError
        If what is needed is larger than the device's memory.
    """
    if cue not in CUES:
        raise ValueError(f"The cues of depth_map are {', '.join(map(repr, CUES))}, not {cue!r}.")
    planes = _distinct(source, alphas, disparities)
    device = source.device
    shape = source.shape[1:] if isinstance(source, FocalStack) else source.shape[2:]
    size = (shape[0], shape[1])
    _require_memory(source, shape)
    gather = GaussianBlur(_WINDOW, size, device=device)
    even = EvenBlur(shape, device=device)
    high_pass = HighPass(_HIGH_PASS, shape, device=device)
    tracker = PeakTracker(size, device=device, start=planes[np.argmin(np.abs(planes))])
    for disparity, stack, index in _focused(source, planes):
        energy = tracker.next_plane(disparity)
        high_pass(energy, even(stack, index))
        gather(energy, energy)
    return _depth_map(source, *tracker.finish())


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
    count, ny, nx = stack.shape[:3]
    high_pass = HighPass(_CURVE_HIGH_PASS, stack.shape[1:], device=stack.device, luma=True)
    even = EvenBlur(stack.shape[1:], device=stack.device)
    energy = stack.device.empty((ny, nx), np.float32)
    top, left = (min(_BORDER, n // 4) for n in (ny, nx))
    curve = []
    for index in range(count):
        high_pass(energy, even(stack, index))
        inside = stack.device.download(energy)[top : ny - top, left : nx - left]
        curve.append(inside.mean(dtype=np.float64))
    return np.array(curve)


def _distinct(source: LightField | FocalStack, alphas: Any, disparities: Any) -> Vector:
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
        values = DEFAULT_DISPARITIES if disparities is None else np.asarray(disparities, float)
    if values.ndim != 1 or not np.isfinite(values).all() or np.unique(values).size < 3:
        raise ValueError(
            "A depth map needs a list of at least three different finite planes, not "
            f"{np.unique(values).size} of shape {values.shape}."
        )
    return np.unique(values)


def _focused(
    source: LightField | FocalStack, planes: Vector
) -> Iterator[tuple[float, FocalStack, int]]:
    """(disparity, stack, index in it) of each plane, a few refocused at a time."""
    if isinstance(source, FocalStack):
        for index in np.unique(source.disparities, return_index=True)[1]:
            yield float(source.disparities[index]), source, int(index)
        return
    for start in range(0, planes.size, _AT_ONCE):
        stack = focal_stack(source, disparities=planes[start : start + _AT_ONCE])
        for index, disparity in enumerate(stack.disparities):
            yield float(disparity), stack, index


def _require_memory(source: LightField | FocalStack, shape: tuple[int, ...]) -> None:
    """Everything that is held at once, in float32 pictures and maps."""
    pictures = 3 + (0 if isinstance(source, FocalStack) else _AT_ONCE)
    colours = shape[2] if len(shape) == 3 else 1
    nbytes = 4 * shape[0] * shape[1] * (pictures * colours + 8) + source.data.nbytes
    source.device.require_memory(nbytes, "This depth map with its source")


def _depth_map(source: LightField | FocalStack, disparity: Map, confidence: Map) -> DepthMap:
    """Alpha and z that follow from the disparity."""
    if isinstance(source, FocalStack):
        known, first = np.unique(source.disparities, return_index=True)
        alpha = np.interp(disparity, known, source.alphas[first])
    else:
        alpha = source.alpha(disparity)
    z = np.full_like(alpha, np.nan) if source.camera is None else source.camera.dz(alpha)
    return DepthMap(disparity, alpha.astype(np.float32), np.float32(z), confidence)
