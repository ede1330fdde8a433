"""The light field: views (v, u) of (y, x) pixels on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.compute.device import Device, DeviceLike, as_device
from clplen.lightfield.model.parametrisation import Resampling
from clplen.lightfield.model.rendering import Rendering
from clplen.lightfield.model.sample_checks import (
    checked_positions,
    checked_samples,
    checked_spacing,
    checked_weights,
    weights_of_lit,
)
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.demosaicing import views_of_colours
from clplen.lightfield.raw.raw_image import CameraModel, RawImage, Spacing
from clplen.results import Plottable, Savable


@dataclass(frozen=True, eq=False, repr=False)
class LightField(Rendering, Resampling, Savable, Plottable):
    """Radiance along rays, L[v, u, y, x] or L[v, u, y, x, c], from a ``from_`` method.

    v, u are row and column of the view; y, x row and column inside a view. A plane of disparity d
    lies at x - d (u - uc) in view u, with uc = (U - 1)/2; nearer planes have larger d.

    Attributes
    ----------
    data : pyopencl.array.Array
        Samples: uint8, uint16, float16 or float32, C-contiguous.
    device : Device
        Device of the samples.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres: step between views on the main lens and between pixels
        on the image plane. dv and du are negative in raw pixel order.
    weights : numpy.ndarray
        Weights of the views, float32, shape (V, U), not negative; 0 excludes a view everywhere.
    camera : CameraModel or None
        Camera of the light field, if known.
    raw : RawImage or None
        Raw image of the light field, if any.
    decode : {"calibrated", "naive"}
        Decoding; "naive" cells sample direction instead of main-lens position and follow another
        law.
    positions : numpy.ndarray or None
        View positions, float64, shape (V, U, 2), (y, x) in view steps from the viewpoint that
        pictures are registered to, instead of (v - (V - 1)/2, u - (U - 1)/2). None: on the grid.
    parametrisation : {"two-plane", "point-angle"}
        Meaning of a view: a position on the main lens, or a direction. dv and du of ``spacing`` are
        then angle steps in radians, and functions that shift views reject it; see `resample`.
    linear : bool
        True for linear light with white at 1, known from a camera's levels and colours; exported
        pictures are then encoded as sRGB.

    Examples
    --------
    >>> views = np.random.default_rng(0).random((5, 5, 24, 32), np.float32)
    >>> lf = clplen.LightField.from_array(views)
    >>> lf.shape, lf.dtype.name, lf.view(2, 2).shape
    ((5, 5, 24, 32), 'float32', (24, 32))
    >>> lf.epi(y=12, v=2).shape
    (5, 32)
    >>> bool(np.allclose(lf.render(), views.mean((0, 1)), atol=1e-6))
    True
    """

    _writer: ClassVar[str] = "write_lightfield"
    _figure: ClassVar[str] = "views"

    data: cla.Array
    device: Device
    spacing: Spacing | None
    weights: np.ndarray[Any, np.dtype[np.float32]]
    camera: CameraModel | None = None
    raw: RawImage | None = None
    decode: str = "calibrated"
    positions: np.ndarray[Any, np.dtype[np.float64]] | None = None
    parametrisation: str = "two-plane"
    linear: bool = False

    @classmethod
    def from_array(
        cls,
        a: ArrayLike | cla.Array,
        *,
        device: DeviceLike | None = None,
        spacing: Spacing | None = None,
        weights: ArrayLike | None = None,
        camera: CameraModel | None = None,
        positions: ArrayLike | None = None,
    ) -> LightField:
        """Create a light field from views in memory.

        Parameters
        ----------
        a : array_like or pyopencl.array.Array
            Views of shape (v, u, y, x) or (v, u, y, x, c). uint8, uint16, float16 and float32 are
            stored unchanged; other real types become float32. Pictures and maps are always float32.
            A contiguous array of this device is used without a copy, a NumPy array is copied once.
            A view with masked samples (`numpy.ma`) has weight 0.
        device : Device or str, optional
            Device of the light field; default ``Device.open()``.
        spacing : tuple of float, optional
            Signed (dv, du, dy, dx) in metres; needed for ``alpha``.
        weights : array_like, optional
            Weights of shape (V, U), finite, not negative, not all 0. Default 0 for black views, 1
            for others (1 for all if all are black).
        camera : CameraModel, optional
            Camera, needed for depth in metres.
        positions : array_like, optional
            Position (y, x) of every view in view steps, y down, shape (V, U, 2), finite, for views
            off a regular grid.

        Returns
        -------
        LightField

        Raises
        ------
        ShapeError
            If the array is not 4-D or 5-D, is empty, or weights or positions do not match it.
        ValueError
            If a sample is NaN or infinite (interpolation would spread it), or spacing, weights or
            positions are out of range.
        TypeError
            If the samples are complex, or on the device in another dtype than these four.
        DeviceError
            If the array exceeds the device's memory or belongs to another device.

        Warns
        -----
        SamplingWarning
            If views have valid samples besides masked ones; these are lost.
        """
        device = as_device(device)
        data, valid = checked_samples(a, device)
        view_weights = (
            weights_of_lit(data, device) if weights is None else checked_weights(weights, data)
        )
        if valid is not None:
            view_weights = checked_weights(view_weights * valid, data)
        view_positions = checked_positions(positions, data)
        return cls(
            data, device, checked_spacing(spacing), view_weights, camera, positions=view_positions
        )

    @classmethod
    def from_raw(cls, raw: RawImage, *, decode: str = "calibrated") -> LightField:
        """Decode a raw lenslet image.

        Parameters
        ----------
        raw : RawImage
            Raw image with its grids.
        decode : {"calibrated", "naive"}
            Sampling positions. "calibrated" samples the sub-images of the main lens' pupil about
            their true centres, x_k (1 + f_mu/F), as in `clplen.lightfield.raw.decode.resample`:
            pixel j of a sub-image is one position u on the main lens. "naive" cuts the lenslets'
            cells, a permutation of the pixels that samples direction instead of position.

        Returns
        -------
        LightField
            Light field of float32, shape (V, U, rows, columns), in raw pixel order (dv, du < 0); of
            shape (V, U, rows, columns, 3) for a mosaic of red, green and blue filters, each colour
            sliced separately. The black level of a sensor with ``levels`` is subtracted.

        Raises
        ------
        ValueError
            If ``decode`` is invalid, the raw image includes NaN or infinity, has filters other than
            R, G and B, or is of a focused camera and ``decode`` is not "naive".
        DeviceError
            If the light field exceeds the device's memory.
        """
        if not isinstance(raw, RawImage):
            raise TypeError(f"raw must be a RawImage, got {type(raw).__name__}.")
        grids = {"calibrated": raw.sub_images, "naive": raw.cells}
        if decode not in grids:
            raise ValueError(f"decode must be 'calibrated' or 'naive', got {decode!r}.")
        if decode != "naive" and raw.camera is not None and raw.camera.kind == "focused":
            raise ValueError(
                "This raw image is of a focused (plenoptic 2.0) camera, whose sub-images are "
                "pictures, not sets of views; render pictures with render_focused, or read the "
                "pixels unchanged with decode='naive'."
            )
        lit = raw.above_black()
        if raw.mosaic is None:
            data = resample(lit.data, grids[decode], raw.device)
        else:
            frame = lit.to_numpy()
            data = views_of_colours(
                frame, np.ones_like(frame), grids[decode], raw.mosaic, device=raw.device
            )
        weights = np.ones(grids[decode].shape[:2], np.float32)
        return cls(data, raw.device, raw.spacing, weights, raw.camera, raw, decode)

    def __repr__(self) -> str:
        return f"<LightField {self.shape} {self.dtype}, {self.device.name}>"
