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
    """Radiance along rays, L[v, u, y, x] or L[v, u, y, x, c]. Made by a ``from_`` method.

    v, u are row and column of the view; y, x row and column inside a view. A plane of disparity d
    lies at x - d (u - uc) in view u, with uc = (U - 1)/2: nearer is larger.

    Attributes
    ----------
    data : pyopencl.array.Array
        uint8, uint16, float16 or float32, C-contiguous.
    device : Device
        The device that holds the samples.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres: step between views on the main lens and between pixels
        on the image plane. dv and du are negative in raw pixel order.
    weights : numpy.ndarray
        float32, shape (V, U), not negative; 0 leaves a view out everywhere.
    camera : CameraModel or None
        The camera that took it, when known.
    raw : RawImage or None
        The raw image that it was decoded from.
    decode : {"calibrated", "naive"}
        "naive" cells sample direction, not main-lens position, and obey another law.
    positions : numpy.ndarray or None
        float64, shape (V, U, 2): where the views lie, (y, x) in view steps from the viewpoint that
        pictures are registered to, in place of (v - (V - 1)/2, u - (U - 1)/2). None: on the grid.
    parametrisation : {"two-plane", "point-angle"}
        What a view is: a position on the main lens, or a direction. Then dv and du of ``spacing``
        are steps of angle in radians, and what shifts views refuses it; see `resample`.
    linear : bool
        Whether samples are linear light in which 1 is white, as a camera's own levels and colours
        tell; pictures to look at are encoded as sRGB then.

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
        """Take views that are in memory.

        Parameters
        ----------
        a : array_like or pyopencl.array.Array
            Shape (v, u, y, x) or (v, u, y, x, c). uint8, uint16, float16 and float32 are kept
            as they are on the device; other real types become float32. Pictures and maps are
            float32 in any case. A contiguous array of this device is taken without a copy, a
            NumPy array is copied once. A view with masked samples (`numpy.ma`) has weight 0.
        device : Device or str, optional
            Where the light field will live; default ``Device.open()``.
        spacing : tuple of float, optional
            Signed (dv, du, dy, dx) in metres; needed for ``alpha``.
        weights : array_like, optional
            Shape (V, U), finite, not negative, not all 0. By default 0 for black views, 1 for the
            others (1 for all when all are black).
        camera : CameraModel, optional
            Needed for depth in metres.
        positions : array_like, optional
            Shape (V, U, 2), finite: (y, x) of every view in view steps, y down, for views that lie
            on no regular grid.

        Returns
        -------
        LightField

        Raises
        ------
        ShapeError
            If the array is not 4-D or 5-D, is empty, or weights or positions do not fit it.
        ValueError
            If a sample is NaN or infinite: refused here, because interpolation would spread it;
            if spacing, weights or positions are out of range.
        TypeError
            If the samples are complex, or on the device and of none of the four types.
        DeviceError
            If it is larger than the device's memory, or an array of another device.

        Warns
        -----
        SamplingWarning
            If views have masked samples beside valid ones, which are lost with them.
        """
        device = as_device(device)
        data, valid = checked_samples(a, device)
        known = weights_of_lit(data, device) if weights is None else checked_weights(weights, data)
        if valid is not None:
            known = checked_weights(known * valid, data)
        at = checked_positions(positions, data)
        return cls(data, device, checked_spacing(spacing), known, camera, positions=at)

    @classmethod
    def from_raw(cls, raw: RawImage, *, decode: str = "calibrated") -> LightField:
        """Decode a raw lenslet image.

        Parameters
        ----------
        raw : RawImage
        decode : {"calibrated", "naive"}
            "calibrated" samples the sub-images of the main lens' pupil about their true centres,
            x_k (1 + f_mu/F), as `clplen.lightfield.raw.decode.resample` does: pixel j of a
            sub-image is one position u on the main lens. "naive" cuts the lenslets' own cells, a
            permutation of the pixels: it samples direction, not position.

        Returns
        -------
        LightField
            float32, shape (V, U, rows, columns), in raw pixel order (dv, du < 0); (V, U, rows,
            columns, 3) of a mosaic of red, green and blue filters, each colour sliced by itself.
            Of a sensor with ``levels`` the black one is taken off.

        Raises
        ------
        ValueError
            If ``decode`` is neither, or the raw image holds NaN or infinity, or has other filters
            than R, G and B; or is of a focused
            camera, whose pixels hold no views, unless ``decode="naive"`` asks for them plainly.
        DeviceError
            If it is larger than the device's memory.
        """
        if not isinstance(raw, RawImage):
            raise TypeError(f"from_raw takes a RawImage, not {type(raw).__name__}.")
        grids = {"calibrated": raw.sub_images, "naive": raw.cells}
        if decode not in grids:
            raise ValueError(f"decode is 'calibrated' or 'naive', not {decode!r}.")
        if decode != "naive" and raw.camera is not None and raw.camera.kind == "focused":
            raise ValueError(
                "This raw image is of a focused (plenoptic 2.0) camera, whose sub-images are "
                "pictures and no sets of views: make pictures with render_focused, or take the "
                "pixels as they are with decode='naive'."
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
