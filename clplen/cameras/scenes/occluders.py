"""Flat screens, and their shadows on the pupil of the main lens by waves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from clplen.checks import is_finite, real_array
from clplen.compute.arrays import HostArray
from clplen.errors import ShapeError
from clplen.reprs import OneLine

Values = np.ndarray[Any, np.dtype[np.float64]]
Waves = np.ndarray[Any, np.dtype[np.complex128]]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Occluder(OneLine, HostArray):
    """Flat screen across the optical axis that attenuates the light from behind it.

    It emits no light. Sample i of an axis of n samples covers a square about (i - n//2) width/nx
    from the axis, as in `PicturePlane`; light passes beside the screen.

    Parameters
    ----------
    opacity : array_like
        Fraction of the light's intensity that is blocked, 0 to 1, shape (ny, nx).
    width : float
        Width of the whole screen along x in metres, nx samples.
    z : float
        Distance from the focused object plane in metres; > 0 is farther from the lens.

    Attributes
    ----------
    opacity : numpy.ndarray
        Opacity, float64, shape (ny, nx).
    width, z : float
        Width and distance in metres.

    Raises
    ------
    ShapeError
        If the opacity is not two-dimensional, or empty.
    TypeError
        If the opacity is not an array of real numbers.
    ValueError
        If an opacity, the width or z is outside its range.

    Examples
    --------
    >>> stops = np.zeros((4, 4))
    >>> stops[:, 2:] = 1.0  # nothing passes from x = -1 mm on
    >>> screen = clplen.cameras.Occluder(stops, 8e-3, z=-20e-3)  # before the focused plane
    >>> y, x = screen.edges()
    >>> np.round(x * 1e3, 3).tolist()  # in millimetres
    [-5.0, -3.0, -1.0, 1.0, 3.0]
    """

    _samples: ClassVar[str] = "opacity"

    opacity: Values
    width: float
    z: float

    def __init__(self, opacity: Any, width: float, z: float = 0.0) -> None:
        try:
            values = np.array(real_array(opacity, "An opacity", np.float64))
        except TypeError as error:
            raise TypeError(
                f"opacity must be an array of real numbers, (ny, nx), got {type(opacity).__name__}."
            ) from error
        if values.ndim != 2 or values.size == 0:
            raise ShapeError(f"opacity must have shape (ny, nx), got {values.shape}.")
        if not ((values >= 0) & (values <= 1)).all():
            raise ValueError("opacity must be from 0 to 1, without NaN.")
        check_plane("a screen", width, z)
        object.__setattr__(self, "opacity", values)
        object.__setattr__(self, "width", float(width))
        object.__setattr__(self, "z", float(z))

    def edges(self) -> tuple[Values, Values]:
        """Return sides of the samples in metres, shapes (ny + 1,) and (nx + 1,)."""
        ny, nx = self.opacity.shape
        pitch = self.width / nx
        return tuple((np.arange(n + 1) - n // 2 - 0.5) * pitch for n in (ny, nx))


def check_plane(what: str, width: float, z: float) -> None:
    """Raise for an invalid width or z of a plane across the axis."""
    if not (is_finite(width) and width > 0):
        raise ValueError(f"The width of {what} must be > 0, in metres, got {width!r}.")
    if not is_finite(z):
        raise ValueError(f"z of {what} must be a finite number of metres, got {z!r}.")


def shadows(
    occluders: Sequence[Occluder],
    positions: Values,
    *,
    object_distance: float,
    wavelength: float,
    axis: Values,
) -> Waves:
    """Compute the field of points on the pupil over their field without screens.

    A spherical wave from (x, y) at z1 before the lens passes a screen of transmission t at z2 < z1.
    Relative to the wave without a screen, its field at u on the lens is t in a plane wave,
    propagated over z2 (z1 - z2)/z1. It is sampled at x + (u - x) (z1 - z2)/z1, where the ray to u
    crosses the screen (Goodman 2005, eq. 4-14 and problem 4-9). The samples of t are squares, so
    that the field is a sum of products of Fresnel integrals along y and x, averaged over the cells
    of ``axis``. Factors of several screens multiply; double diffraction is neglected.
    """
    factors = np.ones((len(positions), axis.size, axis.size), complex)
    for screen in occluders:
        blocked = 1 - np.sqrt(1 - screen.opacity)
        nearer = object_distance + screen.z
        for number in np.flatnonzero(positions[:, 2] > screen.z):
            x, y, dz = positions[number]
            farther = object_distance + dz
            share = (farther - nearer) / farther
            scale = np.sqrt(2 / (wavelength * nearer * share))
            down, right = (
                _strip_integrals(edges, at + (axis - at) * share, scale)
                for edges, at in zip(screen.edges(), (y, x), strict=True)
            )
            factors[number] *= 1 - down @ blocked @ right.T
    return factors


def _strip_integrals(edges: Values, positions: Values, scale: float) -> Waves:
    """Compute the light of strips between edges at each position, mean over its cell.

    Shape (places, strips): integrals of exp(i pi w^2/2)/(1 + i) over strips, w distance * scale.
    """
    half = abs(positions[1] - positions[0]) * scale / 2
    w = (edges[None, :] - positions[:, None]) * scale
    mean = (_integral(w + half) - _integral(w - half)) / (2 * half)
    return np.diff(mean, axis=1) / (1 + 1j)


def _integral(w: Values) -> Waves:
    """Integrate C(w) + i S(w): w (C + i S) + i exp(i pi w^2/2)/pi (DLMF 7.7)."""
    from scipy import special  # a slow import

    s, c = special.fresnel(w)
    return np.asarray(w * (c + 1j * s) + 1j / np.pi * np.exp(0.5j * np.pi * w**2))
