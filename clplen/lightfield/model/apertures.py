"""Aperture shapes: covered fractions of the views' cells, and soft edges.

Views are the centres of cells one view step wide and high. A shape is an array (V, U) of the
covered fraction of each cell, in closed form. Its sum is the area in cells if the shape lies within
them; radii may be below a view. Shapes and apodisations can be multiplied and passed as
``aperture=``. Centres are (v, u); None is the middle of the views. A radius is a number of view
steps, or a pair along v and u (for steps that differ in metres).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import float64_array, host_array, is_integer, real_array
from clplen.errors import ShapeError
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.settings.declaration import SettingError, setting_of
from clplen.settings.light_fields import ApertureSettings, f_number_of

Weights = np.ndarray[Any, np.dtype[np.float32]]
Vector = np.ndarray[Any, np.dtype[np.float64]]
Views = tuple[int, ...]
Pair = tuple[float, float]

_ROUNDING = 1e-12  # of a cell: a smaller fraction counts as none
_FAR_CORNER = 4.0  # distance of a half-plane's corners, in sizes of the views


def disc(views: Views, radius: float | Pair, *, centre: Pair | None = None) -> Weights:
    """Return a disc (an ellipse for two radii).

    Parameters
    ----------
    views : tuple of int
        Shape (V, U, ...) of the views, such as ``lf.shape``.
    radius : float or tuple of float
        Radius in view steps, positive.
    centre : tuple of float, optional
        Centre (v, u).

    Returns
    -------
    numpy.ndarray
        Weights, float32, shape (V, U), 0 to 1.

    Raises
    ------
    ValueError
        If a number is out of range or the shape covers no view.

    Examples
    --------
    >>> weights = clplen.lightfield.disc((5, 5), 1.0)
    >>> float(weights[2, 2]), float(weights[0, 0])
    (1.0, 0.0)
    """
    return _checked_cells(
        ellipse_cells(_views(views), _pair(radius), _centre(views, centre)), "disc"
    )


def annulus(
    views: Views, inner: float | Pair, outer: float | Pair, *, centre: Pair | None = None
) -> Weights:
    """Return the area between two discs; parameters as in `disc`.

    Parameters
    ----------
    views : tuple of int
        Shape (V, U, ...) of the views.
    inner, outer : float or tuple of float
        Radii in view steps, or pairs along v and u; inner below outer.
    centre : tuple of float, optional
        Centre (v, u); default the middle of the views.

    Returns
    -------
    numpy.ndarray
        Weights, float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.annulus((5, 5), 1.0, 2.0)
    >>> weights.shape, bool(weights[2, 2] == 0)
    ((5, 5), True)
    """
    small, large = _pair(inner), _pair(outer)
    if not (small[0] < large[0] and small[1] < large[1]):
        raise ValueError(f"inner must be below outer, got {inner!r} and {outer!r}.")
    at, size = _centre(views, centre), _views(views)
    return _checked_cells(
        ellipse_cells(size, large, at) - ellipse_cells(size, small, at), "annulus"
    )


def polygon(views: Views, corners: ArrayLike) -> Weights:
    """Return a polygon that does not cross itself.

    Parameters
    ----------
    views : tuple of int
        Shape (V, U, ...) of the views.
    corners : array_like
        Corners (v, u), shape (n, 2), n >= 3, clockwise or counterclockwise.

    Returns
    -------
    numpy.ndarray
        Weights, float32, shape (V, U), 0 to 1.

    Raises
    ------
    ShapeError
        If the corners are not (n, 2).
    ValueError
        If a corner is not finite, or no view is covered.

    Examples
    --------
    >>> weights = clplen.lightfield.polygon((5, 5), [(-1.2, -1.2), (-1.2, 1.2), (1.2, 0)])
    >>> weights.shape
    (5, 5)
    """
    at = real_array(corners, "corners", np.float64)
    if at.ndim != 2 or at.shape[1] != 2 or len(at) < 3:
        raise ShapeError(f"corners must have shape (n, 2) with n >= 3, got {at.shape}.")
    if not np.isfinite(at).all():
        raise ValueError("corners must be finite.")
    V, U = _views(views)
    cells = np.zeros((V, U))
    for v in range(V):
        row = _clipped(_clipped(at, 0, v - 0.5, 1), 0, v + 0.5, -1)
        for u in range(U) if len(row) else ():
            cells[v, u] = _area(_clipped(_clipped(row, 1, u - 0.5, 1), 1, u + 0.5, -1))
    return _checked_cells(cells, "polygon")


def regular_polygon(
    views: Views,
    sides: int,
    radius: float | Pair,
    *,
    angle: float = 0.0,
    centre: Pair | None = None,
) -> Weights:
    """Return a regular polygon, such as the opening of an iris.

    Parameters
    ----------
    views : tuple of int
        Shape (V, U, ...) of the views.
    sides : int
        Number of sides, at least 3.
    radius : float or tuple of float
        Radius of the corners, see `disc`.
    angle : float
        Angle of the first corner, from the direction of u to that of v, in radians.
    centre : tuple of float, optional
        Centre, see `disc`.

    Returns
    -------
    numpy.ndarray
        Weights, float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.regular_polygon((5, 5), 6, 2.0)
    >>> weights.shape
    (5, 5)
    """
    if not is_integer(sides) or sides < 3:
        raise ValueError(f"sides must be an integer of at least 3, got {sides!r}.")
    (high, wide), (v, u) = _pair(radius), _centre(views, centre)
    turn = angle + 2 * np.pi * np.arange(int(sides)) / int(sides)
    return polygon(views, np.column_stack((v + high * np.sin(turn), u + wide * np.cos(turn))))


def half_plane(views: Views, angle: float, *, centre: Pair | None = None) -> Weights:
    """Return the half-plane on one side of a line through the centre, such as a knife edge.

    Parameters
    ----------
    views : tuple of int
        Shape (V, U, ...) of the views.
    angle : float
        Direction of the open side, from u to v, in radians: 0 keeps larger u, pi/2 larger v.
    centre : tuple of float, optional
        Point (v, u) on the edge.

    Returns
    -------
    numpy.ndarray
        Weights, float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.half_plane((5, 5), 0.0)
    >>> weights.shape
    (5, 5)
    """
    if not np.isfinite(angle):
        raise ValueError(f"angle must be finite, in radians, got {angle!r}.")
    (v, u), far = _centre(views, centre), _FAR_CORNER * (sum(_views(views)) + 2)
    open_side, edge = (np.array([np.sin(t), np.cos(t)]) for t in (angle, angle + np.pi / 2))
    at = np.array([v, u])
    near = [at - far * edge, at + far * edge]
    return polygon(views, [*near, near[1] + far * open_side, near[0] + far * open_side])


def gaussian(views: Views, sigma: float | Pair, *, centre: Pair | None = None) -> Weights:
    """Return the apodisation exp(-r^2/(2 sigma^2)) at the views; sigma in view steps.

    Parameters
    ----------
    views : tuple of int
        Shape (V, U, ...) of the views.
    sigma : float or tuple of float
        Width in view steps, or a pair along v and u.
    centre : tuple of float, optional
        Centre (v, u); default the middle of the views.

    Returns
    -------
    numpy.ndarray
        Weights, float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.gaussian((5, 5), 1.0)
    >>> f"{weights[2, 3] / weights[2, 2]:.3f}"
    '0.607'
    """
    return np.exp(-0.5 * _distance(views, sigma, centre) ** 2).astype(np.float32)


def hann(views: Views, radius: float | Pair, *, centre: Pair | None = None) -> Weights:
    """Return the apodisation (1 + cos(pi r/radius))/2 at the views, 0 beyond the radius.

    Parameters
    ----------
    views : tuple of int
        Shape (V, U, ...) of the views.
    radius : float or tuple of float
        Radius in view steps, or a pair along v and u.
    centre : tuple of float, optional
        Centre (v, u); default the middle of the views.

    Returns
    -------
    numpy.ndarray
        Weights, float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.hann((5, 5), 2.5)
    >>> f"{weights[2, 2]:.2f}"
    '1.00'
    """
    r = np.minimum(_distance(views, radius, centre), 1)
    return ((1 + np.cos(np.pi * r)) / 2).astype(np.float32)


def kaiser(
    views: Views, radius: float | Pair, beta: float, *, centre: Pair | None = None
) -> Weights:
    """Return the apodisation I0(beta sqrt(1 - r^2/radius^2))/I0(beta) (Kaiser 1974).

    Parameters
    ----------
    views : tuple of int
        Shape (V, U, ...) of the views.
    radius : float or tuple of float
        Radius in view steps, or a pair along v and u.
    beta : float
        Shape parameter: 0 for an even disc; larger values are narrower.
    centre : tuple of float, optional
        Centre (v, u); default the middle of the views.

    Returns
    -------
    numpy.ndarray
        Weights, float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.kaiser((5, 5), 2.5, 6.0)
    >>> f"{weights[2, 2]:.2f}"
    '1.00'
    """
    if not (np.isfinite(beta) and 0 <= beta <= 100):
        raise ValueError(f"beta must be from 0 to 100, got {beta!r}.")
    r = _distance(views, radius, centre)
    inside = np.i0(beta * np.sqrt(np.maximum(1 - r**2, 0))) / np.i0(beta)
    return np.where(r <= 1, inside, 0).astype(np.float32)


def ellipse_cells(views: tuple[int, int], radius: Pair, centre: Pair) -> Vector:
    """Return the covered fraction of every view's cell by an ellipse, shape (V, U), float64."""
    y, x = (
        np.clip((np.arange(n + 1) - 0.5 - c) / r, -1, 1)
        for n, c, r in zip(views, centre, radius, strict=True)
    )
    area = _disc_area(y[:, None], x[None, :]) * (radius[0] * radius[1])
    cells = np.clip(area[1:, 1:] - area[1:, :-1] - area[:-1, 1:] + area[:-1, :-1], 0, 1)
    return np.where(cells < _ROUNDING, 0.0, cells)


def _disc_area(y: Vector, x: Vector) -> Vector:
    """Return the area of the unit disc between the axes and (y, x), odd in both arguments."""

    def under_arc(t: Vector) -> Vector:
        """Integrate sqrt(1 - t^2) from 0 to t."""
        return (t * np.sqrt(1 - t**2) + np.arcsin(t)) / 2

    height, width = np.abs(y), np.abs(x)
    # Intersection of the arc with the upper side
    corner = np.minimum(width, np.sqrt(1 - height**2))
    area = height * corner + under_arc(width) - under_arc(corner)
    return np.sign(y) * np.sign(x) * area


def _views(views: Views) -> tuple[int, int]:
    if len(views) < 2 or not all(is_integer(n) and n >= 1 for n in views[:2]):
        raise ShapeError(f"views must be (V, U, ...), as in lf.shape, got {views!r}.")
    return int(views[0]), int(views[1])


def _pair(radius: Any) -> Pair:
    values = np.broadcast_to(float64_array(radius), 2)
    if not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(f"radius must be positive, in view steps, got {radius!r}.")
    return float(values[0]), float(values[1])


def _centre(views: Views, centre: Any) -> Pair:
    V, U = _views(views)
    if centre is None:
        return (V - 1) / 2, (U - 1) / 2
    values = float64_array(centre)
    if values.shape != (2,) or not np.isfinite(values).all():
        raise ValueError(f"centre must be (v, u), got {centre!r}.")
    return float(values[0]), float(values[1])


def _distance(views: Views, unit: Any, centre: Any) -> Vector:
    """Return the distance of every view from the centre, in units along v and u."""
    v, u = (
        (np.arange(n) - at) / r
        for n, at, r in zip(_views(views), _centre(views, centre), _pair(unit), strict=True)
    )
    return np.hypot(v[:, None], u[None, :])


def _clipped(corners: Vector, axis: int, edge: float, side: int) -> Vector:
    """Clip a polygon to side (x[axis] - edge) >= 0 (Sutherland and Hodgman 1974)."""
    points: list[Any] = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side_a, side_b = side * (a[axis] - edge), side * (b[axis] - edge)
        if side_a >= 0:
            points.append(a)
        if side_a * side_b < 0:
            points.append(a + (b - a) * side_a / (side_a - side_b))
    return np.array(points).reshape(-1, 2)


def _area(corners: Vector) -> float:
    """Return the area of a polygon (Gauss' formula)."""
    y, x = corners.T
    return abs(float(y @ np.roll(x, -1) - x @ np.roll(y, -1))) / 2


def _checked_cells(cells: Vector, name: str) -> Weights:
    if not cells.any():
        raise ValueError(f"The {name} covers no view; choose another centre or a larger size.")
    return np.where(cells < _ROUNDING, 0.0, cells).astype(np.float32)


def aperture_weights(lf: SampledViews, aperture: Any, viewpoint: Any) -> Weights:
    """Return the weights of an aperture, without the light field's own.

    A view that the rim crosses is weighted by the covered fraction of its cell, one view step wide
    and high; parts outside the views are cut off.
    """
    views = (lf.shape[0], lf.shape[1])
    centre = None if viewpoint is None else _checked_viewpoint(viewpoint, views)
    if aperture is None:
        weights = np.ones(views) if centre is None else _point(views, centre)
    elif not isinstance(aperture, str) and np.ndim(aperture) == 2:
        weights = _shifted(_checked_array(aperture, views), centre)
    else:
        setting = setting_of(ApertureSettings, "aperture").checked(aperture)
        if isinstance(setting, str):
            weights = _disc(views, _f_number_diameter(lf, setting), centre)
        elif isinstance(setting, int):
            weights = _square(views, setting, centre)
        else:
            weights = _disc(views, (setting * views[0], setting * views[1]), centre)
    return weights.astype(np.float32)


def _checked_viewpoint(viewpoint: Any, views: tuple[int, int]) -> Pair:
    values = real_array(viewpoint, "A viewpoint", np.float64)
    if values.shape != (2,):
        raise ValueError(f"viewpoint must be (v, u), got {viewpoint!r}.")
    if not ((values >= 0) & (values <= np.asarray(views) - 1)).all():
        raise ValueError(
            f"viewpoint must be inside the views, v from 0 to {views[0] - 1} and u from 0 to "
            f"{views[1] - 1}, got {viewpoint!r}."
        )
    return float(values[0]), float(values[1])


def _point(views: tuple[int, int], at: Pair) -> Vector:
    """Return bilinear weights of the four views around a point."""
    v, u = (np.maximum(1 - np.abs(np.arange(n) - t), 0) for n, t in zip(views, at, strict=True))
    return np.outer(v, u)


def _square(views: tuple[int, int], across: int, centre: Pair | None) -> Vector:
    """Return a square of views with partly covered cells at the edge; eq. 3.3 if centred."""
    if not 1 <= across <= max(views):
        raise SettingError(
            "aperture",
            f"must be at most the {max(views)} views across of a light field of {views[0]} x "
            f"{views[1]} views, got {across}",
        )
    sides = []
    for axis, n in enumerate(views):
        count = min(across, n)
        below = (n - count) // 2 if centre is None else centre[axis] - (count - 1) / 2
        covered = np.minimum(np.arange(n) + 1, below + count) - np.maximum(np.arange(n), below)
        sides.append(np.clip(covered, 0, 1))
    return np.outer(*sides)


def _disc(views: tuple[int, int], diameter: Pair, centre: Pair | None) -> Vector:
    """Return the covered fraction of every view's cell by an ellipse (a disc on the main lens)."""
    v, u = ((n - 1) / 2 for n in views)
    return ellipse_cells(views, (diameter[0] / 2, diameter[1] / 2), centre or (v, u))


def _f_number_diameter(lf: SampledViews, text: str) -> Pair:
    """Return the diameter in view steps along v and u of the main lens at an f-number."""
    if lf.camera is None or lf.spacing is None or not np.isfinite(lf.spacing).all():
        raise ValueError(
            f"The aperture {text!r} needs the camera and the spacing of views in metres, which "
            "this light field does not have; pass a number of views or a fraction instead."
        )
    full, distance = lf.camera.aperture_diameter, lf.camera.image_distance
    dv, du = abs(lf.spacing[0]), abs(lf.spacing[1])
    diameter = distance / f_number_of(text)
    if diameter > full + min(dv, du):  # f-numbers are rounded: a view step of tolerance
        raise ValueError(
            f"The aperture {text!r} is wider than the main lens, which is f/{distance / full:.4g} "
            f"at its image; pass at least f/{distance / full:.4g}."
        )
    return diameter / dv, diameter / du


def _checked_array(aperture: Any, views: tuple[int, int]) -> Vector:
    weights = host_array(aperture, "An aperture").astype(np.float64)
    if weights.shape != views:
        raise ShapeError(
            f"aperture must have the shape of the views, {views}, got {weights.shape}."
        )
    if not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise ValueError("Weights of an aperture must be finite and not negative.")
    return weights


def _shifted(weights: Vector, centre: Pair | None) -> Vector:
    """Shift weights from the middle of the views to a viewpoint, bilinear, 0 from outside."""
    if centre is None:
        return weights
    sides = []
    for n, at in zip(weights.shape, centre, strict=True):
        j = np.arange(n)
        offsets = j[:, None] - j[None, :] - (at - (n - 1) / 2)
        sides.append(np.maximum(1 - np.abs(offsets), 0))
    return sides[0] @ weights @ sides[1].T
