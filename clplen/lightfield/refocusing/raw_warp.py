"""A raw image from a picture and its disparity, and the gradients of a loss through it."""

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

_BAND = 32  # rows of the picture that a CPU's work-item gathers
_ON_DEVICE = ("_tables", "_steps")  # not copied with a model
_TIE = 1e-9  # pixels or lenslets: pixels halfway between lenslets go to the later one

Values = np.ndarray[Any, Any]


class RawWarp:
    """The raw image of a picture, by a disparity of every pixel: a model of a raw image.

    A raw pixel belongs to the lenslet whose sub-image has its centre next to it, halfway to the
    later one, and sees the picture through it from the viewpoint (v, u) that its place in the
    sub-image says, in view steps from the centre, between views as a rule:

        raw = white P(y + v d_y, x + u d),    d = D(y, x),

    where (y, x) is the place of the lenslet on the picture, P the picture and D its disparity, both
    interpolated linearly. Raw pixels are compared as they were taken, and keep noise that is
    independent from pixel to pixel. The approximations and gradients are those of `ViewWarp`; light
    that reaches a sub-image from another lenslet is ignored, too.

    Parameters
    ----------
    raw : RawImage
        Whose lattice is taken, not its pixels; grey, without colour filters.
    white : array_like, optional
        What every raw pixel gives for brightness 1, such as a white image, shape (ny, nx); default
        1 everywhere.

    Attributes
    ----------
    shape : tuple of int
        (ny, nx) of the raw image.
    picture_shape : tuple of int
        (y, x) of picture and disparity, those of the light field.
    used : numpy.ndarray
        bool, shape (ny, nx): the raw pixels that belong to a lenslet. All others are 0.
    device : Device

    Raises
    ------
    TypeError
        If it is no raw image.
    ShapeError
        If it is a colour picture, or the white image has another shape.
    ValueError
        If the raw image has colour filters, or the white image holds NaN or infinity.

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
    >>> of_picture, of_disparity = model.vjp(picture, disparity, error)  # of sum(error**2)/2
    >>> raw.shape, of_picture.shape
    ((64, 64), (12, 12))
    """

    def __init__(self, raw: RawImage, *, white: ArrayLike | None = None) -> None:
        require(RawImage, raw, "raw", "camera.expose or the raw of a decoded light field")
        if raw.mosaic is not None or len(raw.data.shape) != 2:
            kind = ValueError if raw.mosaic is not None else ShapeError
            raise kind(
                "RawWarp is of grey raw images, without colour filters, and this one is of colour: "
                "give the pixels of one colour."
            )
        self.device: Device = raw.device
        self.shape: tuple[int, int] = raw.shape
        self.picture_shape: tuple[int, int] = raw.sub_images.shape[2:]
        given = np.ones(self.shape) if white is None else white
        level = finite_of_shape(given, self.shape, "The white image")
        self._raw, self._exchanged = raw, raw.sub_images.exchanged
        self._pixels = _lenslet_pixels(raw.sub_images, self.shape, row_ratio(raw.spacing))
        self._places = _columns(raw.sub_images)
        self.used: np.ndarray[Any, np.dtype[np.bool_]] = np.zeros(self.shape, bool)
        index = self._pixels.index
        self.used.ravel()[index[index >= 0]] = True
        self._white = level
        self._tables = self._uploaded()

    def __getstate__(self) -> dict[str, Any]:
        """Without tables on the device, which are made again."""
        return {key: value for key, value in self.__dict__.items() if key not in _ON_DEVICE}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self._tables = self._uploaded()

    def __repr__(self) -> str:
        return f"<RawWarp of {self.picture_shape} to {self.shape}, {self.device.name}>"

    def forward(self, picture: ArrayLike, disparity: ArrayLike) -> RawImage:
        """The raw image.

        Parameters
        ----------
        picture : Image or array_like
            Shape ``picture_shape``.
        disparity : DepthMap or array_like
            Pixels a view step, of every pixel, shape ``picture_shape``.

        Returns
        -------
        RawImage
            float32, with the lattice of the given one.

        Raises
        ------
        ShapeError, ValueError, TypeError, DeviceError
            As `ViewWarp.forward`.
        """
        seen, own = self._of_grid(picture, disparity)
        raw = self.device.zeros(self.shape, np.float32)
        self._launch("views", self._pixels.index.shape, raw, *self._sent(seen, own), self._steps)
        return replace(self._raw, data=raw, levels=None, exposure=None, truth=None)

    def vjp(
        self, picture: ArrayLike, disparity: ArrayLike, gradient: Any
    ) -> tuple[Float32Array, Float32Array]:
        """Gradients of a loss with respect to picture and disparity, by that of the raw image.

        Parameters
        ----------
        picture, disparity
            As given to `forward`.
        gradient : RawImage or array_like
            Of the loss with respect to every raw pixel, shape ``shape``. Pixels of no lenslet do
            not count.

        Returns
        -------
        tuple of numpy.ndarray
            float32, both of shape ``picture_shape``.

        Raises
        ------
        ShapeError, ValueError, TypeError, DeviceError
            As `forward`.
        """
        seen, own = self._of_grid(picture, disparity)
        g = self.device.upload(
            finite_of_shape(gradient, self.shape, "The gradient of the raw image")
        )
        P, d = self._sent(seen, own)
        of_own = self.device.empty(own.shape, np.float32)
        count = np.int32(len(self._pixels.steps))
        self._launch("of_disparity", own.shape, of_own, g, P, d, self._steps, count)
        of_picture = self.device.empty(seen.shape, np.float32)
        self._launch_back(of_picture, g, d, count, own)
        of_disparity = self._places.spread(self.device.download(of_own))
        found = self.device.download(of_picture), of_disparity.astype(np.float32)
        first, second = (np.ascontiguousarray(a.T) if self._exchanged else a for a in found)
        return first, second

    def _of_grid(self, picture: Any, disparity: Any) -> tuple[Float32Array, Float32Array]:
        """The picture as its grid has it, and the disparity of every lenslet."""
        pictures = (
            finite_of_shape(values, self.picture_shape, what)
            for values, what in ((picture, "The picture"), (disparity, "The disparity"))
        )
        seen, d = (a.T if self._exchanged else a for a in pictures)
        return np.ascontiguousarray(seen), self._places.gather(d).astype(np.float32)

    def _uploaded(self) -> tuple[Any, ...]:
        """Tables of the pixels, as arguments of the kernels."""
        pixels, device = self._pixels, self.device
        need = 4 * (pixels.index.size + 3 * self._white.size)
        device.require_memory(need, "The pixels of these lenslets")
        self._steps = device.upload(pixels.steps.astype(np.float32))
        return (
            device.upload(pixels.index),
            device.upload(self._white),
            device.upload(pixels.own.astype(np.float32)),
            device.upload(self._places.whole.astype(np.int32)),
            device.upload(self._places.part.astype(np.float32)),
            np.int32(self._places.count),
        )

    def _sent(self, *arrays: Any) -> tuple[cla.Array, ...]:
        return tuple(self.device.upload(a) for a in arrays)

    def _launch(self, name: str, shape: tuple[int, ...], *arguments: Any) -> None:
        ny, nx = (np.int32(n) for n in shape[-2:])
        kernel = self.device.kernel("warp.cl", name, CHANNELS=1, LENSLETS=True)
        self.device.launch_rows(kernel, shape, *arguments, ny, nx, *self._tables, np.int32(1))

    def _launch_back(
        self, out: cla.Array, g: cla.Array, d: cla.Array, count: np.int32, own: Float32Array
    ) -> None:
        """The gradient of the picture."""
        device, steps = self.device, self._pixels.own.reshape(-1, 2).astype(np.float32)
        (ny, nx), wide = own.shape, int(out.shape[1])
        device.launch(
            device.kernel("warp.cl", "of_picture", CHANNELS=1, LENSLETS=True),
            (-(-ny // _BAND), 1) if device.rows else (wide, ny),
            *(out, g, d, self._steps, count),
            *(np.int32(n) for n in (ny, nx, 1)),
            *(own.min(), own.max(), *self._tables),
            *(steps.min(axis=0), steps.max(axis=0), np.float32(self._places.spacing)),
            np.int32(_BAND),
        )


@dataclass(frozen=True)
class _LensletPixels:
    """The raw pixels of every lenslet, and from where they see.

    Pixel n of a lenslet is the n-th of a rectangle of pixels about the pixel next to its centre.
    """

    index: Values  # int32, shape (pixels, rows, columns): places in the flat raw image, -1 for none
    # steps, own: float64, shapes (pixels, 2) and (rows, columns, 2): their sum is by how many
    # pixels (y, x) of the picture disparity 1 moves the look-up
    steps: Values
    own: Values


def _lenslet_pixels(grid: LensletGrid, shape: tuple[int, int], ratio: float) -> _LensletPixels:
    """Those of a grid; disparities along y of the light field are `ratio` times those along x."""
    centres = _centres(grid)
    at = np.floor(centres + 0.5).astype(int)  # the pixel next to the centre
    i, k = _owners(grid, shape)
    y, x = np.nonzero(i >= 0)
    i, k = i[y, x], k[y, x]
    down, right = y - at[i, k, 0], x - at[i, k, 1]
    low = (down.min(initial=0), right.min(initial=0))
    tall, wide = down.max(initial=0) - low[0] + 1, right.max(initial=0) - low[1] + 1
    index = np.full((tall * wide, *grid.count), -1, np.int32)
    index[(down - low[0]) * wide + right - low[1], i, k] = y * shape[1] + x
    offsets = np.indices((tall, wide)).reshape(2, -1).T + low
    to_views = np.linalg.inv(np.array([grid.row_view_step, grid.column_view_step]).T)
    scale = np.array([1.0, ratio] if grid.exchanged else [ratio, 1.0])
    return _LensletPixels(index, offsets @ to_views.T * scale, (at - centres) @ to_views.T * scale)


def _centres(grid: LensletGrid) -> Values:
    """(y, x) of the sub-images in pixels, shape (rows, columns, 2)."""
    i, k = np.mgrid[: grid.count[0], : grid.count[1]][..., None]
    shifted = k + i % 2 * grid.odd_row_shift
    return np.asarray(
        np.array(grid.first) + i * np.array(grid.row_step) + shifted * np.array(grid.column_step)
    )


def _owners(grid: LensletGrid, shape: tuple[int, int]) -> tuple[Values, Values]:
    """Row and column of the lenslet next to every raw pixel, -1 where the grid has none there."""
    basis = np.array([grid.row_step, grid.column_step]).T
    pixels = np.moveaxis(np.mgrid[: shape[0], : shape[1]], 0, -1) - np.array(grid.first)
    row, column = np.moveaxis(pixels @ np.linalg.inv(basis).T, -1, 0)
    skew = np.dot(grid.row_step, grid.column_step) / np.dot(grid.column_step, grid.column_step)
    nearest = np.full(shape, np.inf)
    found = np.full((2, *shape), -1)
    for i in (np.floor(row), np.floor(row) + 1):
        shift = i % 2 * grid.odd_row_shift
        k = np.floor(column - shift + (row - i) * skew + 0.5 + _TIE)
        away = np.stack((row - i, column - shift - k), axis=-1) @ basis.T
        distance = (away**2).sum(axis=-1)
        nearer = distance < nearest + _TIE
        nearest = np.where(nearer, distance, nearest)
        found = np.where(nearer, (i, k), found).astype(int)
    inside = ((found >= 0) & (found < np.array(grid.count)[:, None, None])).all(axis=0)
    rows, columns = np.where(inside, found, -1)
    return rows, columns


@dataclass(frozen=True)
class _Columns:
    """Where the lenslets of even and odd rows lie on rows of the picture."""

    # whole, part: Shape (2, lenslets): the pixel before them, and the fraction to the next one
    whole: Values
    part: Values
    count: int  # Pixels of a row of the picture
    spacing: float  # Of them, in lenslets

    def _taps(self, rows: int) -> tuple[Values, Values, Values, Values]:
        """Rows, two pixels of each lenslet, and the weight of the second, (rows, lenslets)."""
        y = np.arange(rows)[:, None]
        whole, part = self.whole[y[:, 0] % 2], self.part[y[:, 0] % 2]
        first, second = (np.clip(whole + n, 0, self.count - 1) for n in (0, 1))
        return np.broadcast_to(y, whole.shape), first, second, part

    def gather(self, values: Values) -> Values:
        """A picture's values at the lenslets, float64."""
        y, first, second, part = self._taps(len(values))
        values = values.astype(np.float64)
        return np.asarray((1 - part) * values[y, first] + part * values[y, second])

    def spread(self, values: Values) -> Values:
        """The transpose of `gather`."""
        y, first, second, part = self._taps(len(values))
        out = np.zeros((len(values), self.count))
        np.add.at(out, (y, first), (1 - part) * values)
        np.add.at(out, (y, second), part * values)
        return out


def _columns(grid: LensletGrid) -> _Columns:
    """Those of a grid."""
    count, spacing = (grid.count[1], 1.0) if grid.columns is None else grid.columns
    shift = np.array([[0.0], [grid.odd_row_shift]])
    places = (np.arange(grid.count[1]) + shift) / spacing
    whole = np.floor(places)
    return _Columns(whole.astype(int), places - whole, count, spacing)
