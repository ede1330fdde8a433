"""Views from a picture and its disparity, and the gradients of a loss through them."""

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

_BAND = 32  # rows of the picture that a CPU's work-item gathers


def finite_of_shape(values: Any, shape: tuple[int, ...], what: str) -> Float32Array:
    """Finite values of a shape, float32."""
    array = real_array(values, what)
    if array.shape != shape:
        raise ShapeError(f"{what} of this model has shape {shape}, not {array.shape}.")
    bad = array.size - int(np.count_nonzero(np.isfinite(array)))
    if bad:
        raise ValueError(f"{what} has {bad:,} values that are NaN or infinite: replace them.")
    return array


class ViewWarp:
    """The views of a picture, by a disparity of every pixel: a model of a light field.

    View (v, u) is the picture, moved by its own disparity and interpolated linearly:

        L[v, u](y, x) = P(y + (v - vc) d_y, x + (u - uc) d),    d = d[y, x] of the centre view

    with d_y = d where views and pixels are spaced alike along y and x, as of `refocus`. Positions
    off the picture are those of its edge. It is an approximation: each view is looked up with the
    disparities of the centre view, which is right where these change little over the distance
    that a point moves, and knows nothing of what hides what.

    The model is linear in the picture, not in the disparity. `vjp` gives the gradients of a loss
    with respect to both, exact for the model as it is computed; where a position is a whole pixel,
    and interpolation has a kink, the slope towards the next pixel is taken.

    Parameters
    ----------
    lf : LightField or tuple of int
        Whose geometry is taken, not its samples; or the shape (v, u, y, x[, c]).
    device : Device or str, optional
        Where a shape is computed; default ``Device.open()``. A light field brings its own.

    Attributes
    ----------
    shape : tuple of int
        (v, u, y, x[, c]) of the light field.
    steps : numpy.ndarray
        float64, shape (V, U, 2): pixels (y, x) by which disparity 1 moves the look-up.
    device : Device

    Raises
    ------
    TypeError, ShapeError
        If it is made of something else.
    ValueError
        If the views are directions.

    Examples
    --------
    >>> y, x = np.mgrid[:24, :32]
    >>> picture, disparity = np.sin(0.7 * x + 0.3 * y), np.full((24, 32), 0.4)
    >>> model = clplen.lightfield.ViewWarp((3, 3, 24, 32))
    >>> views = model.forward(picture, disparity)
    >>> error = model.forward(picture, disparity + 0.1).to_numpy() - views.to_numpy()
    >>> of_picture, of_disparity = model.vjp(picture, disparity + 0.1, error)  # of the loss
    >>> of_picture.shape, bool(of_disparity[4:-4, 4:-4].mean() > 0)  # sum(error**2)/2
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
        """The views.

        Parameters
        ----------
        picture : Image or array_like
            Shape (y, x[, c]).
        disparity : DepthMap or array_like
            Pixels a view step, of every pixel, shape (y, x).

        Returns
        -------
        LightField
            float32.

        Raises
        ------
        ShapeError
            If they have other shapes.
        ValueError
            If a value is not finite.
        TypeError
            If they are no arrays of real numbers.
        DeviceError
            If the memory of the device does not suffice.
        """
        data = self.forward_data(*self._uploaded(picture, disparity))
        return self._geometry.light_field(data)

    def vjp(
        self, picture: ArrayLike, disparity: ArrayLike, gradient: Any
    ) -> tuple[Float32Array, Float32Array]:
        """Gradients of a loss with respect to picture and disparity, by that of the views.

        Parameters
        ----------
        picture, disparity
            As given to `forward`.
        gradient : LightField or array_like
            Of the loss with respect to every sample of the views, shape (v, u, y, x[, c]).

        Returns
        -------
        tuple of numpy.ndarray
            float32, of the picture's shape and of the disparity's.

        Raises
        ------
        ShapeError, ValueError, TypeError, DeviceError
            As `forward`.
        """
        given = self._uploaded(picture, disparity)
        of_views = finite_of_shape(gradient, self.shape, "The gradient of the views")
        of_picture, of_disparity = self.vjp_data(*given, self.device.upload(of_views))
        return self.device.download(of_picture), self.device.download(of_disparity)

    def forward_data(self, picture: cla.Array, disparity: cla.Array) -> cla.Array:
        """The views on the device, float32, of a picture and a finite disparity there."""
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
        """`vjp` on the device, of C-contiguous float32 arrays."""
        self._require(picture, disparity, gradient)
        device, steps = self.device, self._steps()
        count, ny, nx, channels = self._sizes
        sizes = [np.int32(n) for n in (count, ny, nx, channels)]
        of_disparity = device.empty((ny, nx), np.float32)
        device.launch_rows(
            device.kernel("warp.cl", "of_disparity", **self._form),
            (ny, nx),
            *(of_disparity, gradient, picture, disparity, steps),
            *sizes,
        )
        of_picture = device.empty(self.shape[2:], np.float32)
        values = device.download(disparity)
        device.launch(
            device.kernel("warp.cl", "of_picture", **self._form),
            (-(-ny // _BAND), 1) if device.rows else (nx * channels, ny),
            *(of_picture, gradient, disparity, steps),
            *sizes,
            *(np.float32(n) for n in (values.min(), values.max())),
            np.int32(_BAND),
        )
        return of_picture, of_disparity

    @property
    def _sizes(self) -> tuple[int, int, int, int]:
        """(views, ny, nx, channels)."""
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
        """Refuse arrays of the device that are not (picture, disparity[, gradient])."""
        wanted = (self.shape[2:], self.shape[2:4], self.shape)
        for array, shape in zip(arrays, wanted, strict=False):
            if tuple(array.shape) != shape or array.dtype != np.float32:
                raise ShapeError(
                    f"{type(self).__name__} takes float32 arrays of shape {shape} here, not "
                    f"{tuple(array.shape)} ({array.dtype})."
                )
