"""Refocusing: shift every view by its constant and average, one plane or many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.image import Image
from clplen.lightfield.aperture import Weights
from clplen.lightfield.magnify import magnify
from clplen.lightfield.raw import CameraModel, Spacing
from clplen.lightfield.render import view_weights
from clplen.lightfield.shear import shear_sum

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clplen.lightfield.lightfield import LightField

Vector = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class FocalStack:
    """Refocused pictures of one light field, registered to its centre view.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (n, y, x) or (n, y, x, c).
    device : Device
    disparities : numpy.ndarray
        float64, shape (n,): pixels a view step along x.
    alphas : numpy.ndarray
        float64, shape (n,): alpha = F/F' of each plane; NaN without spacing.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) of the light field, in metres.
    camera : CameraModel or None
        The camera that took it, when known.
    weights : numpy.ndarray or None
        Of the views that were averaged, float32, shape (V, U); None when not known.
    """

    data: cla.Array
    device: Device
    disparities: Vector
    alphas: Vector
    spacing: Spacing | None = None
    camera: CameraModel | None = None
    weights: Weights | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """(n, y, x[, c])."""
        return tuple(int(n) for n in self.data.shape)

    def to_numpy(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """The pictures on the host, float32, shape (n, y, x[, c])."""
        return self.device.download(self.data)


def refocus(
    lf: LightField,
    *,
    alpha: float | None = None,
    disparity: float | None = None,
    rescale: bool = False,
) -> Image:
    """The picture focused on another plane.

    The weighted mean over the views of

        L[v, u](y - (v - vc) d_y, x - (u - uc) d),    vc = (V - 1)/2, uc = (U - 1)/2

    interpolated linearly (Ng 2005, shift and add, in constant shifts a view); a sample outside a
    view counts neither in the sum nor in the weights. d_y = d where views and pixels are spaced
    alike along y and x, else in proportion to their signed spacings, d (dv/dy)/(du/dx).

    Parameters
    ----------
    lf : LightField
    alpha : float, optional
        F/F', above 1 for planes farther than the one in focus; needs ``lf.spacing``.
    disparity : float, optional
        d in pixels a view step along x, positive for nearer planes. Exactly one of the two.
    rescale : bool
        The picture as it is on the synthetic plane, where it has another size: alpha^2 R(alpha x')
        about the middle of the picture R, 0 outside; the Jacobian alpha^2 keeps its sum (thesis,
        eq. 3.7). Needs ``lf.spacing``. Views of naive cells are directions, so that R is that
        picture already.

    Returns
    -------
    Image
        float32, shape (y, x[, c]).

    Raises
    ------
    ValueError
        If both or neither of alpha and disparity are given, the value is not finite or alpha is
        not positive, or what alpha needs is not known.
    """
    given = _one_of(alpha=alpha, disparity=disparity)
    if np.ndim(given) != 0:
        raise ValueError("refocus makes one picture: give one number, or use focal_stack.")
    disparities, alphas = _planes(lf, np.reshape(given, 1), alpha is not None)
    if rescale and not alphas[0] > 0:
        raise ValueError(
            "rescale=True needs a positive alpha = F/F', and so the spacing of views and pixels in "
            f"metres; here alpha is {alphas[0]}."
        )
    picture = _sheared(lf, disparities, lf.weights).reshape(lf.shape[2:])
    if rescale and lf.decode != "naive":
        picture = magnify(picture, float(alphas[0]), device=lf.device)
    return Image(picture, lf.device)


def focal_stack(
    lf: LightField,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    aperture: Any = None,
) -> FocalStack:
    """Pictures focused on many planes, in one pass over the light field.

    Every plane is what `refocus` returns for it (without rescaling).

    Parameters
    ----------
    lf : LightField
    alphas, disparities : array_like, optional
        Shape (n,), in any order; exactly one of the two.
    aperture : int, float, str or array_like, optional
        As in `LightField.render`.

    Returns
    -------
    FocalStack
        float32, shape (n, y, x[, c]).

    Raises
    ------
    ValueError
        If both or neither of alphas and disparities are given, or they are no finite numbers in
        one dimension, or the aperture does not fit.
    DeviceError
        If the stack and the light field together are larger than the device's memory.
    """
    given = np.asarray(_one_of(alphas=alphas, disparities=disparities), np.float64)
    if given.ndim != 1 or given.size == 0:
        raise ValueError(
            f"A focal stack takes a list of at least one plane, not shape {given.shape}."
        )
    planes, ratios = _planes(lf, given, alphas is not None)
    weights = view_weights(lf, aperture, None)
    stack = 4 * planes.size * int(np.prod(lf.shape[2:], dtype=np.int64))
    lf.device.require_memory(stack + lf.data.nbytes, "This focal stack with its light field")
    data = _sheared(lf, planes, weights)
    return FocalStack(data, lf.device, planes, ratios, lf.spacing, lf.camera, weights)


def shifts(lf: LightField, disparities: Vector) -> tuple[Vector, Vector]:
    """`view_shifts` of a light field."""
    return view_shifts(lf.spacing, lf.weights.shape, disparities)


def view_shifts(
    spacing: Spacing | None, views: tuple[int, ...], disparities: Vector
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

    Returns
    -------
    tuple of numpy.ndarray
        Along y, shape (n, V), and along x, shape (n, U); float64. The sample of view (v, u) that
        belongs to (y, x) is the one at y + along_y[v], x + along_x[u].
    """
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    along_y = np.outer(disparities * _row_ratio(spacing), -v)
    return along_y, np.outer(disparities, -u)


def _row_ratio(spacing: Spacing | None) -> float:
    """Disparity along y of a plane of disparity 1 along x: (dv/dy)/(du/dx), 1 if not known.

    Views of a telecentric camera are directions, without a spacing in metres: taken as equal.
    """
    if spacing is None:
        return 1.0
    dv, du, dy, dx = spacing
    return (dv / du if np.isfinite([dv, du]).all() else 1.0) * dx / dy


def _one_of(**given: Any) -> Any:
    """The one that is given of two options."""
    values = [value for value in given.values() if value is not None]
    if len(values) != 1:
        first, second = given
        found = "both were" if values else "neither was"
        raise ValueError(f"Give exactly one of {first} and {second}; {found} given.")
    return values[0]


def _planes(lf: LightField, given: Any, are_alphas: bool) -> tuple[Vector, Vector]:
    """(disparities, alphas) of planes given as one of them."""
    values = np.asarray(given, np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"Planes are finite numbers, not {given!r}.")
    if are_alphas:
        return lf.disparity(values), values
    return values, lf.alpha(values)


def _sheared(lf: LightField, disparities: Vector, weights: Any) -> cla.Array:
    return shear_sum(lf.data, weights, *shifts(lf, disparities), device=lf.device)
