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
    """Decoding of a raw image by `LightField.from_raw` as a linear map, with its adjoint.

    With ``white`` the views are divided by those of the white image, as in `decode_raw`. The map
    then applies to the frame that ``lf.raw`` stores, without dark frame and bad pixels. A black
    level is a constant, not part of the map; pass ``raw.above_black()``.

    Parameters
    ----------
    raw : RawImage
        Raw image with the lattice, grey, without colour filters; its pixels are not used.
    decode : {"calibrated", "naive"}
        Positions of the samples, see `LightField.from_raw`.
    white, dark : array_like, optional
        White image and dark frame, see `decode_raw`.

    Attributes
    ----------
    grid : LensletGrid
        Grid of the samples.
    in_shape, out_shape : tuple of int
        (ny, nx) and (v, u, y, x).
    device : Device

    Raises
    ------
    ValueError
        If ``decode`` is invalid, or the raw image has colour filters.
    ShapeError
        If the image has colours, or the white image has another shape.
    TypeError
        If ``raw`` is not a RawImage.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 1e-3, count=11)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=mla, wavelength=550e-9, pixels_per_lenslet=5)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> decoding = clplen.lightfield.DecodeOperator(raw)
    >>> decoding.in_shape, decoding.out_shape
    ((55, 55), (5, 5, 11, 11))
    >>> pixels = decoding.adjoint(np.ones(decoding.out_shape))  # weights in the sum of all views
    >>> pixels.shape
    (55, 55)
    """

    _operand_types = (RawImage, LightField)

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
            raise ValueError(f"decode must be 'calibrated' or 'naive', got {decode!r}.")
        if raw.mosaic is not None:
            raise ValueError(
                "DecodeOperator needs a grey raw image, and this one has colour filters; pass the "
                "pixels of one colour, or demosaic it and pass each colour in turn."
            )
        if len(raw.data.shape) != 2:
            raise ShapeError(
                "raw must have shape (ny, nx), got a colour picture of shape "
                f"{tuple(raw.data.shape)}; pass each colour in turn."
            )
        if white is not None and np.shape(white) != raw.shape:
            raise ShapeError(
                f"white must have the shape of the raw image, {raw.shape}, got {np.shape(white)}; "
                "pass the white image of this camera."
            )
        self.grid, self.decode, self.device = grids[decode], decode, raw.device
        self.in_shape: tuple[int, int] = raw.shape
        self.out_shape = self.grid.shape
        self._raw = raw
        self._white: Image | None = None
        if white is not None:
            level = white_samples(white, dark, self.grid, self.device)
            self._white = Image(level, self.device)

    def _details(self) -> str:
        divided = "" if self._white is None else ", divided by a white image"
        return f", {self.decode}{divided}"

    def _even(self, views: cla.Array) -> cla.Array:
        """Divide views by those of the white image, if any."""
        if self._white is None:
            return views
        divided = self.device.empty(views.shape, np.float32)
        divide_views(divided, views, self._white.data, 1, 0, self.device)
        return divided

    def _forward(self, data: cla.Array) -> cla.Array:
        return self._even(resample(data, self.grid, self.device))

    def _adjoint(self, data: cla.Array) -> cla.Array:
        return resample_adjoint(self._even(data), self.in_shape, self.grid, device=self.device)

    def _wrap(self, data: cla.Array, adjoint: bool) -> Any:
        raw = self._raw
        if adjoint:
            return replace(raw, data=data, levels=None)
        weights = np.ones(self.out_shape[:2], np.float32)
        return LightField(data, self.device, raw.spacing, weights, raw.camera, decode=self.decode)
