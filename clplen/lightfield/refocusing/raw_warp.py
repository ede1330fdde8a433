"""Model of a raw image by a picture and its disparity, with gradients of a loss."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.checks import require
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.lightfield.model.alpha_law import row_ratio
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.view_warp import finite_of_shape
from clplen.types import Float32Array

_BAND = 32  # rows of the picture per work-item of a CPU
_ON_DEVICE = ("_tables", "_steps")  # attributes that are not copied with a model
_TIE = 1e-9  # pixels or lenslets: tolerance of ties, which go to the later lenslet

Values = np.ndarray[Any, Any]


class RawWarp:
    """Raw image of a picture with a disparity for every pixel, as a differentiable model.

    A raw pixel belongs to the lenslet with the nearest sub-image centre (the later one of two). It
    sees the picture through this lenslet from a viewpoint (v, u), given by its position in the
    sub-image in view steps from the centre, usually between views:

        raw = white P(y + v d_y, x + u d),    d = D(y, x),

    with (y, x) the position of the lenslet on the picture, P the picture and D its disparity, both
    interpolated linearly. The loss compares unresampled raw pixels, whose noise is independent.
    Approximations and gradients are those of `ViewWarp`; light that reaches a sub-image from
    another lenslet is ignored as well.

    Parameters
    ----------
    raw : RawImage
        Raw image with the lattice, grey, without colour filters; its pixels are not used.
    white : array_like, optional
        Value of every raw pixel for brightness 1, such as a white image, shape (ny, nx); default 1.

    Attributes
    ----------
    shape : tuple of int
        Shape (ny, nx) of the raw image.
    picture_shape : tuple of int
        Shape (y, x) of picture and disparity, equal to that of the light field.
    used : numpy.ndarray
        Mask of the raw pixels that belong to a lenslet, bool, shape (ny, nx); others are 0.
    device : Device

    Raises
    ------
    TypeError
        If ``raw`` is not a RawImage.
    ShapeError
        If the image has colours, or the white image has another shape.
    ValueError
        If the raw image has colour filters, or the white image includes NaN or infinity.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(150e-6, 10e-3, count=12, fill="full", rotation=0.02)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=mla, wavelength=532e-9, pixels_per_lenslet=5.3)
    >>> wall = clplen.cameras.Plane(0.4, texture=clplen.cameras.noise(1, 16))
    >>> raw = camera.expose(clplen.SurfaceScene(wall), model="rays")
    >>> model = clplen.lightfield.RawWarp(raw)
    >>> picture, disparity = np.ones(model.picture_shape), np.full(model.picture_shape, 0.3)
    >>> error = model.forward(picture, disparity).to_numpy() - raw.to_numpy()
    >>> by_picture, by_disparity = model.vjp(picture, disparity, error)  # of sum(error**2)/2
    >>> raw.shape, by_picture.shape
    ((64, 64), (12, 12))
    """

    def __init__(self, raw: RawImage, *, white: ArrayLike | None = None) -> None:
        require(RawImage, raw, "raw", "camera.expose or the raw of a decoded light field")
        if raw.mosaic is not None or len(raw.data.shape) != 2:
            kind = ValueError if raw.mosaic is not None else ShapeError
            raise kind(
                "RawWarp needs a grey raw image without colour filters, got a colour one; "
                "pass the pixels of one colour."
            )
        self.device: Device = raw.device
        self.shape: tuple[int, int] = raw.shape
        self.picture_shape: tuple[int, int] = raw.sub_images.shape[2:]
        white_values = np.ones(self.shape) if white is None else white
        level = finite_of_shape(white_values, self.shape, "The white image")
        self._raw, self._exchanged = raw, raw.sub_images.exchanged
        self._pixels = _lenslet_pixels(raw.sub_images, self.shape, row_ratio(raw.spacing))
        self._columns = _columns(raw.sub_images)
        self.used: np.ndarray[Any, np.dtype[np.bool_]] = np.zeros(self.shape, bool)
        index = self._pixels.index
        self.used.ravel()[index[index >= 0]] = True
        self._white = level
        self._tables = self._uploaded()

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without device tables, which are rebuilt."""
        return {key: value for key, value in self.__dict__.items() if key not in _ON_DEVICE}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self._tables = self._uploaded()

    def __repr__(self) -> str:
        return f"<RawWarp of {self.picture_shape} to {self.shape}, {self.device.name}>"

    def forward(self, picture: ArrayLike, disparity: ArrayLike) -> RawImage:
        """Compute the raw image.

        Parameters
        ----------
        picture : Image or array_like
            Picture of shape ``picture_shape``.
        disparity : DepthMap or array_like
            Disparity of every pixel in pixels a view step, shape ``picture_shape``.

        Returns
        -------
        RawImage
            Raw image, float32, with the given lattice.

        Raises
        ------
        ShapeError, ValueError, TypeError, DeviceError
            Errors of `ViewWarp.forward`.
        """
        grid_picture, lenslet_disparity = self._of_grid(picture, disparity)
        raw = self.device.zeros(self.shape, np.float32)
        self._launch(
            "views",
            self._pixels.index.shape,
            raw,
            *self._sent(grid_picture, lenslet_disparity),
            self._steps,
        )
        return replace(self._raw, data=raw, levels=None, exposure=None, truth=None)

    def vjp(
        self, picture: ArrayLike, disparity: ArrayLike, gradient: Any
    ) -> tuple[Float32Array, Float32Array]:
        """Compute gradients of a loss by picture and disparity from its gradient by the raw image.

        Parameters
        ----------
        picture, disparity
            Arguments of `forward`.
        gradient : RawImage or array_like
            Gradient of the loss by every raw pixel, shape ``shape``; pixels of no lenslet are
            ignored.

        Returns
        -------
        tuple of numpy.ndarray
            Gradients, float32, both of shape ``picture_shape``.

        Raises
        ------
        ShapeError, ValueError, TypeError, DeviceError
            Errors of `forward`.
        """
        grid_picture, lenslet_disparity = self._of_grid(picture, disparity)
        g = self.device.upload(
            finite_of_shape(gradient, self.shape, "The gradient of the raw image")
        )
        P, d = self._sent(grid_picture, lenslet_disparity)
        lenslet_gradient = self.device.empty(lenslet_disparity.shape, np.float32)
        count = np.int32(len(self._pixels.steps))
        self._launch(
            "of_disparity", lenslet_disparity.shape, lenslet_gradient, g, P, d, self._steps, count
        )
        picture_gradient = self.device.empty(grid_picture.shape, np.float32)
        self._launch_back(picture_gradient, g, d, count, lenslet_disparity)
        disparity_gradient = self._columns.spread(self.device.download(lenslet_gradient))
        gradients = self.device.download(picture_gradient), disparity_gradient.astype(np.float32)
        first, second = (np.ascontiguousarray(a.T) if self._exchanged else a for a in gradients)
        return first, second

    def _of_grid(self, picture: Any, disparity: Any) -> tuple[Float32Array, Float32Array]:
        """Return the picture on the grid and the disparity of every lenslet."""
        pictures = (
            finite_of_shape(values, self.picture_shape, what)
            for values, what in ((picture, "The picture"), (disparity, "The disparity"))
        )
        grid_picture, d = (a.T if self._exchanged else a for a in pictures)
        return np.ascontiguousarray(grid_picture), self._columns.gather(d).astype(np.float32)

    def _uploaded(self) -> tuple[Any, ...]:
        """Upload the tables of the pixels, as kernel arguments."""
        pixels, device = self._pixels, self.device
        need = 4 * (pixels.index.size + 3 * self._white.size)
        device.require_memory(need, "The pixels of these lenslets")
        self._steps = device.upload(pixels.steps.astype(np.float32))
        return (
            device.upload(pixels.index),
            device.upload(self._white),
            device.upload(pixels.lenslet_steps.astype(np.float32)),
            device.upload(self._columns.pixels.astype(np.int32)),
            device.upload(self._columns.fractions.astype(np.float32)),
            np.int32(self._columns.count),
        )

    def _sent(self, *arrays: Any) -> tuple[cla.Array, ...]:
        return tuple(self.device.upload(a) for a in arrays)

    def _launch(self, name: str, shape: tuple[int, ...], *arguments: Any) -> None:
        ny, nx = (np.int32(n) for n in shape[-2:])
        kernel = self.device.kernel("warp.cl", name, CHANNELS=1, LENSLETS=True)
        self.device.launch_rows(kernel, shape, *arguments, ny, nx, *self._tables, np.int32(1))

    def _launch_back(
        self, out: cla.Array, g: cla.Array, d: cla.Array, count: np.int32, disparity: Float32Array
    ) -> None:
        """Compute the gradient by the picture."""
        device, steps = self.device, self._pixels.lenslet_steps.reshape(-1, 2).astype(np.float32)
        (ny, nx), wide = disparity.shape, int(out.shape[1])
        device.launch(
            device.kernel("warp.cl", "of_picture", CHANNELS=1, LENSLETS=True),
            (-(-ny // _BAND), 1) if device.rows else (wide, ny),
            *(out, g, d, self._steps, count),
            *(np.int32(n) for n in (ny, nx, 1)),
            *(disparity.min(), disparity.max(), *self._tables),
            *(steps.min(axis=0), steps.max(axis=0), np.float32(self._columns.spacing)),
            np.int32(_BAND),
        )


@dataclass(frozen=True)
class _LensletPixels:
    """Raw pixels of every lenslet and their viewpoints.

    Pixel n is the n-th of a rectangle about the pixel next to the lenslet's centre.
    """

    # Int32, shape (pixels, rows, columns): index into the flat raw image, -1 for none
    index: Values
    # steps, lenslet_steps: float64, shapes (pixels, 2) and (rows, columns, 2); their sum is the
    # shift (y, x) of the look-up in pixels of the picture at disparity 1
    steps: Values
    lenslet_steps: Values


def _lenslet_pixels(grid: LensletGrid, shape: tuple[int, int], ratio: float) -> _LensletPixels:
    """Return the pixels of a grid; ``ratio`` is the disparity along y over that along x."""
    centres = _centres(grid)
    nearest_pixels = np.floor(centres + 0.5).astype(int)  # pixel next to the centre
    i, k = _owners(grid, shape)
    y, x = np.nonzero(i >= 0)
    i, k = i[y, x], k[y, x]
    down, right = y - nearest_pixels[i, k, 0], x - nearest_pixels[i, k, 1]
    low = (down.min(initial=0), right.min(initial=0))
    tall, wide = down.max(initial=0) - low[0] + 1, right.max(initial=0) - low[1] + 1
    index = np.full((tall * wide, *grid.count), -1, np.int32)
    index[(down - low[0]) * wide + right - low[1], i, k] = y * shape[1] + x
    offsets = np.indices((tall, wide)).reshape(2, -1).T + low
    to_views = np.linalg.inv(np.array([grid.row_view_step, grid.column_view_step]).T)
    scale = np.array([1.0, ratio] if grid.exchanged else [ratio, 1.0])
    return _LensletPixels(
        index, offsets @ to_views.T * scale, (nearest_pixels - centres) @ to_views.T * scale
    )


def _centres(grid: LensletGrid) -> Values:
    """Return the centres (y, x) of the sub-images in pixels, shape (rows, columns, 2)."""
    i, k = np.mgrid[: grid.count[0], : grid.count[1]][..., None]
    columns = k + i % 2 * grid.odd_row_shift
    return np.asarray(
        np.array(grid.first) + i * np.array(grid.row_step) + columns * np.array(grid.column_step)
    )


def _owners(grid: LensletGrid, shape: tuple[int, int]) -> tuple[Values, Values]:
    """Return row and column of the lenslet next to every raw pixel, -1 outside the grid."""
    basis = np.array([grid.row_step, grid.column_step]).T
    pixels = np.moveaxis(np.mgrid[: shape[0], : shape[1]], 0, -1) - np.array(grid.first)
    row, column = np.moveaxis(pixels @ np.linalg.inv(basis).T, -1, 0)
    skew = np.dot(grid.row_step, grid.column_step) / np.dot(grid.column_step, grid.column_step)
    nearest = np.full(shape, np.inf)
    owners = np.full((2, *shape), -1)
    for i in (np.floor(row), np.floor(row) + 1):
        shift = i % 2 * grid.odd_row_shift
        k = np.floor(column - shift + (row - i) * skew + 0.5 + _TIE)
        offsets = np.stack((row - i, column - shift - k), axis=-1) @ basis.T
        distance = (offsets**2).sum(axis=-1)
        nearer = distance < nearest + _TIE
        nearest = np.where(nearer, distance, nearest)
        owners = np.where(nearer, (i, k), owners).astype(int)
    inside = ((owners >= 0) & (owners < np.array(grid.count)[:, None, None])).all(axis=0)
    rows, columns = np.where(inside, owners, -1)
    return rows, columns


@dataclass(frozen=True)
class _Columns:
    """Positions of the lenslets of even and odd rows on rows of the picture."""

    # pixels, fractions: shape (2, lenslets), pixel below each lenslet and fraction to the next
    pixels: Values
    fractions: Values
    count: int  # Pixels of a row of the picture
    spacing: float  # Their distance in lenslets

    def _taps(self, rows: int) -> tuple[Values, Values, Values, Values]:
        """Return rows, two pixels of each lenslet, and the second's weight, (rows, lenslets)."""
        y = np.arange(rows)[:, None]
        pixels, weight = self.pixels[y[:, 0] % 2], self.fractions[y[:, 0] % 2]
        first, second = (np.clip(pixels + n, 0, self.count - 1) for n in (0, 1))
        return np.broadcast_to(y, pixels.shape), first, second, weight

    def gather(self, values: Values) -> Values:
        """Interpolate a picture at the lenslets, float64."""
        y, first, second, part = self._taps(len(values))
        values = values.astype(np.float64)
        return np.asarray((1 - part) * values[y, first] + part * values[y, second])

    def spread(self, values: Values) -> Values:
        """Apply the transpose of `gather`."""
        y, first, second, part = self._taps(len(values))
        out = np.zeros((len(values), self.count))
        np.add.at(out, (y, first), (1 - part) * values)
        np.add.at(out, (y, second), part * values)
        return out


def _columns(grid: LensletGrid) -> _Columns:
    """Return the columns of a grid."""
    count, spacing = (grid.count[1], 1.0) if grid.columns is None else grid.columns
    shift = np.array([[0.0], [grid.odd_row_shift]])
    positions = (np.arange(grid.count[1]) + shift) / spacing
    pixels = np.floor(positions)
    return _Columns(pixels.astype(int), positions - pixels, count, spacing)
