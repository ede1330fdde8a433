"""Refocusing as a linear map of the light field."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.compute.device import DeviceLike
from clplen.lightfield.arrays.linear_step import LinearStep
from clplen.lightfield.arrays.shear import shear_sum
from clplen.lightfield.arrays.shear_adjoint import shear_adjoint
from clplen.lightfield.model.alpha_law import shifts
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.render_operator import ViewGeometry
from clplen.lightfield.model.rendering import view_weights
from clplen.lightfield.raw.raw_image import is_telecentric
from clplen.lightfield.refocusing.focal_stacks import FocalStack, require_alphas, stack_planes
from clplen.lightfield.refocusing.magnification import magnify, magnify_adjoint


class StackOperator(LinearStep):
    """Refocusing by `focal_stack` as a linear map, with its adjoint.

    The forward map equals ``focal_stack(lf, disparities=..., aperture=...)`` with linear
    interpolation bit by bit, edges included: a picture is the mean of the samples inside their
    views. The adjoint divides every picture by the weights of these samples; each view is the sum
    of the pictures shifted back. One plane is `refocus`.

    Parameters
    ----------
    lf : LightField or tuple of int
        Light field with the geometry and the weights, whose samples are not used; or the shape
        (v, u, y, x[, c]) of views of weight 1. Views of weight 0, the default for black views in
        `LightField.from_array`, are not used, and their adjoint is 0.
    disparities, alphas : array_like
        Planes, see `focal_stack`; exactly one of the two.
    aperture : optional
        Aperture, see `LightField.render`.
    rescale : bool
        True to return pictures on their synthetic planes, see `refocus`.
    device : Device or str, optional
        Device for a shape; default ``Device.open()``. A light field stays on its device.

    Attributes
    ----------
    disparities, alphas : numpy.ndarray
        Planes, float64, shape (n,).
    weights : numpy.ndarray
        Weights of the views, float32, shape (V, U).
    in_shape, out_shape : tuple of int
        Shapes (v, u, y, x[, c]) and (n, y, x[, c]).
    device : Device

    Raises
    ------
    ValueError, ShapeError, TypeError
        Errors of `focal_stack`, or an invalid ``lf``.

    Examples
    --------
    >>> views = np.random.default_rng(0).random((5, 5, 24, 32), np.float32)
    >>> lf = clplen.LightField.from_array(views)
    >>> refocusing = clplen.lightfield.StackOperator(lf, disparities=[-0.5, 0, 1])
    >>> refocusing.in_shape, refocusing.out_shape
    ((5, 5, 24, 32), (3, 24, 32))
    >>> stack = refocusing.forward(lf)
    >>> back = refocusing.adjoint(stack)  # a light field
    >>> power = np.vdot(stack.to_numpy(), stack.to_numpy())
    >>> bool(np.isclose(np.vdot(views, back.to_numpy()), power, rtol=1e-5))
    True
    """

    _operand_types = (LightField, FocalStack)

    def __init__(
        self,
        lf: LightField | tuple[int, ...],
        *,
        disparities: ArrayLike | None = None,
        alphas: ArrayLike | None = None,
        aperture: Any = None,
        rescale: bool = False,
        device: DeviceLike | None = None,
    ) -> None:
        self._geometry = ViewGeometry.of(lf, device)
        self.device = self._geometry.device
        self.disparities, self.alphas = stack_planes(
            self._geometry, None, alphas=alphas, disparities=disparities
        )
        self.weights = view_weights(self._geometry, aperture, None)
        self.in_shape = self._geometry.shape
        self.out_shape = (self.disparities.size, *self.in_shape[2:])
        self._shifts = shifts(self._geometry, self.disparities)
        self._resize = rescale and not is_telecentric(self._geometry)
        if self._resize:
            require_alphas(self.alphas)
        self._resize = self._resize and self._geometry.decode != "naive"

    def _details(self) -> str:
        d = self.disparities
        resized = ", rescaled" if self._resize else ""
        return f", disparities {d.min():g} to {d.max():g}{resized}"

    def _resized(self, pictures: cla.Array, change: Callable[..., cla.Array]) -> cla.Array:
        """Magnify every picture, or apply the adjoint; unchanged without ``rescale``."""
        if not self._resize:
            return pictures
        out = self.device.empty(pictures.shape, np.float32)
        for index, alpha in enumerate(self.alphas):
            plane = pictures[index].copy(queue=self.device.queue)
            picture = change(plane, float(alpha), device=self.device)
            self.device.copy_into(out, picture, index * int(picture.nbytes))
        return out

    def _forward(self, data: cla.Array) -> cla.Array:
        stack = shear_sum(data, self.weights, *self._shifts, device=self.device)
        return self._resized(stack, magnify)

    def _adjoint(self, data: cla.Array) -> cla.Array:
        stack = self._resized(data, magnify_adjoint)
        return shear_adjoint(stack, self.in_shape, self.weights, *self._shifts, device=self.device)

    def _wrap(self, data: cla.Array, adjoint: bool) -> Any:
        geometry = self._geometry
        if adjoint:
            return geometry.light_field(data)
        weights = np.asarray(self.weights, np.float32)
        return FocalStack(
            data, self.device, self.disparities, self.alphas, geometry.spacing, geometry.camera,
            weights, geometry.positions,
        )  # fmt: skip
