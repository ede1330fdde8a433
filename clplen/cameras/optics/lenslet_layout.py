"""Lenslets at any positions of a plane, each with its focal length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from clplen import units
from clplen.checks import is_finite, real_array
from clplen.reprs import OneLine
from clplen.units import metres
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.transmission import phasor

Vector = np.ndarray[Any, Any]
Fill = Literal["circular", "square", "hexagonal"]

FILLS = ("circular", "square", "hexagonal")
MAX_LENSLETS = 10_000  # maximum lenslets of a layout
OVERLAP_TOLERANCE = 1e-6  # relative overlap of apertures that rounding may cause


@dataclass(frozen=True, init=False, eq=False, repr=False)
class LensletLayout(OneLine):
    """Thin lenslets of one size at any positions, opaque between them.

    Parameters
    ----------
    positions : array_like
        Centres (y, x) in metres from the axis, shape (n, 2).
    focal_length : float or sequence of float
        Focal length in metres, positive; one value, or a value for each lenslet.
    diameter : float
        Diameter of the discs, or width of squares or hexagons across their flats, in metres.
    fill : {"circular", "square", "hexagonal"}
        Shape of the apertures; hexagons have two flats across x.
    rotation : float
        Angle of squares and hexagons about their centres in radians; positive turns +x towards +y.

    Attributes
    ----------
    positions : numpy.ndarray
        Centres, float64, shape (n, 2).
    focal_lengths : numpy.ndarray
        Focal lengths, float64, shape (n,).
    diameter, fill, rotation
        Arguments of the constructor.

    Raises
    ------
    ValueError
        If a length is outside its range, arrays have other shapes, or apertures overlap.

    Examples
    --------
    >>> angles = np.arange(6) * np.pi / 3
    >>> ring = 1e-3 * np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    >>> layout = clplen.cameras.LensletLayout([(0, 0), *ring], 30e-3, diameter=0.9e-3)
    >>> len(layout), f"{layout.spacing * 1e3:.1f} mm to the nearest neighbour"
    (7, '1.0 mm to the nearest neighbour')
    """

    positions: Vector
    focal_lengths: Vector
    diameter: float
    fill: Fill
    rotation: float

    def __init__(
        self,
        positions: Any,
        focal_length: float | Sequence[float],
        *,
        diameter: float,
        fill: Fill = "circular",
        rotation: float = 0.0,
    ) -> None:
        centres = _numbers(positions, "Positions of lenslets")
        if centres.ndim != 2 or centres.shape[1:] != (2,) or not 1 <= len(centres) <= MAX_LENSLETS:
            raise ValueError(
                f"positions must be (y, x) of each lenslet, shape (n, 2) with n from 1 to "
                f"{MAX_LENSLETS}, got {centres.shape}."
            )
        units.OFFSET.check(centres, "A position of a lenslet")
        focal = _numbers(focal_length, "Focal lengths")
        if focal.ndim > 1 or focal.size not in (1, len(centres)) or not (focal > 0).all():
            raise ValueError(
                f"focal_length must be > 0, one value or one for each of {len(centres)} lenslets, "
                f"got {focal_length!r}."
            )
        units.CAMERA_FOCAL_LENGTH.check(focal, "A focal length")
        if not (is_finite(diameter) and diameter > 0):
            raise ValueError(f"diameter must be > 0, in metres, got {diameter!r}.")
        units.LENSLET_PITCH.check(diameter, "The diameter of lenslets")
        if fill not in FILLS:
            raise ValueError(f"fill must be {', '.join(map(repr, FILLS))}, got {fill!r}.")
        if not is_finite(rotation):
            raise ValueError(f"rotation must be a finite angle in radians, got {rotation!r}.")
        values = {
            "positions": centres,
            "focal_lengths": np.broadcast_to(focal, (len(centres),)).copy(),
            "diameter": float(diameter),
            "fill": fill,
            "rotation": float(rotation),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check_apart()

    @classmethod
    def of(cls, mla: MicrolensArray) -> LensletLayout:
        """Return the layout of an array's lenslets.

        Parameters
        ----------
        mla : MicrolensArray
            Array of thin lenslets without clear gaps, of any lattice, fill, kinds and rotation.

        Returns
        -------
        LensletLayout

        Raises
        ------
        ValueError
            If its lenslets are not thin lenses.
        """
        if not mla.is_thin:
            raise ValueError(
                "A layout supports thin lenslets only: leave out surface=, map= and gap= of the "
                "array."
            )
        cell: Fill = "hexagonal" if mla.lattice == "hexagonal" else "square"
        return cls(
            mla.centres().reshape(-1, 2),
            np.asarray(mla.focal_lengths)[mla.types().ravel()],
            diameter=mla.diameter,
            fill="circular" if mla.fill == "circular" else cell,
            rotation=mla.rotation,
        )

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        low, high = (metres(float(f)) for f in (self.focal_lengths.min(), self.focal_lengths.max()))
        f = low if low == high else f"{low} to {high}"
        size = metres(self.diameter)
        return f"<LensletLayout of {len(self)} lenslets, {size}, {self.fill}, f {f}>"

    @property
    def spacing(self) -> float:
        """Smallest distance of two centres in metres; infinite for one lenslet."""
        if len(self) == 1:
            return math.inf
        from scipy.spatial import cKDTree

        return float(cKDTree(self.positions).query(self.positions, k=2)[0][:, 1].min())

    @property
    def reach(self) -> float:
        """Largest distance of an aperture's points from its centre, in metres."""
        corner = {"circular": 1.0, "square": math.sqrt(2), "hexagonal": 2 / math.sqrt(3)}
        return self.diameter / 2 * corner[self.fill]

    @property
    def area(self) -> float:
        """Area of one aperture in square metres."""
        of_square = {"circular": math.pi / 4, "square": 1.0, "hexagonal": math.sqrt(3) / 2}
        return self.diameter**2 * of_square[self.fill]

    def coverage(self, y: Vector, x: Vector, step: float) -> Vector:
        """Compute the fraction of each sample that an aperture about the origin covers.

        Exact along straight rims, else to second order in ``step``.
        """
        half = self.diameter / 2
        if self.fill == "circular":
            return rim_coverage(half - np.hypot(y[:, None], x), step)
        normals = 2 if self.fill == "square" else 3
        out = np.ones((len(y), len(x)))
        for angle in self.rotation + np.arange(normals) * np.pi / normals:
            across = np.abs(x * math.cos(angle) + y[:, None] * math.sin(angle))
            out *= rim_coverage(half - across, step)
        return out

    def transmission(self, y: Vector, x: Vector, wavelength: float) -> Vector:
        """Compute exp(-i pi r^2/(lam f)) within each aperture, 0 between apertures.

        ``y`` and ``x`` are evenly spaced, in metres; the result is complex128, shape (ny, nx).
        """
        out = np.zeros((len(y), len(x)), complex)
        step = float(x[1] - x[0])
        reach = self.reach + step
        for (cy, cx), focal in zip(self.positions, self.focal_lengths, strict=True):
            rows = slice(*np.searchsorted(y, (cy - reach, cy + reach)))
            columns = slice(*np.searchsorted(x, (cx - reach, cx + reach)))
            v, u = y[rows] - cy, x[columns] - cx
            thin = [phasor(-(t**2) / (2 * wavelength * focal)) for t in (v, u)]
            out[rows, columns] += self.coverage(v, u, step) * thin[0][:, None] * thin[1]
        return out

    def _check_apart(self) -> None:
        """Raise for apertures that overlap."""
        if len(self) == 1:
            return
        from scipy.spatial import cKDTree

        min_distance = self.diameter * (1 - OVERLAP_TOLERANCE)
        norm = math.inf if self.fill == "square" else 2
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        y, x = self.positions.T
        turned = np.stack([y * cos - x * sin, x * cos + y * sin], axis=-1)
        distances = cKDTree(turned).query(turned, k=2, p=norm)[0][:, 1]
        if (distances < min_distance).any():
            number = int(distances.argmin())
            raise ValueError(
                f"Lenslets must not overlap, but lenslet {number} (from 0) is "
                f"{distances[number]:g} m from its neighbour and {self.diameter:g} m wide: move "
                "it, or use a smaller diameter."
            )


def rim_coverage(inside: Vector, step: float) -> Vector:
    """Compute the fraction of samples within a rim from distances to it, positive inside."""
    return np.clip(0.5 + inside / step, 0.0, 1.0)


def _numbers(values: Any, what: str) -> Vector:
    """Return finite real numbers, float64."""
    try:
        numbers = real_array(values, what, np.float64)
    except TypeError:
        raise ValueError(f"{what} must be real numbers in metres, got {values!r}.") from None
    if not np.isfinite(numbers).all():
        raise ValueError(f"{what} must be finite numbers in metres.")
    return numbers
