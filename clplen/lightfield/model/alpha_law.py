"""Disparity, alpha = F/F', depth, and the corresponding shifts of the views.

A telecentric camera (`clplen.cameras.light_field_microscope`) has no F and no alpha; its depths z
are proportional to disparities.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import real_array
from clplen.errors import worded
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.raw.raw_image import CameraModel, Spacing, is_telecentric
from clplen.types import Array

Vector = np.ndarray[Any, np.dtype[np.float64]]


class AlphaLaw:
    """Methods of objects with ``spacing``, ``decode``, ``parametrisation`` and maybe ``camera``."""

    spacing: Spacing | None
    camera: CameraModel | None
    decode: str
    parametrisation: str

    def disparity(self, alpha: ArrayLike) -> Vector:
        """Compute the disparity of the plane alpha = F/F', in pixels a view step.

        d = -(1 - alpha) du/dx with the signed du of ``spacing``; for naive cells
        d = -(1/alpha - 1) du/dx.

        Raises
        ------
        ValueError
            If the light field has no spacing, its camera is telecentric, or alpha is not positive.
        """
        if is_telecentric(self):
            raise ValueError(
                "A telecentric camera, such as a microscope, has no alpha = F/F'; pass disparity "
                "(camera.disparity(z) of a plane)."
            )
        return self.disparity_of_shear(alpha)

    def disparity_of_shear(self, alpha: ArrayLike) -> Vector:
        """Compute `disparity` from 1 minus a shear, with or without an F."""
        ratio = self._view_ratio()
        values = real_array(alpha, "alpha", np.float64)
        if not (np.isfinite(values).all() and (values > 0).all()):
            raise ValueError(f"alpha = F/F' must be positive and finite, got {alpha!r}.")
        return -ratio * ((1 / values - 1) if self._inverse else (1 - values))

    def alpha(self, disparity: ArrayLike) -> Vector:
        """Return alpha of a disparity; NaN without spacing and for a telecentric camera."""
        if is_telecentric(self):
            return np.full_like(real_array(disparity, "disparity", np.float64), np.nan)
        return self.shear_alpha(disparity)

    def shear_alpha(self, disparity: ArrayLike) -> Vector:
        """Return 1 - dx/du of a plane, which equals alpha if there is an F; NaN without spacing."""
        values = real_array(disparity, "disparity", np.float64)
        if self.spacing is None or not np.isfinite(self.spacing).all():
            return np.full_like(values, np.nan)
        scaled = -values / self._view_ratio()
        return 1 / (1 + scaled) if self._inverse else 1 - scaled

    @property
    def _inverse(self) -> bool:
        """True for naive cells, except those of a telecentric camera, which are sub-images."""
        return self.decode == "naive" and not is_telecentric(self)

    def _view_ratio(self) -> float:
        """Return du/dx, signed."""
        require_two_plane(self.parametrisation, "alpha")
        if self.spacing is None or not np.isfinite(self.spacing).all():
            raise ValueError(
                "alpha needs the spacing of views and pixels in metres, which this light field "
                "does not have: "
                + worded(
                    python="pass spacing=(dv, du, dy, dx), or use disparity.",
                    command="use --disparities.",
                    file="use disparities.",
                )
            )
        return self.spacing[1] / self.spacing[3]


def require_two_plane(parametrisation: str, what: str) -> None:
    """Reject views that are directions."""
    if parametrisation != "two-plane":
        raise ValueError(
            f"{what} needs views at positions on the main lens, and the views of this light "
            "field are directions; call lf.resample('two-plane')."
        )


def depth_at(source: Any, disparity: ArrayLike) -> Vector:
    """Return z of disparities in metres, farther positive; NaN without a camera."""
    camera: Any = getattr(source, "camera", None)
    if camera is None:
        return np.full(np.shape(disparity), np.nan)
    if is_telecentric(source):
        return np.asarray(camera.z(disparity))
    return np.asarray(camera.dz(source.alpha(disparity)))


def shifts(lf: SampledViews, disparities: Vector) -> tuple[Vector, Vector]:
    """Return `view_shifts` of a light field; raise a ValueError if its views are directions."""
    require_two_plane(lf.parametrisation, "Focusing")
    return view_shifts(lf.spacing, lf.weights.shape, disparities, positions=lf.positions)


def view_shifts(
    spacing: Spacing | None,
    views: tuple[int, ...],
    disparities: Vector,
    *,
    positions: Vector | None = None,
) -> tuple[Vector, Vector]:
    """Return the pixels from a point's position in the centre view to that in every view."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    if positions is not None:
        v, u = np.moveaxis(positions, -1, 0)
    along_y = np.multiply.outer(disparities * row_ratio(spacing), -v)
    return along_y, np.multiply.outer(disparities, -u)


def row_ratio(spacing: Spacing | None) -> float:
    """Return the disparity along y over that along x, (dv/dy)/(du/dx); 1 if unknown.

    Directions of a telecentric camera have no spacing in metres; their steps count as equal.
    """
    if spacing is None:
        return 1.0
    dv, du, dy, dx = spacing
    return (dv / du if np.isfinite([dv, du]).all() else 1.0) * dx / dy


def require_overlap(lf: SampledViews, weights: Array, disparities: ArrayLike) -> None:
    """Reject planes on which no two views overlap within the picture."""
    if lf.positions is None:
        V, U, ny, nx = lf.shape[:4]
        view_range = max((V - 1) * abs(row_ratio(lf.spacing)) / ny, (U - 1) / nx)  # outermost views
        if np.abs(disparities).max() * view_range < 1:
            return
    require_steps_overlap(unit_steps(lf)[weights > 0], lf.shape, disparities)


def require_steps_overlap(steps: Vector, shape: tuple[int, ...], disparities: ArrayLike) -> None:
    """Check `require_overlap` for the `unit_steps` (n, 2) of some views of a light field."""
    values, limit = np.asarray(disparities, np.float64), overlap_limit(steps, shape)
    size = np.abs(values)
    tested = values.flat[size.argmin() if values.ndim == 2 else size.argmax()]
    if abs(tested) >= limit:
        raise ValueError(
            f"At disparity {tested:.6g} no two views overlap in pictures of {shape[2]} x "
            f"{shape[3]} pixels; choose disparities below {limit:.4g} in magnitude."
        )


def overlap_limit(steps: Vector, shape: tuple[int, ...]) -> float:
    """Return the disparity at which the last two views of these `unit_steps` stop overlapping."""
    positions = steps / shape[2:4]
    reach = np.abs(positions).max(axis=1)
    first = positions[np.argsort(reach)[:2]]
    bound = max(np.abs(first).max(), np.abs(first[0] - first[-1]).max())
    near = positions[reach <= bound]  # all others are farther out than these two are apart
    distance = np.abs(near[:, None] - near).max(axis=-1)
    outer = np.maximum.outer(*2 * [np.abs(near).max(axis=1)])
    pairs = np.maximum(distance, outer)[np.triu_indices(len(near), 1 if len(near) > 1 else 0)]
    return float(1 / pairs.min()) if pairs.min() else np.inf


def unit_steps(lf: SampledViews) -> Vector:
    """Return the pixels (y, x) from a point's centre-view position to each view's, for d = 1."""
    down, right = (along[0] for along in shifts(lf, np.ones(1)))
    if lf.positions is None:
        down, right = np.broadcast_arrays(down[:, None], right[None, :])
    return np.stack((down, right), axis=-1)
