"""Where the lenses of a Raytrix camera lie, as its calibration tells.

The calibration counts y upwards, the offset in pixels from the centre of the image, ((h - 1)/2,
(w - 1)/2), and base vectors in lens diameters; the rotation turns them counter-clockwise
(Palmieri, PlenopticToolbox2.0: plenopticIO/imgIO.py, lens_grid.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.lattice import Lattice
from clplen.lightfield.raw import LensType

Vector = tuple[float, float]
Array = np.ndarray[Any, np.dtype[np.float64]]

_LARGEST = 10000  # pixels a lens, and lens diameters
_NEAR = 0.05  # lens diameters: how far a lens of a type may lie from the lattice


_SQUARE = 0.1  # cosine up to which base vectors are at right angles
_HEXAGON = 0.06  # relative differences among neighbours of a hexagonal lattice


@dataclass(frozen=True)
class Distortion:
    """What the file says of the main lens' distortion; kept, not applied.

    Attributes
    ----------
    kind, function : str
        Such as "radial" and "Brown".
    parameters : tuple of float
    offset : tuple of float
        (x, y) in pixels.
    """

    kind: str
    function: str
    parameters: tuple[float, ...]
    offset: Vector


@dataclass(frozen=True)
class FocusType:
    """One of the kinds of lenses of a multi-focus array, as in the file.

    Attributes
    ----------
    offset : tuple of float
        (x, y) of one of its lenses, in lens diameters, y upwards.
    depth_range : tuple of float
        (least, greatest) virtual depth.
    """

    offset: Vector
    depth_range: Vector


@dataclass(frozen=True)
class RaytrixCalibration:
    """A calibration as in the file: x before y, and y upwards.

    Attributes
    ----------
    offset : tuple of float
        (x, y) of a lens' centre, in pixels from the centre of the image.
    diameter : float
        Lens pitch in pixels.
    lens_base_x, lens_base_y : tuple of float
        Base vectors of the lattice, in lens diameters.
    rotation : float
        Of the base vectors, counter-clockwise, in radians.
    lens_border : float
        Pixels at the rim of a lens that are not used.
    tcp : float or None
        Virtual depth of the total covering plane.
    sub_grid_base : tuple of float or None
        (width, height) in lens diameters of the rectangle that repeats the types of the lenses.
    distortion : Distortion or None
    lens_types : tuple of FocusType
        By their id.
    """

    offset: Vector
    diameter: float
    lens_base_x: Vector
    lens_base_y: Vector
    rotation: float = 0.0
    lens_border: float = 0.0
    tcp: float | None = None
    sub_grid_base: Vector | None = None
    distortion: Distortion | None = None
    lens_types: tuple[FocusType, ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= self.diameter <= _LARGEST:
            raise ValueError(
                f"The diameter of a lens is 1 to {_LARGEST} pixels, not {self.diameter}."
            )
        (ax, ay), (bx, by) = self.lens_base_x, self.lens_base_y
        if not max(map(abs, (ax, ay, bx, by))) <= _LARGEST or not abs(ax * by - ay * bx) > 1e-3:
            raise ValueError(
                f"The base vectors {self.lens_base_x} and {self.lens_base_y} span no lattice."
            )

    def origin(self, shape: tuple[int, int]) -> Vector:
        """(y, x) in pixels, y downwards, of a lens' centre in an image of a shape (ny, nx)."""
        return (shape[0] - 1) / 2 - self.offset[1], (shape[1] - 1) / 2 + self.offset[0]

    def on_sensor(self, vector: Vector) -> Vector:
        """(y, x) in pixels, y downwards, of (x, y) in lens diameters, rotation included."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        x, y = vector
        return -self.diameter * (s * x + c * y), self.diameter * (c * x - s * y)

    def lattice(self, shape: tuple[int, int]) -> Lattice:
        """All lenses of an image of a shape (ny, nx).

        Raises
        ------
        ValueError
            If they lie neither on a rectangular nor on a hexagonal lattice.
        """
        kind, row, column = lattice_vectors(
            self.on_sensor(self.lens_base_x), self.on_sensor(self.lens_base_y)
        )
        verdict = "from a calibration of Raytrix"
        return Lattice(kind, self.origin(shape), row, column, shape, verdict=verdict)

    def types(self) -> tuple[LensType, ...]:
        """The kinds of lenses on the sensor.

        Lenses of one kind lie on a lattice of their own: that of the rectangle ``sub_grid_base``,
        with a second lens in its middle where it holds two of each kind.

        Raises
        ------
        ValueError
            If the rectangle does not hold one or two lenses of each kind.
        """
        if len(self.lens_types) < 2 or self.sub_grid_base is None:
            base: tuple[Vector, ...] = (self.lens_base_y, self.lens_base_x)
        else:
            base = self._sub_lattice(self.sub_grid_base)
        steps = (self.on_sensor(base[0]), self.on_sensor(base[1]))
        return tuple(
            LensType(self.on_sensor(t.offset), t.depth_range, steps) for t in self.lens_types
        )

    def _sub_lattice(self, rectangle: Vector) -> tuple[Vector, Vector]:
        """Two vectors between lenses of one kind."""
        width, height = (abs(side) for side in rectangle)
        (ax, ay), (bx, by) = self.lens_base_x, self.lens_base_y
        each = width * height / abs(ax * by - ay * bx) / len(self.lens_types)
        for count, row in ((1, (0.0, height)), (2, (width / 2, height / 2))):
            if abs(each - count) < _NEAR and self._is_lens(row) and self._is_lens((width, 0)):
                return row, (width, 0.0)
        raise ValueError(
            f"The rectangle of {width:g} x {height:g} lenses, after which the kinds of lenses are "
            f"said to repeat, holds {each:.2f} of each of {len(self.lens_types)} kinds, not one "
            "or two on the lattice."
        )

    def _is_lens(self, place: Vector) -> bool:
        base = np.array([self.lens_base_x, self.lens_base_y]).T
        found = np.linalg.solve(base, np.array(place))
        return bool(np.all(np.abs(found - np.round(found)) < _NEAR))


def lattice_vectors(first: Vector, second: Vector) -> tuple[str, Vector, Vector]:
    """Kind, row and column of `Lattice` for any two base vectors (y, x).

    Raises
    ------
    ValueError
        If the lattice is neither rectangular nor hexagonal.
    """
    a, b = _shortest(np.array(first), np.array(second))
    cosine = float(a @ b / math.sqrt(a @ a * (b @ b)))
    if abs(cosine) < _SQUARE:
        column, row = (a, b) if abs(a[1] * b[0]) > abs(a[0] * b[1]) else (b, a)
        return "rectangular", _pair(row * np.sign(row[0])), _pair(column * np.sign(column[1]))
    near = [a, b, b - a if cosine > 0 else a + b]
    lengths = [math.hypot(*vector) for vector in near]
    if max(lengths) > (1 + _HEXAGON) * min(lengths):
        angle = math.degrees(math.acos(abs(cosine)))
        raise ValueError(
            f"The base vectors enclose {angle:.1f} degrees with lengths of {lengths[0]:.4g} and "
            f"{lengths[1]:.4g} px: the lattice is neither rectangular nor hexagonal."
        )
    along = max(near, key=lambda v: float(np.abs(v).max() / math.hypot(*v)))
    other = next(vector for vector in near if vector is not along)
    axis = int(np.abs(along).argmax())  # 1: neighbours along x
    along = along * np.sign(along[axis])
    across = other - along * np.sign(other @ along) / 2
    across = across * np.sign(across[1 - axis])
    row, column = (across, along) if axis == 1 else (along, across)
    return "hexagonal", _pair(row), _pair(column)


def _shortest(a: Array, b: Array) -> tuple[Array, Array]:
    """The two shortest vectors that span the lattice of two (Gauss 1801)."""
    while True:
        if a @ a > b @ b:
            a, b = b, a
        shorter = b - round(float(a @ b / (a @ a))) * a
        if not shorter @ shorter < (1 - 1e-9) * (b @ b):  # a tie, as in a hexagon, ends too
            return a, b
        b = shorter


def _pair(vector: Array) -> Vector:
    return float(vector[0]), float(vector[1])
