"""How disparity and alpha = F/F' belong together: one law for every form of a light field.

A telecentric camera (`clplen.cameras.light_field_microscope`) has no F and so no alpha: it has
disparities, and depths z that are proportional to them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.parametrisation import require_two_plane
from clplen.lightfield.raw import is_telecentric

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clplen.lightfield.raw import CameraModel, Spacing

Vector = np.ndarray[Any, np.dtype[np.float64]]


class AlphaLaw:
    """Methods of what has ``spacing``, ``decode``, ``parametrisation`` and perhaps ``camera``."""

    spacing: Spacing | None
    camera: CameraModel | None
    decode: str
    parametrisation: str

    def disparity(self, alpha: ArrayLike) -> Vector:
        """Disparity, in pixels a view step, of the plane alpha = F/F'.

        d = -(1 - alpha) du/dx with the signed du of ``spacing``; naive cells: -(1/alpha - 1) du/dx.

        Raises
        ------
        ValueError
            If the light field has no spacing, its camera is telecentric, or an alpha is not
            positive.
        """
        if is_telecentric(self):
            raise ValueError(
                "A telecentric camera, such as a microscope, has no alpha = F/F': give disparity "
                "(camera.disparity(z) is that of a plane)."
            )
        return self.disparity_of_shear(alpha)

    def disparity_of_shear(self, alpha: ArrayLike) -> Vector:
        """`disparity` of 1 minus a shear, whether there is an F or not."""
        ratio = self._view_ratio()
        values = np.asarray(alpha, np.float64)
        if not (np.isfinite(values).all() and (values > 0).all()):
            raise ValueError(f"alpha = F/F' is positive and finite, not {alpha!r}.")
        return -ratio * ((1 / values - 1) if self._inverse else (1 - values))

    def alpha(self, disparity: ArrayLike) -> Vector:
        """The inverse of `disparity`; NaN without spacing and for a telecentric camera."""
        if is_telecentric(self):
            return np.full_like(np.asarray(disparity, np.float64), np.nan)
        return self.shear_alpha(disparity)

    def shear_alpha(self, disparity: ArrayLike) -> Vector:
        """1 - dx/du of a plane, which is alpha where there is an F; NaN without spacing."""
        values = np.asarray(disparity, np.float64)
        if self.spacing is None or not np.isfinite(self.spacing).all():
            return np.full_like(values, np.nan)
        scaled = -values / self._view_ratio()
        return 1 / (1 + scaled) if self._inverse else 1 - scaled

    @property
    def _inverse(self) -> bool:
        """Whether cells are naive and not sub-images too, as those of a telecentric camera are."""
        return self.decode == "naive" and not is_telecentric(self)

    def _view_ratio(self) -> float:
        """du/dx, signed."""
        require_two_plane(self, "alpha")
        if self.spacing is None or not np.isfinite(self.spacing).all():
            raise ValueError(
                "alpha needs the spacing of views and pixels in metres, which this light field "
                "does not have: give spacing=(dv, du, dy, dx), or use disparity."
            )
        return self.spacing[1] / self.spacing[3]


def depth_at(source: Any, disparity: ArrayLike) -> Vector:
    """z of planes of a disparity in metres, farther positive; NaN without a camera."""
    camera: Any = getattr(source, "camera", None)
    if camera is None:
        return np.full(np.shape(disparity), np.nan)
    if is_telecentric(source):
        return np.asarray(camera.z(disparity))
    return np.asarray(camera.dz(source.alpha(disparity)))
