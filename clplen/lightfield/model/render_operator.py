"""Rendering as a linear map, and the geometry of its light field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import is_array, is_integer
from clplen.compute.arrays import Image
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.lightfield.arrays.linear_step import LinearStep
from clplen.lightfield.arrays.shear_adjoint import shear_adjoint
from clplen.lightfield.model.alpha_law import AlphaLaw
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import render_weights, sum_of_views
from clplen.lightfield.model.sample_checks import check_shape
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import CameraModel, Spacing


@dataclass(frozen=True, eq=False)
class ViewGeometry(AlphaLaw):
    """A light field without its samples; attributes as in `LightField`."""

    shape: tuple[int, ...]
    device: Device
    spacing: Spacing | None
    weights: np.ndarray[Any, np.dtype[np.float32]]
    camera: CameraModel | None = None
    positions: np.ndarray[Any, np.dtype[np.float64]] | None = None
    decode: str = "calibrated"
    parametrisation: str = "two-plane"

    @classmethod
    def of(cls, lf: Any, device: DeviceLike | None) -> ViewGeometry:
        """Return the geometry of a light field, or of a shape (views on a grid, weight 1)."""
        if is_array(lf) and not isinstance(lf, LightField | tuple | list):
            lf = as_lightfield(lf, device=device)
        if isinstance(lf, LightField):
            return cls(
                lf.shape, lf.device, lf.spacing, lf.weights, lf.camera, lf.positions, lf.decode,
                lf.parametrisation,
            )  # fmt: skip
        if not isinstance(lf, tuple | list) or not all(is_integer(n) and n >= 0 for n in lf):
            raise TypeError(
                "lf must be a LightField, an array or a shape (v, u, y, x[, c]), got "
                f"{type(lf).__name__}."
            )
        shape = tuple(int(n) for n in lf)
        check_shape(shape)
        return cls(shape, as_device(device), None, np.ones(shape[:2], np.float32))

    def light_field(self, data: cla.Array) -> LightField:
        """Wrap samples on the device as a light field of this geometry."""
        return LightField(
            data, self.device, self.spacing, self.weights, self.camera, decode=self.decode,
            positions=self.positions, parametrisation=self.parametrisation,
        )  # fmt: skip


class RenderOperator(LinearStep):
    """Rendering by `LightField.render` as a linear map, with its adjoint.

    The picture is sum_vu w[v, u] L[v, u] with weights of sum 1. The adjoint spreads it to the
    views, w[v, u] times the picture each. ``viewpoint`` alone is `LightField.view`.

    Parameters
    ----------
    lf : LightField or tuple of int
        Light field with the geometry and the weights, whose samples are not used; or the shape
        (v, u, y, x[, c]) of views of weight 1.
    aperture, viewpoint : optional
        Arguments of `LightField.render`.
    total : bool
        True to skip the division of w by its sum, see `LightField.render`.
    device : Device or str, optional
        Device for a shape; default ``Device.open()``. A light field stays on its device.

    Attributes
    ----------
    weights : numpy.ndarray
        Weights w, float64, shape (V, U).
    in_shape, out_shape : tuple of int
        Shapes (v, u, y, x[, c]) and (y, x[, c]).
    device : Device

    Raises
    ------
    ValueError, ShapeError, TypeError
        Errors of `LightField.render`, or an invalid ``lf``.

    Examples
    --------
    >>> between = clplen.lightfield.RenderOperator((3, 3, 16, 24), viewpoint=(1, 0.5))
    >>> between.weights[1].tolist()
    [0.5, 0.5, 0.0]
    >>> views = between.adjoint(np.ones((16, 24)))
    >>> views.shape, float(views.sum())
    ((3, 3, 16, 24), 384.0)
    """

    _operand_types = (LightField, Image)

    def __init__(
        self,
        lf: LightField | tuple[int, ...],
        *,
        aperture: Any = None,
        viewpoint: tuple[float, float] | None = None,
        total: bool = False,
        device: DeviceLike | None = None,
    ) -> None:
        self._geometry = ViewGeometry.of(lf, device)
        self.device = self._geometry.device
        self.in_shape = self._geometry.shape
        self.out_shape = self.in_shape[2:]
        self.weights = np.asarray(
            render_weights(self._geometry, aperture, viewpoint, total), np.float64
        )

    def _details(self) -> str:
        return f", {np.count_nonzero(self.weights)} views of weight {self.weights.sum():g}"

    def _forward(self, data: cla.Array) -> cla.Array:
        return sum_of_views(data, self.weights, device=self.device)

    def _adjoint(self, data: cla.Array) -> cla.Array:
        no_shifts = [np.zeros((1, n)) for n in self.weights.shape]
        return shear_adjoint(
            data.reshape((1, *self.out_shape)), self.in_shape, self.weights, *no_shifts,
            device=self.device, total=True,
        )  # fmt: skip

    def _wrap(self, data: cla.Array, adjoint: bool) -> Any:
        return self._geometry.light_field(data) if adjoint else Image(data, self.device)
