"""Interpolation of maps over the unit disc and between fields.

In the pupil a map is a bicubic spline through its samples. Beyond the disc, and in samples without
light, the samples are first continued smoothly, so that the spline has no edge. Between fields and
wavelengths every number is a weighted sum of the given numbers, with weights of splines,
polynomials or triangles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from clplen.compute.memory import free_memory
from clplen.units import amount, metres

Values = np.ndarray[Any, np.dtype[np.float64]]
ROUNDING = 1e-9  # tolerance of given samples, relative to the radius or the field
ORDER = 8  # order of the polynomial that continues a map with samples on the whole disc
ARRAY_COPIES = 6  # given, continued, coefficients, transmission and two temporary arrays
SMOOTH, STRAIGHT = 3, 1  # degrees of interpolation between fields and wavelengths


def require_room(samples: int) -> None:
    """Raise for maps that do not fit the memory of this computer, before they are computed."""
    needed, free = 8 * ARRAY_COPIES * samples, free_memory()
    if needed > free:
        raise MemoryError(
            f"OPD maps of {samples:,} samples need {amount(needed, 'B')} of memory, but "
            f"{amount(free, 'B')} are free: use fewer fields, wavelengths or samples of the pupil."
        )


def axes(shape: tuple[int, int]) -> tuple[Values, Values]:
    """Return positions v and u of a map's samples in the disc, shapes (n_v, 1) and (1, n_u)."""
    v, u = (np.linspace(-1, 1, n) for n in shape)
    return v[:, None], u[None, :]


def disc(shape: tuple[int, int]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return a mask of a map's samples on the unit disc, shape (n_v, n_u)."""
    v, u = axes(shape)
    return np.asarray(np.hypot(v, u) <= 1 + ROUNDING)


def continue_maps(maps: Values, valid: np.ndarray[Any, np.dtype[np.bool_]]) -> Values:
    """Continue maps into unknown samples with the smallest third derivatives.

    The sum of squares of all third differences is minimised, which preserves parabolas. If a map is
    known on the whole disc, a polynomial of order 8 is fitted and subtracted first.
    """
    out = np.where(valid, maps, 0.0)
    flat = valid.reshape(len(maps), -1)
    kinds, kind = np.unique(flat, axis=0, return_inverse=True)
    inside = disc(valid.shape[1:]).ravel()
    for number, mask in enumerate(kinds):
        chosen = np.flatnonzero(kind.ravel() == number)
        if mask.all():
            continue
        values = out[chosen].reshape(len(chosen), -1).T
        trend = np.zeros_like(values)
        if mask[inside].all() and mask.sum() >= 4 * (ORDER + 1) ** 2:
            powers = _powers(valid.shape[1:])
            trend = powers @ np.linalg.lstsq(powers[mask], values[mask], rcond=None)[0]
        rest = _least_third_differences(values - trend, mask, valid.shape[1:])
        out[chosen] = (rest + trend).T.reshape(len(chosen), *valid.shape[1:])
        out[chosen] = np.where(valid[chosen], maps[chosen], out[chosen])
    return out


def _powers(shape: tuple[int, int]) -> Values:
    """Return products of Legendre polynomials of v and u up to ORDER, shape (n_v n_u, terms)."""
    v, u = axes(shape)
    down = np.polynomial.legendre.legvander(v[:, 0], ORDER)
    right = np.polynomial.legendre.legvander(u[0], ORDER)
    terms = [(i, k) for i in range(ORDER + 1) for k in range(ORDER + 1 - i)]
    return np.stack([np.multiply.outer(down[:, i], right[:, k]).ravel() for i, k in terms], -1)


def _least_third_differences(values: Values, mask: Any, shape: tuple[int, int]) -> Values:
    """Return values, shape (n_v n_u, n), with the samples outside the mask filled in."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    def difference(n: int, order: int) -> Any:
        steps = np.diff(np.eye(order + 1), order, axis=0)[0] * ((n - 1) / 2) ** order
        offsets = list(range(order + 1))
        return sparse.diags(list(steps), offsets, shape=(n - order, n), format="csr")

    n_v, n_u = shape
    parts = [
        weight * sparse.kron(difference(n_v, 3 - k), difference(n_u, k), format="csr")
        for k, weight in enumerate((1.0, math.sqrt(3), math.sqrt(3), 1.0))
    ]
    matrix = sparse.vstack(parts, format="csc") / np.prod(shape)
    columns, valid_columns = matrix[:, ~mask], matrix[:, mask]
    normal = (columns.T @ columns).tocsc()
    out = values.copy()
    out[~mask] = splu(normal).solve(-np.asarray(columns.T @ (valid_columns @ values[mask])))
    return out


def nearest(maps: Values, valid: np.ndarray[Any, np.dtype[np.bool_]]) -> Values:
    """Replace unknown samples by the nearest known sample; both arrays (l, m, n_v, n_u)."""
    from scipy.ndimage import distance_transform_edt

    out, pitch = np.array(maps), [2 / (n - 1) for n in maps.shape[2:]]
    for index in np.ndindex(maps.shape[:2]):
        if not valid[index].all():
            row, column = distance_transform_edt(
                ~valid[index], sampling=pitch, return_distances=False, return_indices=True
            )
            out[index] = maps[index][row, column]
    return out


def light_edges(lit: np.ndarray[Any, np.dtype[np.bool_]], inside: Any) -> Values:
    """Return distances from the edge of the light, half a sample from lit ones, negative outside.

    A fully lit map gets the largest distance beyond the edge in the least vignetted map of its
    wavelength. Interpolation then cuts the light from the middle between both maps on.
    """
    from scipy.ndimage import distance_transform_edt

    mask = nearest(lit.astype(np.float64), np.broadcast_to(inside, lit.shape)) > 0
    pitch = [2 / (n - 1) for n in lit.shape[2:]]
    half = min(pitch) / 2
    out = np.full(lit.shape, np.nan)
    for index in np.ndindex(lit.shape[:2]):
        lit_map = mask[index]
        if not lit_map.all():
            within, beyond = (
                distance_transform_edt(m, sampling=pitch) for m in (lit_map, ~lit_map)
            )
            out[index] = np.where(lit_map, within - half, half - beyond)
    for maps in out:
        cut = [-float(lit_map.min()) for lit_map in maps if np.isfinite(lit_map).all()]
        maps[np.isnan(maps)] = min(cut, default=1.0)
    return out


def continue_edges(edges: Values, inside: Any) -> Values:
    """Continue edges, shape (l, m, n_v, n_u), beyond the disc."""
    flat = edges.reshape(-1, *edges.shape[2:])
    valid = np.broadcast_to(inside, flat.shape)
    return continue_maps(np.where(valid, flat, 0.0), valid).reshape(edges.shape)


def fraction_within(middle: Values, down: Values, right: Values) -> Values:
    """Return the fraction of cells in which a plane is positive, 0 to 1."""
    steep = np.maximum(np.maximum(down, right), 1e-150)
    flat = np.maximum(np.minimum(down, right), 1e-6 * steep)
    above = np.clip(middle, -(steep + flat) / 2, (steep + flat) / 2) + (steep + flat) / 2
    area = above**2 - np.maximum(above - steep, 0) ** 2 - np.maximum(above - flat, 0) ** 2
    return np.asarray(np.clip(area / (2 * steep * flat), 0, 1))


# Splines in the pupil: uniform cubic B-splines, whose fourth difference is 0 at both ends


def coefficients(maps: Values) -> Values:
    """Return coefficients of the bicubic splines through maps, shape (..., n_v + 2, n_u + 2)."""
    n_v, n_u = maps.shape[-2:]
    return np.asarray(_coefficient_matrix(n_v) @ maps @ _coefficient_matrix(n_u).T)


@lru_cache(maxsize=8)
def _coefficient_matrix(n: int) -> Values:
    """Return the matrix from samples to coefficients, shape (n + 2, n)."""
    matrix = np.zeros((n + 2, n + 2))
    for k in range(n):
        matrix[k, k : k + 3] = (1 / 6, 4 / 6, 1 / 6)
    matrix[n, :5] = matrix[n + 1, -5:] = (1, -4, 6, -4, 1)
    return np.ascontiguousarray(np.linalg.inv(matrix)[:, :n])


def spline(table: Values, v: Values, u: Values, *, order: tuple[int, int] = (0, 0)) -> Values:
    """Evaluate a bicubic spline, or a derivative, at positions of the square from -1 to 1."""
    down, row = _taps(v, table.shape[0] - 2, order[0])
    right, column = _taps(u, table.shape[1] - 2, order[1])
    flat, wide = table.ravel(), table.shape[1]
    first = row * wide + column
    out = np.zeros(np.shape(v))
    for i, weight in enumerate(down):
        line = np.zeros(np.shape(v))
        for k, column_weight in enumerate(right):
            line += column_weight * flat[first + (i * wide + k)]
        out += weight * line
    return out


def _taps(at: Values, n: int, order: int) -> tuple[list[Values], Any]:
    """Return four weights at positions along an axis, and the index of the first."""
    t = (at + 1) * ((n - 1) / 2)
    first = np.clip(np.floor(t), 0, n - 2).astype(np.int64)
    f = t - first
    g = 1 - f
    if order:
        scale = (n - 1) / 2
        slopes = [-g * g / 2, f * (1.5 * f - 2), g * (2 - 1.5 * g), f * f / 2]
        return [scale * slope for slope in slopes], first
    cubes = [
        g**3 / 6, 2 / 3 - f * f * (1 - f / 2), 2 / 3 - g * g * (1 - g / 2), f**3 / 6
    ]  # fmt: skip
    return cubes, first


def bilinear(table: Values, v: Values, u: Values) -> Values:
    """Interpolate samples of the square from -1 to 1, shape (n_v, n_u), linearly along axes."""
    parts = []
    for at, n in ((v, table.shape[0]), (u, table.shape[1])):
        t = np.clip((at + 1) * ((n - 1) / 2), 0, n - 1)
        first = np.minimum(t.astype(np.int64), n - 2)
        parts.append((first, t - first))
    (row, down), (column, right) = parts
    flat, wide = table.ravel(), table.shape[1]
    at = row * wide + column
    upper = flat[at] * (1 - right) + flat[at + 1] * right
    lower = flat[at + wide] * (1 - right) + flat[at + wide + 1] * right
    return np.asarray(upper * (1 - down) + lower * down)


# Between fields and wavelengths


@dataclass(frozen=True, eq=False)
class Line:
    """Positions on a line, with interpolation between them.

    Attributes
    ----------
    positions : numpy.ndarray
        Distinct positions in any order.
    """

    positions: Values

    @cached_property
    def _order(self) -> Any:
        return np.argsort(self.positions)

    @cached_property
    def _splines(self) -> dict[int, Any]:
        from scipy.interpolate import make_interp_spline

        positions, n = self.positions[self._order], len(self.positions)
        unit, scale = np.eye(n), max(float(np.abs(positions).max()), 1e-300)
        degrees = {d: min(d, n - 1) for d in (SMOOTH, STRAIGHT)}
        curves = {d: make_interp_spline(positions / scale, unit, k=k) for d, k in degrees.items()}
        return {d: (curve, scale) for d, curve in curves.items()}

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest position."""
        return float(self.positions.min()), float(self.positions.max())

    def holds(self, at: Any) -> Any:
        """Return a mask of positions between the ends."""
        low, high = self.ends
        room = ROUNDING * max(abs(low), abs(high))
        return (low - room <= at) & (at <= high + room)

    def weights(self, at: float, degree: int) -> Values:
        """Return the weight of each given position at another: of a spline, or of a polynomial."""
        out = np.empty(len(self.positions))
        if len(self.positions) == 1:
            return np.ones(1)
        low, high = self.ends
        curve, scale = self._splines[degree]
        out[self._order] = curve(min(max(at, low), high) / scale)
        return out


class FieldPositions:
    """Positions (y, x) of fields on the image plane, and weights between them."""

    def __init__(self, fields: Values, symmetric: bool) -> None:
        self.fields, self.symmetric = fields, symmetric
        self.reach = float(np.hypot(*fields.T).max())
        self._angle = 0.0
        self._lines: tuple[Line, ...] = ()
        self._triangles: Any = None
        self._index: Any = None
        if symmetric:
            self._along_radius()
        elif len(fields) > 1:
            self._over_plane()

    def _along_radius(self) -> None:
        radius = np.hypot(*self.fields.T)
        y, x = self.fields[radius.argmax()]
        self._angle = math.atan2(y, x)
        along = self.fields @ (math.sin(self._angle), math.cos(self._angle))
        off = np.abs(radius - along).max()
        if len(radius) < 2 or off > 1e-6 * self.reach:
            raise ValueError(
                "fields of a rotationally symmetric lens must be two or more along one radius; "
                f"these {len(radius)} are not: use distances from the axis, or symmetric=False."
            )
        self._lines = (Line(along),)

    def _over_plane(self) -> None:
        levels = [np.unique(axis) for axis in self.fields.T]
        if math.prod(len(level) for level in levels) == len(self.fields):
            if min(len(level) for level in levels) < 2:
                raise self._collinear_error()
            self._lines = tuple(Line(level) for level in levels)
            index = [
                np.searchsorted(level, axis)
                for level, axis in zip(levels, self.fields.T, strict=True)
            ]
            self._index = tuple(index)
            return
        from scipy.spatial import Delaunay, QhullError

        try:
            self._triangles = Delaunay(self.fields / max(self.reach, 1e-300))
        except QhullError as error:
            raise self._collinear_error() from error

    @staticmethod
    def _collinear_error() -> ValueError:
        return ValueError(
            "fields must not lie on one line, because the maps are undefined beside it: use "
            "symmetric=True with fields along a radius of a rotationally symmetric lens, or fields "
            "spread over the image."
        )

    @property
    def everywhere(self) -> bool:
        """True if one map holds for the whole image."""
        return len(self.fields) == 1

    def turn(self, y: float, x: float) -> tuple[float, float]:
        """Return (sine, cosine) of the angle by which maps are rotated for an image at (y, x)."""
        if not self.symmetric or (y == 0 and x == 0):
            return 0.0, 1.0
        angle = math.atan2(y, x) - self._angle
        return math.sin(angle), math.cos(angle)

    def require(self, images: Values) -> None:
        """Raise for positions (y, x), shape (n, 2), in metres, beyond the fields."""
        if self.everywhere:
            return
        if self.symmetric:
            inside = self._lines[0].holds(np.hypot(*images.T))
        elif self._triangles is None:
            inside = self._lines[0].holds(images[:, 0]) & self._lines[1].holds(images[:, 1])
        else:
            mesh: Any = self._triangles
            inside = mesh.find_simplex(images / self.reach, tol=ROUNDING) >= 0
        if not inside.all():
            raise self._range_error(*(float(at) for at in images[~inside][0]))

    def weights(self, y: float, x: float, degree: int) -> Values:
        """Return the weight of each field at a position."""
        if self.everywhere:
            return np.ones(1)
        self.require(np.array([[y, x]]))
        if self.symmetric:
            return self._lines[0].weights(math.hypot(y, x), degree)
        if self._triangles is None:
            down, right = (
                line.weights(at, degree) for line, at in zip(self._lines, (y, x), strict=True)
            )
            return np.asarray(down[self._index[0]] * right[self._index[1]])
        return self._in_triangle(y, x)

    def _in_triangle(self, y: float, x: float) -> Values:
        mesh: Any = self._triangles
        at = np.array([y, x]) / self.reach
        number = int(mesh.find_simplex(at, tol=ROUNDING))
        inverse = mesh.transform[number]
        first = inverse[:2] @ (at - inverse[2])
        out = np.zeros(len(self.fields))
        out[mesh.simplices[number]] = (*first, 1 - first.sum())
        return out

    def _range_error(self, y: float, x: float) -> ValueError:
        if self.symmetric:
            low, high = self._lines[0].ends
            reach = f"from {metres(low)} to {metres(high)}" if low else metres(high)
            reached = f"The OPD maps reach {reach} from the axis"
        else:
            (y0, x0), (y1, x1) = self.fields.min(axis=0), self.fields.max(axis=0)
            reached = (
                f"The OPD maps reach from (y, x) = ({metres(y0)}, {metres(x0)}) to "
                f"({metres(y1)}, {metres(x1)})"
            )
        return ValueError(
            f"{reached}, but the point is imaged at ({metres(y)}, {metres(x)}), "
            f"{metres(math.hypot(y, x))} from the axis: add maps of fields there, or move the "
            "point."
        )
