"""The light field: views (v, u) of (y, x) pixels on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device, require_device
from clplen.compute.finite import count_bad
from clplen.compute.image import Image
from clplen.errors import DeviceError, ShapeError
from clplen.lightfield import decode as decoding
from clplen.lightfield import render as rendering
from clplen.lightfield.raw import CameraModel, RawImage, Spacing
from clplen.lightfield.samples import C_TYPE, lit_views

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False, repr=False)
class LightField:
    """Radiance along rays, L[v, u, y, x] or L[v, u, y, x, c]. Made by a ``from_`` method.

    v, u are row and column of the view; y, x row and column inside a view. A plane of disparity d
    lies at x - d (u - uc) in view u, with uc = (U - 1)/2: nearer is larger.

    Attributes
    ----------
    data : pyopencl.array.Array
        uint8, uint16 or float32, C-contiguous.
    device : Device
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
    """

    data: cla.Array
    device: Device
    spacing: Spacing | None
    weights: np.ndarray[Any, np.dtype[np.float32]]
    camera: CameraModel | None = None
    raw: RawImage | None = None
    decode: str = "calibrated"

    @classmethod
    def from_array(
        cls,
        a: ArrayLike | cla.Array,
        *,
        device: Device,
        spacing: Spacing | None = None,
        weights: ArrayLike | None = None,
        camera: CameraModel | None = None,
    ) -> LightField:
        """Take views that are in memory.

        Parameters
        ----------
        a : array_like or pyopencl.array.Array
            Shape (v, u, y, x) or (v, u, y, x, c). uint8, uint16 and float32 are kept as they are
            (integers stay integers on the device); other real types become float32. A contiguous
            array of this device is taken without a copy, a NumPy array is copied once.
        device : Device
            Where the light field will live.
        spacing : tuple of float, optional
            Signed (dv, du, dy, dx) in metres; needed for ``alpha``.
        weights : array_like, optional
            Shape (V, U), finite, not negative, not all 0. By default 0 for views that are black
            throughout, 1 for the others (1 for all when all are black).
        camera : CameraModel, optional
            Needed for depth in metres.

        Returns
        -------
        LightField

        Raises
        ------
        ShapeError
            If the array is not 4-D or 5-D, is empty, or the weights do not fit it.
        ValueError
            If a sample is NaN or infinite: refused here, because interpolation would spread it;
            if spacing or weights are out of range.
        TypeError
            If the samples are complex, or on the device and of none of the three types.
        DeviceError
            If it is larger than the device's memory, or an array of another device.
        """
        require_device(device)
        data = _adopt(a, device)
        if data.ndim not in (4, 5) or 0 in data.shape:
            raise ShapeError(
                "A light field has shape (v, u, y, x) or (v, u, y, x, c), none of them empty, not "
                f"{tuple(data.shape)}."
            )
        bad = count_bad(data, device)
        if bad:
            raise ValueError(
                f"The light field has {bad} samples that are NaN or infinite, which interpolation "
                "would spread: replace them by 0 and give their views weight 0 (weights=)."
            )
        checked = _weights_of_lit(data, device) if weights is None else _checked(weights, data)
        return cls(data, device, _checked_spacing(spacing), checked, camera)

    @classmethod
    def from_raw(cls, raw: RawImage, *, decode: str = "calibrated") -> LightField:
        """Decode a raw lenslet image.

        Parameters
        ----------
        raw : RawImage
        decode : {"calibrated", "naive"}
            "calibrated" samples the sub-images of the main lens' pupil about their true centres,
            x_k (1 + f_mu/F), by separable cubic convolution (Keys 1981, a = -1/2): pixel j of a
            sub-image is one position u on the main lens. "naive" cuts the lenslets' own cells, a
            permutation of the pixels: it samples direction, not position. The odd rows of a
            hexagonal array are interpolated to a rectangular lattice by the same cubic.

        Returns
        -------
        LightField
            float32, shape (V, U, rows, columns), in raw pixel order (dv, du < 0).

        Raises
        ------
        ValueError
            If ``decode`` is neither, or the raw image holds NaN or infinity.
        DeviceError
            If it is larger than the device's memory.
        """
        if not isinstance(raw, RawImage):
            raise TypeError(f"from_raw takes a RawImage, not {type(raw).__name__}.")
        grids = {"calibrated": raw.sub_images, "naive": raw.cells}
        if decode not in grids:
            raise ValueError(f"decode is 'calibrated' or 'naive', not {decode!r}.")
        data = decoding.resample(raw, grids[decode])
        weights = np.ones(grids[decode].views, np.float32)
        return cls(data, raw.device, raw.spacing, weights, raw.camera, raw, decode)

    def __repr__(self) -> str:
        return f"<LightField {self.shape} {self.dtype}, {self.device.name}>"

    @property
    def shape(self) -> tuple[int, ...]:
        """(v, u, y, x[, c])."""
        return tuple(int(n) for n in self.data.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """uint8, uint16 or float32."""
        return np.dtype(self.data.dtype)

    def to_numpy(self) -> np.ndarray[Any, Any]:
        """The samples on the host, same shape and dtype."""
        return self.device.download(self.data)

    def disparity(self, alpha: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Disparity, in pixels a view step, of the plane alpha = F/F'.

        d = -(1 - alpha) du/dx with the signed du of ``spacing``; for naive cells
        d = -(1/alpha - 1) du/dx.

        Raises
        ------
        ValueError
            If the light field has no spacing or an alpha is not positive.
        """
        ratio = self._view_ratio()
        values = np.asarray(alpha, np.float64)
        if not (np.isfinite(values).all() and (values > 0).all()):
            raise ValueError(f"alpha = F/F' is positive and finite, not {alpha!r}.")
        return -ratio * ((1 / values - 1) if self.decode == "naive" else (1 - values))

    def alpha(self, disparity: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
        """The inverse of `disparity`; NaN without spacing."""
        values = np.asarray(disparity, np.float64)
        if self.spacing is None or not np.isfinite(self.spacing).all():
            return np.full_like(values, np.nan)
        scaled = -values / self._view_ratio()
        return 1 / (1 + scaled) if self.decode == "naive" else 1 - scaled

    def view(self, v: float, u: float) -> Image:
        """The view at (v, u), between views too (bilinear in the aperture, by `weights`).

        A view of weight 0 is shown as it is stored, but not mixed into others.

        Parameters
        ----------
        v, u : float
            0 <= v <= V - 1, 0 <= u <= U - 1.

        Returns
        -------
        Image
            float32, shape (y, x[, c]).

        Raises
        ------
        ValueError
            If (v, u) lies outside the views.
        """
        return rendering.view(self, v, u)

    def epi(
        self,
        *,
        y: int | None = None,
        x: int | None = None,
        v: int | None = None,
        u: int | None = None,
    ) -> Image:
        """An epipolar-plane image: ``epi(y=, v=)`` is (u, x[, c]), ``epi(x=, u=)`` is (v, y[, c]).

        Raises
        ------
        ValueError
            If neither pair, or an index outside the light field, is given.
        """
        return rendering.epi(self, y=y, x=x, v=v, u=u)

    def render(
        self,
        *,
        aperture: Any = None,
        viewpoint: tuple[float, float] | None = None,
        total: bool = False,
    ) -> Image:
        """The picture as focused, through part of the aperture.

        Parameters
        ----------
        aperture : int, float, str or array_like, optional
            int: that many views across (of N views, thesis eq. 3.3 drops (N - N')//2 below and the
            rest above); float in (0, 1]: a disc of that fraction of the full diameter (an ellipse
            V views high and U wide); ``"f/66"``: a disc on the main lens by f-number at its image,
            needs camera and spacing; array (V, U): weights. A view that the rim crosses counts
            with the covered fraction of its cell. None: all views.
        viewpoint : tuple of float, optional
            (v, u) of the aperture's centre, between views too; what then lies outside the views is
            cut off. Alone, it is that one view.
        total : bool
            The weighted sum over views instead of the weighted mean.

        Returns
        -------
        Image
            float32, shape (y, x[, c]).

        Raises
        ------
        ValueError
            If the aperture or the viewpoint lies outside the views, leaves only views of weight 0,
            or needs a camera that is not known.
        ShapeError
            If an array of weights has not one for each view.
        TypeError
            If the aperture is none of these.
        """
        return rendering.render(self, aperture=aperture, viewpoint=viewpoint, total=total)

    def _view_ratio(self) -> float:
        """du/dx, signed."""
        if self.spacing is None or not np.isfinite(self.spacing).all():
            raise ValueError(
                "alpha needs the spacing of views and pixels in metres, which this light field "
                "does not have: give spacing=(dv, du, dy, dx), or use disparity."
            )
        return self.spacing[1] / self.spacing[3]


def _adopt(a: Any, device: Device) -> cla.Array:
    """The samples on the device in a storage type of the light field."""
    if isinstance(a, cla.Array):
        return _adopt_device(a, device)
    values = np.asarray(a)
    if values.dtype.kind not in "buif":
        raise TypeError(f"A light field is real, not {values.dtype}.")
    native = values.dtype.newbyteorder("=")
    dtype = native if native in C_TYPE else np.dtype(np.float32)
    device.require_memory(values.size * dtype.itemsize, "This light field")
    return device.upload(values.astype(dtype, copy=False))


def _adopt_device(a: cla.Array, device: Device) -> cla.Array:
    """An array that is on the device already, when everything on its own queue is done."""
    if a.context != device.context:
        raise DeviceError(
            f"The array lives in another OpenCL context than {device!r}: make it on device.queue."
        )
    if np.dtype(a.dtype) not in C_TYPE:
        raise TypeError(f"On the device a light field is uint8, uint16 or float32, not {a.dtype}.")
    if not a.flags.c_contiguous:
        raise ShapeError(
            f"On the device a light field is C-contiguous, not of strides {a.strides}: copy it "
            "into a new array, or give a NumPy array."
        )
    if a.queue is not None:
        a.queue.finish()
    return a if a.offset == 0 else a.copy(queue=device.queue)


def _checked_spacing(spacing: Any) -> Spacing | None:
    if spacing is None:
        return None
    values = tuple(float(s) for s in spacing)
    if len(values) != 4 or 0.0 in values:
        raise ValueError(f"spacing is (dv, du, dy, dx) in metres, none of them 0, not {spacing!r}.")
    return values


def _weights_of_lit(data: cla.Array, device: Device) -> np.ndarray[Any, np.dtype[np.float32]]:
    lit = lit_views(data, device)
    return (lit if lit.any() else ~lit).astype(np.float32)


def _checked(weights: Any, data: cla.Array) -> np.ndarray[Any, np.dtype[np.float32]]:
    values = np.array(weights, np.float32)
    views = (int(data.shape[0]), int(data.shape[1]))
    if values.shape != views:
        raise ShapeError(f"The weights have shape {values.shape}, the views {views}.")
    if not (np.isfinite(values).all() and (values >= 0).all() and values.any()):
        raise ValueError("Weights of views are finite, not negative and not all 0.")
    return values
