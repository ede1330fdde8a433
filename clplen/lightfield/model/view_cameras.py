"""Views as pinhole cameras: where each stands and what it sees, in metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import float64_array
from clplen.errors import ShapeError
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.raw.raw_image import is_telecentric
from clplen.reprs import OneLine

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, repr=False, eq=False)
class ViewCameras(OneLine):
    """Pinhole cameras with parallel axes, one a view; made by `view_cameras`.

    Points are (x, y, z): x right, y down, z along the axes, from the pinhole of the centre view.
    A camera at C images a point at pixel (f_y (y - C_y)/z + c_y, f_x (x - C_x)/z + c_x). Where
    disparity 0 lies at a finite distance, the principal points c shift from view to view: the
    cameras look through one window (off-axis frusta).

    Attributes
    ----------
    centres : numpy.ndarray
        Shape (V, U, 2): (y, x) of the pinholes, in the unit of lengths.
    principal : numpy.ndarray
        Shape (V, U, 2): (y, x) of the principal points, pixels, whose centres are whole numbers.
    focal : tuple of float
        (f_y, f_x) in pixels.
    baseline : float
        Step between neighbouring views of a row; negative where views are stored by increasing
        aperture coordinate, so that nearer things have smaller disparities.
    focus : float
        The distance where disparity is 0; inf if it is infinite.
    size : tuple of int
        (y, x) pixels of a view.

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
        """Return where each view images points.

        Parameters
        ----------
        points : array_like
            Shape (n, 3): x, y, z.

        Returns
        -------
        numpy.ndarray
            Shape (V, U, n, 2): (y, x) in pixels.
        """
        x, y, z = np.moveaxis(float64_array(points), -1, 0)
        across = np.stack((y, x), -1)
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = (across - self.centres[:, :, None]) / z[:, None]
        return np.asarray(moved * np.asarray(self.focal) + self.principal[:, :, None])

    def distance(self, disparity: ArrayLike) -> Array:
        """Return z of points of a disparity; inf at infinity, NaN beyond it.

        Parameters
        ----------
        disparity : array_like
            Pixels a view step.

        Returns
        -------
        numpy.ndarray
            float64: 1/z = d/(f_x b) + 1/z0 (Honauer et al. 2016).
        """
        inverse = float64_array(disparity) / (self.focal[1] * self.baseline)
        inverse = inverse + 1 / self.focus
        with np.errstate(divide="ignore"):
            return np.where(inverse >= 0, 1 / np.abs(inverse), np.nan)

    def points(self, disparity: ArrayLike) -> Array:
        """Return the points that the pixels of the centre view show.

        Parameters
        ----------
        disparity : array_like
            Shape (y, x).

        Returns
        -------
        numpy.ndarray
            Shape (y, x, 3): x, y, z; NaN where a point does not lie at a finite distance.

        Raises
        ------
        ShapeError
            If there is not one disparity for every pixel.
        """
        d = np.asarray(disparity, np.float64)
        if d.shape != self.size:
            raise ShapeError(f"The map has shape {d.shape}, the views have {self.size} pixels.")
        z = self.distance(d)
        z[np.isinf(z)] = np.nan
        y, x = (axis - (n - 1) / 2 for axis, n in zip(np.indices(d.shape), d.shape, strict=True))
        return np.stack([x * z / self.focal[1], y * z / self.focal[0], z], -1)


def view_cameras(
    lf: SampledViews,
    *,
    baseline: float | None = None,
    focal_length: float | None = None,
    pixel_pitch: float | None = None,
    focus_distance: float | None = None,
) -> ViewCameras:
    """Return the cameras of the views of a light field.

    Lengths that are given stand for views of square pixels. Without any, the light field's own
    camera is taken: by the lens law its main lens images the plane at F/(F/f - 1) on the array,
    and the views are pinholes on the lens.

    Parameters
    ----------
    lf : LightField
        Or a `StoredLightField`: its shape, spacing and camera are looked at.
    baseline, focal_length, pixel_pitch : float, optional
        The step from view to view of a row, the distance from pinhole to sensor and the pitch of
        the pixels, in metres or any other unit, all three or none.
    focus_distance : float, optional
        Where disparity is 0; default infinity.

    Returns
    -------
    ViewCameras
        One camera for each view.

    Raises
    ------
    ValueError
        If a part of the lengths is given, one is not positive and finite, no camera is known
        without them, or the views are directions.

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
    given = [value for value in lengths.values() if value is not None]
    if given and len(given) < len(lengths):
        raise ValueError("Cameras of views need baseline=, focal_length=, pixel_pitch= together.")
    if not given and focus_distance is not None:
        raise ValueError("focus_distance= belongs to baseline=, focal_length=, pixel_pitch=.")
    checked = lengths if focus_distance is None else lengths | {"focus_distance": focus_distance}
    for name, value in checked.items() if given else ():
        if value is None or not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is a length, positive and finite, not {value!r}.")
    steps = unit_steps(lf)
    if baseline is None or focal_length is None or pixel_pitch is None:
        step, focal, focus = _of_camera(lf)
    else:
        step, focal = float(baseline), (focal_length / pixel_pitch,) * 2
        focus = np.inf if focus_distance is None else float(focus_distance)
    across = np.array([focal[1] / focal[0], 1.0]) * step  # (y, x) for a pixel of a step
    centres = 0.0 - steps * across
    size = (int(lf.shape[2]), int(lf.shape[3]))
    middle = (np.array(size) - 1) / 2
    return ViewCameras(
        centres, middle + np.array(focal) * centres / focus, focal, step, focus, size
    )


def _of_camera(lf: SampledViews) -> tuple[float, tuple[float, float], float]:
    """Baseline, focal lengths (y, x) in pixels and distance of d = 0 that a camera tells."""
    camera: Any = lf.camera
    naive = lf.decode == "naive"
    if camera is None or lf.spacing is None or naive or is_telecentric(lf):
        kind = "directions, as of a telecentric camera" if is_telecentric(lf) else "unknown"
        raise ValueError(
            f"The cameras of these views are {kind}: give baseline=, focal_length= and "
            "pixel_pitch=."
        )
    _, du, dy, dx = lf.spacing
    F = float(camera.image_distance)
    rest = float(camera.alpha(np.inf)) - 1
    focus = F / rest if rest > 0 else np.inf
    return -du * float(np.sign(dx)), (F / abs(dy), F / abs(dx)), focus
