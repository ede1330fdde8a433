"""What functions of this room ask of a light field, on a device or stored."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from clplen.lightfield.raw.raw_image import CameraModel, Spacing


class SampledViews(Protocol):
    """Views and what is known of them, wherever the samples are; as in `LightField`."""

    @property
    def parametrisation(self) -> str:
        """ "two-plane" or "point-angle"."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(v, u, y, x[, c])."""

    @property
    def spacing(self) -> Spacing | None:
        """Signed (dv, du, dy, dx) in metres."""

    @property
    def weights(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Of the views, shape (V, U)."""

    @property
    def camera(self) -> CameraModel | None:
        """The camera that took it."""

    @property
    def positions(self) -> np.ndarray[Any, np.dtype[np.float64]] | None:
        """Of the views, shape (V, U, 2), in view steps."""

    @property
    def decode(self) -> str:
        """ "calibrated" or "naive"."""


class FocusableViews(SampledViews, Protocol):
    """Views whose planes are given by disparity or by alpha."""

    def disparity(self, alpha: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Disparity of the plane alpha = F/F'."""

    def alpha(self, disparity: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
        """The inverse; NaN without spacing."""
