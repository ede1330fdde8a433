"""Slices of a light field with their axes in metres and radians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from clplen.compute.arrays import HostArray
from clplen.compute.device import DeviceLike
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import is_telecentric
from clplen.reprs import OneLine
from clplen.results import Plottable

Vector = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, repr=False)
class PhaseSpace(OneLine, Plottable, HostArray):
    """Epipolar slice: position on the image plane against position on the main lens.

    A point is a line of slope dx/du = 1 - alpha over metres (thesis, section 1.4.2), of slope -d
    over pixels and views, and of slope F - F' over x and theta.

    Attributes
    ----------
    values : numpy.ndarray
        Samples, float32, shape (views, pixels[, c]).
    axes : tuple of str
        Names ("u", "x") or ("v", "y"); ("theta_x", "x") or ("theta_y", "y") for a light field by
        direction.
    units : tuple of str
        Units of direction and position: ("m", "m"), ("rad", "m"), or ("view", "pixel").
    direction : numpy.ndarray
        Coordinate u (v, theta) of the views from the middle, shape (views,).
    position : numpy.ndarray
        Coordinate x (y) of the pixels from the middle, shape (pixels,).
    theta : numpy.ndarray or None
        Angle (x - u)/F of every sample in radians, shape (views, pixels); -u/F for a telecentric
        camera, with F the focal length of the tube lens and M^2 z/n the slope dx/dtheta of a point.
        None without a camera.

    Examples
    --------
    >>> L = np.random.default_rng(1).random((5, 5, 16, 20), np.float32)
    >>> slice_ = clplen.lightfield.phase_space(L, y=8, v=2)
    >>> slice_.values.shape, slice_.axes
    ((5, 20), ('u', 'x'))
    """

    _figure: ClassVar[str] = "epi"
    _samples: ClassVar[str] = "values"

    values: np.ndarray[Any, np.dtype[np.float32]]
    axes: tuple[str, str]
    units: tuple[str, str]
    direction: Vector
    position: Vector
    theta: Vector | None


def phase_space(
    lf: LightField | ArrayLike,
    *,
    y: int | None = None,
    x: int | None = None,
    v: int | None = None,
    u: int | None = None,
    device: DeviceLike | None = None,
) -> PhaseSpace:
    """Return `LightField.epi` with its axes.

    Parameters
    ----------
    lf : LightField or array_like
        Light field. With ``spacing`` the axes are in metres, signed; with a ``camera`` the angles
        of the rays are included.
    y, x, v, u : int, optional
        Indices: y and v, the row of pixels and views, for (u, x); or x and u, the column of both,
        for (v, y).
    device : Device or str, optional
        Device for an array; default ``Device.open()``. A light field stays on its device.

    Returns
    -------
    PhaseSpace
        The slice with its axes.

    Raises
    ------
    ValueError
        If no such pair of indices is set, an index lies outside the light field, or the light field
        has positions, whose rows are no rows on the lens.

    Examples
    --------
    >>> L = np.random.default_rng(1).random((5, 5, 16, 20), np.float32)
    >>> clplen.lightfield.phase_space(L, y=8, v=2).values.shape
    (5, 20)
    """
    lf = as_lightfield(lf, device=device)
    if lf.positions is not None:
        raise ValueError(
            "A phase space needs views on a regular grid, and this light field has positions; use "
            "LightField.epi for the samples alone."
        )
    values = lf.epi(y=y, x=x, v=v, u=u).to_numpy()
    along_x = y is not None
    metres = lf.spacing is not None and bool(np.isfinite(lf.spacing).all())
    steps = (1.0, 1.0)
    if metres and lf.spacing is not None:
        steps = lf.spacing[1::2] if along_x else lf.spacing[0::2]
    direction, position = (
        (np.arange(n) - (n - 1) / 2) * step for n, step in zip(values.shape[:2], steps, strict=True)
    )
    axes = ("u", "x") if along_x else ("v", "y")
    if lf.parametrisation == "point-angle":
        theta = np.broadcast_to(direction[:, None], values.shape[:2])
        axes = (f"theta_{axes[1]}", axes[1])
        return PhaseSpace(values, axes, ("rad", "m"), direction, position, theta)
    units = ("m", "m") if metres else ("view", "pixel")
    return PhaseSpace(values, axes, units, direction, position, _angles(lf, direction, position))


def _angles(lf: LightField, direction: Vector, position: Vector) -> Vector | None:
    has_spacing = lf.spacing is not None and bool(np.isfinite(lf.spacing).all())
    if not has_spacing or lf.camera is None or lf.decode == "naive":
        return None
    image_position = 0 * position if is_telecentric(lf) else position
    return np.asarray((image_position[None, :] - direction[:, None]) / lf.camera.image_distance)
