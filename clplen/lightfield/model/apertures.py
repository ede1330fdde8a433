"""Shapes of apertures: covered fractions of the views' cells, and soft edges.

Views are the centres of cells one view step wide and high. A shape is an array (V, U) with the
covered fraction of each cell, in closed form, so that its sum is the area in cells as long as the
shape lies within them; radii may be below a view. Shapes and apodisations multiply, and go where
``aperture=`` goes. Centres are (v, u); None is the middle of the views. A radius is one number of
view steps, or one along v and one along u (for steps that differ in metres).
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

_ROUNDING = 1e-12  # of a cell: what is less is none, and no view shows through it
_FAR = 4.0  # corners of a half-plane, in sizes of the views


def disc(views: Views, radius: float | Pair, *, centre: Pair | None = None) -> Weights:
    """A disc (an ellipse for two radii).

    Parameters
    ----------
    views : tuple of int
        (V, U, ...), such as ``lf.shape``.
    radius : float or tuple of float
        In view steps, positive.
    centre : tuple of float, optional
        (v, u).

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), 0 to 1.

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
    """What lies between two discs; parameters as of `disc`.

    Parameters
    ----------
    views : tuple of int
        (V, U, ...).
    inner, outer : float or tuple of float
        Radii in view steps, or one along v and one along u; inner below outer.
    centre : tuple of float, optional
        (v, u) of the middle; default that of the views.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.annulus((5, 5), 1.0, 2.0)
    >>> weights.shape, bool(weights[2, 2] == 0)
    ((5, 5), True)
    """
    small, large = _pair(inner), _pair(outer)
    if not (small[0] < large[0] and small[1] < large[1]):
        raise ValueError(f"An annulus has inner below outer radius, not {inner!r} and {outer!r}.")
    at, size = _centre(views, centre), _views(views)
    return _checked_cells(
        ellipse_cells(size, large, at) - ellipse_cells(size, small, at), "annulus"
    )


def polygon(views: Views, corners: ArrayLike) -> Weights:
    """Any polygon that does not cross itself.

    Parameters
    ----------
    views : tuple of int
        (V, U, ...).
    corners : array_like
        Shape (n, 2), n >= 3: (v, u) in order, either way round.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), 0 to 1.

    Raises
    ------
    ShapeError
        If the corners are not (n, 2).
    ValueError
        If one is not finite, or no view is covered.

    Examples
    --------
    >>> weights = clplen.lightfield.polygon((5, 5), [(-1.2, -1.2), (-1.2, 1.2), (1.2, 0)])
    >>> weights.shape
    (5, 5)
    """
    at = real_array(corners, "corners", np.float64)
    if at.ndim != 2 or at.shape[1] != 2 or len(at) < 3:
        raise ShapeError(f"A polygon has at least three corners (v, u), not shape {at.shape}.")
    if not np.isfinite(at).all():
        raise ValueError("Corners of a polygon are finite numbers.")
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
    """A regular polygon, such as the blades of an iris leave open.

    Parameters
    ----------
    views : tuple of int
        (V, U, ...).
    sides : int
        At least 3.
    radius : float or tuple of float
        Of the corners, as of `disc`.
    angle : float
        Of the first corner from the direction of u to that of v, in radians.
    centre : tuple of float, optional
        As of `disc`.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.regular_polygon((5, 5), 6, 2.0)
    >>> weights.shape
    (5, 5)
    """
    if not is_integer(sides) or sides < 3:
        raise ValueError(f"A polygon has at least 3 sides, not {sides!r}.")
    (high, wide), (v, u) = _pair(radius), _centre(views, centre)
    turn = angle + 2 * np.pi * np.arange(int(sides)) / int(sides)
    return polygon(views, np.column_stack((v + high * np.sin(turn), u + wide * np.cos(turn))))


def half_plane(views: Views, angle: float, *, centre: Pair | None = None) -> Weights:
    """Everything on one side of a line through the centre, as of a knife edge.

    Parameters
    ----------
    views : tuple of int
        (V, U, ...).
    angle : float
        Of the direction that stays open, from that of u to that of v, in radians: 0 keeps larger
        u, pi/2 larger v.
    centre : tuple of float, optional
        (v, u) of a point on the edge.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.half_plane((5, 5), 0.0)
    >>> weights.shape
    (5, 5)
    """
    if not np.isfinite(angle):
        raise ValueError(f"An angle is a finite number in radians, not {angle!r}.")
    (v, u), far = _centre(views, centre), _FAR * (sum(_views(views)) + 2)
    open_side, edge = (np.array([np.sin(t), np.cos(t)]) for t in (angle, angle + np.pi / 2))
    at = np.array([v, u])
    near = [at - far * edge, at + far * edge]
    return polygon(views, [*near, near[1] + far * open_side, near[0] + far * open_side])


def gaussian(views: Views, sigma: float | Pair, *, centre: Pair | None = None) -> Weights:
    """Apodisation exp(-r^2/(2 sigma^2)) at the views; sigma in view steps.

    Parameters
    ----------
    views : tuple of int
        (V, U, ...).
    sigma : float or tuple of float
        In view steps, or one along v and one along u.
    centre : tuple of float, optional
        (v, u) of the middle; default that of the views.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.gaussian((5, 5), 1.0)
    >>> f"{weights[2, 3] / weights[2, 2]:.3f}"
    '0.607'
    """
    return np.exp(-0.5 * _distance(views, sigma, centre) ** 2).astype(np.float32)


def hann(views: Views, radius: float | Pair, *, centre: Pair | None = None) -> Weights:
    """Apodisation (1 + cos(pi r/radius))/2 at the views, 0 beyond the radius.

    Parameters
    ----------
    views : tuple of int
        (V, U, ...).
    radius : float or tuple of float
        In view steps, or one along v and one along u.
    centre : tuple of float, optional
        (v, u) of the middle; default that of the views.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), 0 to 1.

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
    """Apodisation I0(beta sqrt(1 - r^2/radius^2))/I0(beta) at the views (Kaiser 1974).

    Parameters
    ----------
    views : tuple of int
        (V, U, ...).
    radius : float or tuple of float
        In view steps, or one along v and one along u.
    beta : float
        0 for an even disc; larger is narrower.
    centre : tuple of float, optional
        (v, u) of the middle; default that of the views.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), 0 to 1.

    Examples
    --------
    >>> weights = clplen.lightfield.kaiser((5, 5), 2.5, 6.0)
    >>> f"{weights[2, 2]:.2f}"
    '1.00'
    """
    if not (np.isfinite(beta) and 0 <= beta <= 100):
        raise ValueError(f"beta of a Kaiser window is from 0 to 100, not {beta!r}.")
    r = _distance(views, radius, centre)
    inside = np.i0(beta * np.sqrt(np.maximum(1 - r**2, 0))) / np.i0(beta)
    return np.where(r <= 1, inside, 0).astype(np.float32)


def ellipse_cells(views: tuple[int, int], radius: Pair, centre: Pair) -> Vector:
    """Covered fraction of every view's cell by an ellipse, shape (V, U), float64."""
    y, x = (
        np.clip((np.arange(n + 1) - 0.5 - c) / r, -1, 1)
        for n, c, r in zip(views, centre, radius, strict=True)
    )
    area = _disc_area(y[:, None], x[None, :]) * (radius[0] * radius[1])
    cells = np.clip(area[1:, 1:] - area[1:, :-1] - area[:-1, 1:] + area[:-1, :-1], 0, 1)
    return np.where(cells < _ROUNDING, 0.0, cells)


def _disc_area(y: Vector, x: Vector) -> Vector:
    """Area of the unit disc between the axes and (y, x), odd in both, for y and x from -1 to 1."""

    def under_arc(t: Vector) -> Vector:
        """Integral of sqrt(1 - t^2) from 0 to t."""
        return (t * np.sqrt(1 - t**2) + np.arcsin(t)) / 2

    height, width = np.abs(y), np.abs(x)
    corner = np.minimum(width, np.sqrt(1 - height**2))  # where the arc meets the upper side
    area = height * corner + under_arc(width) - under_arc(corner)
    return np.sign(y) * np.sign(x) * area


def _views(views: Views) -> tuple[int, int]:
    if len(views) < 2 or not all(is_integer(n) and n >= 1 for n in views[:2]):
        raise ShapeError(f"Views are (V, U), as in lf.shape, not {views!r}.")
    return int(views[0]), int(views[1])


def _pair(radius: Any) -> Pair:
    values = np.broadcast_to(float64_array(radius), 2)
    if not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(f"A radius is positive, in view steps, or one along v and u: {radius!r}.")
    return float(values[0]), float(values[1])


def _centre(views: Views, centre: Any) -> Pair:
    V, U = _views(views)
    if centre is None:
        return (V - 1) / 2, (U - 1) / 2
    values = float64_array(centre)
    if values.shape != (2,) or not np.isfinite(values).all():
        raise ValueError(f"The centre of an aperture is (v, u), not {centre!r}.")
    return float(values[0]), float(values[1])


def _distance(views: Views, unit: Any, centre: Any) -> Vector:
    """From the centre to every view, in units along v and u."""
    v, u = (
        (np.arange(n) - at) / r
        for n, at, r in zip(_views(views), _centre(views, centre), _pair(unit), strict=True)
    )
    return np.hypot(v[:, None], u[None, :])


def _clipped(corners: Vector, axis: int, edge: float, side: int) -> Vector:
    """Corners of what is left of a polygon where side (x[axis] - edge) >= 0.

    Sutherland and Hodgman 1974.
    """
    kept: list[Any] = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        here, there = side * (a[axis] - edge), side * (b[axis] - edge)
        if here >= 0:
            kept.append(a)
        if here * there < 0:
            kept.append(a + (b - a) * here / (here - there))
    return np.array(kept).reshape(-1, 2)


def _area(corners: Vector) -> float:
    """Of a polygon (Gauss' formula)."""
    y, x = corners.T
    return abs(float(y @ np.roll(x, -1) - x @ np.roll(y, -1))) / 2


def _checked_cells(cells: Vector, name: str) -> Weights:
    if not cells.any():
        raise ValueError(f"This {name} covers no view: give another centre or a larger one.")
    return np.where(cells < _ROUNDING, 0.0, cells).astype(np.float32)




def aperture_weights(lf: SampledViews, aperture: Any, viewpoint: Any) -> Weights:
    """Weights of an aperture, without the light field's own.

    A rim that crosses a view gives it the covered fraction of its cell, one view step wide and
    high; what lies outside the views is cut off.
    """
    views = (lf.shape[0], lf.shape[1])
    centre = None if viewpoint is None else _checked_viewpoint(viewpoint, views)
    if aperture is None:
        weights = np.ones(views) if centre is None else _point(views, centre)
    elif not isinstance(aperture, str) and np.ndim(aperture) == 2:
        weights = _shifted(_checked_array(aperture, views), centre)
    else:
        given = setting_of(ApertureSettings, "aperture").checked(aperture)
        if isinstance(given, str):
            weights = _disc(views, _f_number_diameter(lf, given), centre)
        elif isinstance(given, int):
            weights = _square(views, given, centre)
        else:
            weights = _disc(views, (given * views[0], given * views[1]), centre)
    return weights.astype(np.float32)


def _checked_viewpoint(viewpoint: Any, views: tuple[int, int]) -> Pair:
    values = real_array(viewpoint, "A viewpoint", np.float64)
    if values.shape != (2,):
        raise ValueError(f"A viewpoint is (v, u), not {viewpoint!r}.")
    if not ((values >= 0) & (values <= np.asarray(views) - 1)).all():
        raise ValueError(
            f"The viewpoint {viewpoint!r} lies outside the views: v is from 0 to {views[0] - 1}, "
            f"u from 0 to {views[1] - 1}."
        )
    return float(values[0]), float(values[1])


def _point(views: tuple[int, int], at: Pair) -> Vector:
    """Bilinear between the four views round a point."""
    v, u = (np.maximum(1 - np.abs(np.arange(n) - t), 0) for n, t in zip(views, at, strict=True))
    return np.outer(v, u)


def _square(views: tuple[int, int], across: int, centre: Pair | None) -> Vector:
    """So many views across, cells that the edge crosses in part; eq. 3.3 when not moved."""
    if not 1 <= across <= max(views):
        raise SettingError(
            "aperture",
            f"must be at most the {max(views)} views across of a light field of {views[0]} x "
            f"{views[1]} views, got {across}",
        )
    sides = []
    for axis, n in enumerate(views):
        kept = min(across, n)
        below = (n - kept) // 2 if centre is None else centre[axis] - (kept - 1) / 2
        covered = np.minimum(np.arange(n) + 1, below + kept) - np.maximum(np.arange(n), below)
        sides.append(np.clip(covered, 0, 1))
    return np.outer(*sides)


def _disc(views: tuple[int, int], diameter: Pair, centre: Pair | None) -> Vector:
    """Covered fraction of every view's cell by an ellipse (a disc on the main lens)."""
    v, u = ((n - 1) / 2 for n in views)
    return ellipse_cells(views, (diameter[0] / 2, diameter[1] / 2), centre or (v, u))


def _f_number_diameter(lf: SampledViews, text: str) -> Pair:
    """Diameter, in view steps along v and u, of the main lens stopped down to an f-number."""
    if lf.camera is None or lf.spacing is None or not np.isfinite(lf.spacing).all():
        raise ValueError(
            f"The aperture {text!r} needs the camera and the spacing of views in metres, which "
            "this light field does not have: give a number of views or a fraction instead."
        )
    full, distance = lf.camera.aperture_diameter, lf.camera.image_distance
    dv, du = abs(lf.spacing[0]), abs(lf.spacing[1])
    diameter = distance / f_number_of(text)
    if diameter > full + min(dv, du):  # f-numbers are round numbers: a view step is forgiven
        raise ValueError(
            f"The aperture {text!r} is wider than the main lens, which is f/{distance / full:.4g} "
            f"at its image: give at least f/{distance / full:.4g}."
        )
    return diameter / dv, diameter / du


def _checked_array(aperture: Any, views: tuple[int, int]) -> Vector:
    weights = host_array(aperture, "An aperture").astype(np.float64)
    if weights.shape != views:
        raise ShapeError(f"The aperture has shape {weights.shape}, the views {views}.")
    if not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise ValueError("Weights of an aperture are finite and not negative.")
    return weights


def _shifted(weights: Vector, centre: Pair | None) -> Vector:
    """Weights shifted from the middle of the views to a viewpoint, bilinear, 0 from outside."""
    if centre is None:
        return weights
    sides = []
    for n, at in zip(weights.shape, centre, strict=True):
        j = np.arange(n)
        away = j[:, None] - j[None, :] - (at - (n - 1) / 2)
        sides.append(np.maximum(1 - np.abs(away), 0))
    return sides[0] @ weights @ sides[1].T
