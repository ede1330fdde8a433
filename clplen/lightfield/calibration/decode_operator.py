"""Decoding of a raw image as a linear map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.checks import require
from clplen.compute.arrays import Image
from clplen.errors import ShapeError
from clplen.lightfield.arrays.linear_step import LinearStep
from clplen.lightfield.calibration.raw_decoding import divide_views, white_samples
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.decode_adjoint import resample_adjoint
from clplen.lightfield.raw.raw_image import RawImage


class DecodeOperator(LinearStep):
    """A light field as a linear map of the raw image: `LightField.from_raw`, and its adjoint.

    With ``white`` the views are divided by those of the white image, as `decode_raw` does; that is
    linear too, of the frame without dark frame and bad pixels that it keeps as ``lf.raw``. A black
    level is a constant, which the map does not take off: give it ``raw.above_black()``.

    Parameters
    ----------
    raw : RawImage
        Whose lattice is taken, not its pixels; grey, without colour filters.
    decode : {"calibrated", "naive"}
        As of `LightField.from_raw`.
    white, dark : array_like, optional
        White image and dark frame, as of `decode_raw`.

    Attributes
    ----------
    grid : LensletGrid
        Where the samples lie.
    in_shape, out_shape : tuple of int
        (ny, nx) and (v, u, y, x).
    device : Device

    Raises
    ------
    ValueError
        If ``decode`` is neither word, or the raw image has colour filters.
    ShapeError
        If it is a colour picture, or the white image has another shape.
    TypeError
        If it is no raw image.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 1e-3, count=11)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=mla, wavelength=550e-9, pixels_per_lenslet=5)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> decoding = clplen.lightfield.DecodeOperator(raw)
    >>> decoding.in_shape, decoding.out_shape
    ((55, 55), (5, 5, 11, 11))
    >>> pixels = decoding.adjoint(np.ones(decoding.out_shape))  # how much each pixel counts
    >>> pixels.shape
    (55, 55)
    """

    _takes = (RawImage, LightField)

    def __init__(
        self,
        raw: RawImage,
        *,
        decode: str = "calibrated",
        white: ArrayLike | None = None,
        dark: ArrayLike | None = None,
    ) -> None:
        require(RawImage, raw, "raw", "camera.expose or the raw of a decoded light field")
        grids = {"calibrated": raw.sub_images, "naive": raw.cells}
        if decode not in grids:
            raise ValueError(f"decode is 'calibrated' or 'naive', not {decode!r}.")
        if raw.mosaic is not None:
            raise ValueError(
                "This raw image has colour filters, and DecodeOperator is of grey ones: give the "
                "pixels of one colour, or demosaic it and give its colours one by one."
            )
        if len(raw.data.shape) != 2:
            raise ShapeError(
                "DecodeOperator takes a raw image of shape (ny, nx), not a colour picture of shape "
                f"{tuple(raw.data.shape)}: give its colours one by one."
            )
        if white is not None and np.shape(white) != raw.shape:
            raise ShapeError(
                f"The white image has shape {np.shape(white)}, the raw image {raw.shape}: give the "
                "white image of this camera."
            )
        self.grid, self.decode, self.device = grids[decode], decode, raw.device
        self.in_shape: tuple[int, int] = raw.shape
        self.out_shape = self.grid.shape
        self._raw = raw
        self._white: Image | None = None
        if white is not None:
            level = white_samples(white, dark, self.grid, self.device)
            self._white = Image(level, self.device)

    def _about(self) -> str:
        divided = "" if self._white is None else ", divided by a white image"
        return f", {self.decode}{divided}"

    def _even(self, views: cla.Array) -> cla.Array:
        """Views over those of the white image, where there is one."""
        if self._white is None:
            return views
        even = self.device.empty(views.shape, np.float32)
        divide_views(even, views, self._white.data, 1, 0, self.device)
        return even

    def _forward(self, data: cla.Array) -> cla.Array:
        return self._even(resample(data, self.grid, self.device))

    def _adjoint(self, data: cla.Array) -> cla.Array:
        return resample_adjoint(self._even(data), self.in_shape, self.grid, device=self.device)

    def _made(self, data: cla.Array, adjoint: bool) -> Any:
        raw = self._raw
        if adjoint:
            return replace(raw, data=data, levels=None)
        weights = np.ones(self.out_shape[:2], np.float32)
        return LightField(data, self.device, raw.spacing, weights, raw.camera, decode=self.decode)
