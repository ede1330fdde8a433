"""Model of views by a picture and its disparity, with gradients of a loss."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.checks import real_array
from clplen.compute.device import Device, DeviceLike
from clplen.errors import ShapeError
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.render_operator import ViewGeometry
from clplen.types import Float32Array

_BAND = 32  # rows of the picture per work-item of a CPU


def finite_of_shape(values: Any, shape: tuple[int, ...], what: str) -> Float32Array:
    """Return finite values of a shape, float32."""
    array = real_array(values, what)
    if array.shape != shape:
        raise ShapeError(f"{what} of this model must have shape {shape}, got {array.shape}.")
    bad = array.size - int(np.count_nonzero(np.isfinite(array)))
    if bad:
        raise ValueError(f"{what} must be finite, got {bad:,} values that are NaN or infinite.")
    return array


class ViewWarp:
    """Views of a picture with a disparity for every pixel, as a differentiable model.

    View (v, u) is the picture, shifted by its disparity and interpolated linearly:

        L[v, u](y, x) = P(y + (v - vc) d_y, x + (u - uc) d),    d = d[y, x] of the centre view

    with d_y = d if views and pixels have equal spacings along y and x, as in `refocus`. Positions
    off the picture take the edge value. The model is an approximation: each view uses the
    disparities of the centre view, which is valid if they vary little over the shift of a point,
    and occlusions are ignored.

    The model is linear in the picture, not in the disparity. `vjp` gives the gradients of a loss by
    both, exact for the model as computed. At whole-pixel positions, where interpolation has a
    kink, the slope towards the next pixel is used.

    Parameters
    ----------
    lf : LightField or tuple of int
        Light field with the geometry, whose samples are not used; or the shape (v, u, y, x[, c]).
    device : Device or str, optional
        Device for a shape; default ``Device.open()``. A light field stays on its device.

    Attributes
    ----------
    shape : tuple of int
        Shape (v, u, y, x[, c]) of the light field.
    steps : numpy.ndarray
        Shifts (y, x) of the look-up in pixels at disparity 1, float64, shape (V, U, 2).
    device : Device

    Raises
    ------
    TypeError, ShapeError
        If ``lf`` is neither a light field nor a shape.
    ValueError
        If the views are directions.

    Examples
    --------
    >>> y, x = np.mgrid[:24, :32]
    >>> picture, disparity = np.sin(0.7 * x + 0.3 * y), np.full((24, 32), 0.4)
    >>> model = clplen.lightfield.ViewWarp((3, 3, 24, 32))
    >>> views = model.forward(picture, disparity)
    >>> error = model.forward(picture, disparity + 0.1).to_numpy() - views.to_numpy()
    >>> by_picture, by_disparity = model.vjp(picture, disparity + 0.1, error)  # of the loss
    >>> by_picture.shape, bool(by_disparity[4:-4, 4:-4].mean() > 0)  # sum(error**2)/2
    ((24, 32), True)
    """

    def __init__(
        self, lf: LightField | tuple[int, ...], *, device: DeviceLike | None = None
    ) -> None:
        self._geometry = ViewGeometry.of(lf, device)
        self.device: Device = self._geometry.device
        self.shape = self._geometry.shape
        self.steps = -unit_steps(self._geometry)

    def __repr__(self) -> str:
        return f"<ViewWarp of {self.shape[2:]} to {self.shape}, {self.device.name}>"

    def forward(self, picture: ArrayLike, disparity: ArrayLike) -> LightField:
        """Compute the views.

        Parameters
        ----------
        picture : Image or array_like
            Picture of shape (y, x[, c]).
        disparity : DepthMap or array_like
            Disparity of every pixel in pixels a view step, shape (y, x).

        Returns
        -------
        LightField
            Views, float32.

        Raises
        ------
        ShapeError
            If an argument has a wrong shape.
        ValueError
            If a value is not finite.
        TypeError
            If an argument is not a real array.
        DeviceError
            If the device's memory does not suffice.
        """
        data = self.forward_data(*self._uploaded(picture, disparity))
        return self._geometry.light_field(data)

    def vjp(
        self, picture: ArrayLike, disparity: ArrayLike, gradient: Any
    ) -> tuple[Float32Array, Float32Array]:
        """Compute gradients of a loss by picture and disparity from its gradient by the views.

        Parameters
        ----------
        picture, disparity
            Arguments of `forward`.
        gradient : LightField or array_like
            Gradient of the loss by every sample of the views, shape (v, u, y, x[, c]).

        Returns
        -------
        tuple of numpy.ndarray
            Gradients, float32, with the shapes of picture and disparity.

        Raises
        ------
        ShapeError, ValueError, TypeError, DeviceError
            Errors of `forward`.
        """
        arrays = self._uploaded(picture, disparity)
        views_gradient = finite_of_shape(gradient, self.shape, "The gradient of the views")
        picture_gradient, disparity_gradient = self.vjp_data(
            *arrays, self.device.upload(views_gradient)
        )
        return self.device.download(picture_gradient), self.device.download(disparity_gradient)

    def forward_data(self, picture: cla.Array, disparity: cla.Array) -> cla.Array:
        """Compute the views on the device, float32, from a picture and a finite disparity."""
        device = self.device
        device.require_memory(4 * math.prod(self.shape), "The views of this picture")
        self._require(picture, disparity)
        out = device.empty(self.shape, np.float32)
        count, ny, nx, channels = self._sizes
        device.launch_rows(
            device.kernel("warp.cl", "views", **self._form),
            (count, ny, nx),
            *(out, picture, disparity, self._steps()),
            *(np.int32(n) for n in (ny, nx, channels)),
        )
        return out

    def vjp_data(
        self, picture: cla.Array, disparity: cla.Array, gradient: cla.Array
    ) -> tuple[cla.Array, cla.Array]:
        """Compute `vjp` on the device, on C-contiguous float32 arrays."""
        self._require(picture, disparity, gradient)
        device, steps = self.device, self._steps()
        count, ny, nx, channels = self._sizes
        sizes = [np.int32(n) for n in (count, ny, nx, channels)]
        disparity_gradient = device.empty((ny, nx), np.float32)
        device.launch_rows(
            device.kernel("warp.cl", "of_disparity", **self._form),
            (ny, nx),
            *(disparity_gradient, gradient, picture, disparity, steps),
            *sizes,
        )
        picture_gradient = device.empty(self.shape[2:], np.float32)
        values = device.download(disparity)
        device.launch(
            device.kernel("warp.cl", "of_picture", **self._form),
            (-(-ny // _BAND), 1) if device.rows else (nx * channels, ny),
            *(picture_gradient, gradient, disparity, steps),
            *sizes,
            *(np.float32(n) for n in (values.min(), values.max())),
            np.int32(_BAND),
        )
        return picture_gradient, disparity_gradient

    @property
    def _sizes(self) -> tuple[int, int, int, int]:
        """Sizes (views, ny, nx, channels)."""
        V, U, ny, nx, channels = (*self.shape, 1)[:5]
        return V * U, ny, nx, channels

    @property
    def _form(self) -> dict[str, int]:
        channels = self._sizes[3]
        return {"CHANNELS": channels} if channels in (1, 3) else {}

    def _steps(self) -> cla.Array:
        return self.device.upload(self.steps.reshape(-1, 2).astype(np.float32))

    def _uploaded(self, picture: Any, disparity: Any) -> tuple[cla.Array, cla.Array]:
        return (
            self.device.upload(finite_of_shape(picture, self.shape[2:], "The picture")),
            self.device.upload(finite_of_shape(disparity, self.shape[2:4], "The disparity")),
        )

    def _require(self, *arrays: cla.Array) -> None:
        """Reject device arrays that are not (picture, disparity[, gradient])."""
        shapes = (self.shape[2:], self.shape[2:4], self.shape)
        for array, shape in zip(arrays, shapes, strict=False):
            if tuple(array.shape) != shape or array.dtype != np.float32:
                raise ShapeError(
                    f"{type(self).__name__} must get a float32 array of shape {shape}, got "
                    f"{tuple(array.shape)} ({array.dtype})."
                )
