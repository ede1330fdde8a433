"""Views as pinhole cameras: their positions and projections in metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import real_array
from clplen.errors import ShapeError
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import is_telecentric
from clplen.reprs import OneLine

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, repr=False, eq=False)
class ViewCameras(OneLine):
    """Pinhole cameras with parallel axes, one for each view, from `view_cameras`.

    Points are (x, y, z): x right, y down, z along the axes, from the pinhole of the centre view. A
    camera at C images a point at pixel (f_y (y - C_y)/z + c_y, f_x (x - C_x)/z + c_x). If zero
    disparity lies at a finite distance, the principal points c shift between views: the cameras
    look through one window (off-axis frusta).

    Attributes
    ----------
    centres : numpy.ndarray
        Positions (y, x) of the pinholes, shape (V, U, 2), in the unit of lengths.
    principal : numpy.ndarray
        Principal points (y, x) in pixels with integer centres, shape (V, U, 2).
    focal : tuple of float
        Focal lengths (f_y, f_x) in pixels.
    baseline : float
        Step between neighbouring views of a row; negative if views are stored by increasing
        aperture coordinate, so that nearer objects have smaller disparities.
    focus : float
        Distance of zero disparity; inf if infinite.
    size : tuple of int
        Size (y, x) of a view in pixels.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.ones((3, 5, 24, 32), np.float32))
    >>> cameras = clplen.lightfield.view_cameras(
    ...     lf, baseline=1e-3, focal_length=0.05, pixel_pitch=1e-5)
    >>> cameras.distance([5.0, 2.5]).tolist()
    [1.0, 2.0]
    """

    centres: Array
    principal: Array
    focal: tuple[float, float]
    baseline: float
    focus: float
    size: tuple[int, int]

    def project(self, points: ArrayLike) -> Array:
        """Project points to pixels in each view.

        Parameters
        ----------
        points : array_like
            Points x, y, z, shape (n, 3).

        Returns
        -------
        numpy.ndarray
            Pixels (y, x), shape (V, U, n, 2).
        """
        x, y, z = np.moveaxis(real_array(points, "points", np.float64), -1, 0)
        across = np.stack((y, x), -1)
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = (across - self.centres[:, :, None]) / z[:, None]
        return np.asarray(slopes * np.asarray(self.focal) + self.principal[:, :, None])

    def distance(self, disparity: ArrayLike) -> Array:
        """Compute the distance z of a disparity; inf at infinity, NaN beyond it.

        Parameters
        ----------
        disparity : array_like
            Disparity in pixels a view step.

        Returns
        -------
        numpy.ndarray
            Distance, float64: 1/z = d/(f_x b) + 1/z0 (Honauer et al. 2016).
        """
        inverse = real_array(disparity, "disparity", np.float64) / (self.focal[1] * self.baseline)
        inverse = inverse + 1 / self.focus
        with np.errstate(divide="ignore"):
            return np.where(inverse >= 0, 1 / np.abs(inverse), np.nan)

    def points(self, disparity: ArrayLike) -> Array:
        """Compute the points of the centre view's pixels.

        Parameters
        ----------
        disparity : array_like
            Disparity of shape (y, x).

        Returns
        -------
        numpy.ndarray
            Points x, y, z, shape (y, x, 3); NaN for points at no finite distance.

        Raises
        ------
        ShapeError
            If the disparity does not have the views' size.
        """
        d = real_array(disparity, "disparity", np.float64)
        if d.shape != self.size:
            raise ShapeError(f"disparity must have shape {self.size}, got {d.shape}.")
        z = self.distance(d)
        z[np.isinf(z)] = np.nan
        y, x = (axis - (n - 1) / 2 for axis, n in zip(np.indices(d.shape), d.shape, strict=True))
        return np.stack([x * z / self.focal[1], y * z / self.focal[0], z], -1)


def view_cameras(
    lf: SampledViews | ArrayLike,
    *,
    baseline: float | None = None,
    focal_length: float | None = None,
    pixel_pitch: float | None = None,
    focus_distance: float | None = None,
) -> ViewCameras:
    """Return pinhole cameras for the views of a light field.

    The lengths, if set, describe views of square pixels. Otherwise the light field's camera is
    used: by the lens law its main lens images the plane at F/(F/f - 1) on the array, and the views
    are pinholes on the lens.

    Parameters
    ----------
    lf : LightField or array_like
        Light field or `StoredLightField`; only shape, spacing and camera are used.
    baseline, focal_length, pixel_pitch : float, optional
        Step between views of a row, distance from pinhole to sensor, and pitch of the pixels, in
        metres or any other unit; all three or none.
    focus_distance : float, optional
        Distance of zero disparity; default infinity.

    Returns
    -------
    ViewCameras
        Camera of each view.

    Raises
    ------
    ValueError
        If some of the lengths are missing, a length is not positive and finite, no camera is known,
        or the views are directions.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.ones((3, 5, 24, 32), np.float32))
    >>> cameras = clplen.lightfield.view_cameras(
    ...     lf, baseline=1e-3, focal_length=0.05, pixel_pitch=1e-5, focus_distance=2.0)
    >>> cameras.centres[1, 4].tolist(), cameras.principal[1, 4].tolist()
    ([0.0, 0.002], [11.5, 20.5])
    >>> np.round(cameras.project([(0, 0, 1.0)])[1, :, 0, 1], 6).tolist()  # d = 2.5
    [20.5, 18.0, 15.5, 13.0, 10.5]
    """
    lengths = {"baseline": baseline, "focal_length": focal_length, "pixel_pitch": pixel_pitch}
    lengths_given = [value for value in lengths.values() if value is not None]
    if lengths_given and len(lengths_given) < len(lengths):
        raise ValueError("Pass baseline=, focal_length= and pixel_pitch= together.")
    if not lengths_given and focus_distance is not None:
        raise ValueError("focus_distance= requires baseline=, focal_length= and pixel_pitch=.")
    checked = lengths if focus_distance is None else lengths | {"focus_distance": focus_distance}
    for name, value in checked.items() if lengths_given else ():
        if value is None or not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a positive and finite length, got {value!r}.")
    views: Any = lf if hasattr(lf, "weights") else as_lightfield(lf)
    steps = unit_steps(views)
    if baseline is None or focal_length is None or pixel_pitch is None:
        step, focal, focus = _of_camera(views)
    else:
        step, focal = float(baseline), (focal_length / pixel_pitch,) * 2
        focus = np.inf if focus_distance is None else float(focus_distance)
    across = np.array([focal[1] / focal[0], 1.0]) * step  # (y, x) of a pixel for a view step
    centres = 0.0 - steps * across
    size = (int(views.shape[2]), int(views.shape[3]))
    middle = (np.array(size) - 1) / 2
    return ViewCameras(
        centres, middle + np.array(focal) * centres / focus, focal, step, focus, size
    )


def _of_camera(lf: SampledViews) -> tuple[float, tuple[float, float], float]:
    """Return baseline, focal lengths (y, x) in pixels and focus distance from the camera."""
    camera: Any = lf.camera
    naive = lf.decode == "naive"
    if camera is None or lf.spacing is None or naive or is_telecentric(lf):
        kind = "directions, as of a telecentric camera" if is_telecentric(lf) else "unknown"
        raise ValueError(
            f"The cameras of these views are {kind}; pass baseline=, focal_length= and "
            "pixel_pitch=."
        )
    _, du, dy, dx = lf.spacing
    F = float(camera.image_distance)
    rest = float(camera.alpha(np.inf)) - 1
    focus = F / rest if rest > 0 else np.inf
    return -du * float(np.sign(dx)), (F / abs(dy), F / abs(dx)), focus
