"""Where the views see what lies on a plane."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.model.parametrisation import require_two_plane

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.stored_light_field import StoredLightField
    from clplen.lightfield.raw.raw_image import Spacing



def shifts(lf: LightField | StoredLightField, disparities: Vector) -> tuple[Vector, Vector]:
    """`view_shifts` of a light field; a ValueError where its views are directions."""
    require_two_plane(lf, "Focusing")
    return view_shifts(lf.spacing, lf.weights.shape, disparities, positions=lf.positions)


def view_shifts(
    spacing: Spacing | None,
    views: tuple[int, ...],
    disparities: Vector,
    *,
    positions: Vector | None = None,
) -> tuple[Vector, Vector]:
    """How far a point on each plane lies from its place in the centre view, in pixels.

    Parameters
    ----------
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) of the light field, in metres.
    views : tuple of int
        (V, U).
    disparities : numpy.ndarray
        Shape (n,), pixels a view step along x.
    positions : numpy.ndarray, optional
        Of the views, shape (V, U, 2), as in `LightField`.

    Returns
    -------
    tuple of numpy.ndarray
        Along y, shape (n, V), and along x, shape (n, U); with positions, both (n, V, U); float64.
        The sample of view (v, u) that belongs to (y, x) is the one at y + along_y[v] (or
        along_y[v, u]), x + along_x[u].
    """
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    if positions is not None:
        v, u = np.moveaxis(positions, -1, 0)
    along_y = np.multiply.outer(disparities * row_ratio(spacing), -v)
    return along_y, np.multiply.outer(disparities, -u)


def row_ratio(spacing: Spacing | None) -> float:
    """Disparity along y of a plane of disparity 1 along x: (dv/dy)/(du/dx), 1 if not known.

    Views of a telecentric camera are directions, without a spacing in metres: taken as equal.
    """
    if spacing is None:
        return 1.0
    dv, du, dy, dx = spacing
    return (dv / du if np.isfinite([dv, du]).all() else 1.0) * dx / dy


def unit_steps(lf: LightField | StoredLightField) -> Vector:
    """Pixels (y, x) from a point's place in the centre view to its sample in each, for d = 1.

    Parameters
    ----------
    lf : LightField

    Returns
    -------
    numpy.ndarray
        float64, shape (V, U, 2).
    """
    down, right = (along[0] for along in shifts(lf, np.ones(1)))
    if lf.positions is None:
        down, right = np.broadcast_arrays(down[:, None], right[None, :])
    return np.stack((down, right), axis=-1)
