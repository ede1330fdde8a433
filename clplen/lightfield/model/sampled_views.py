"""Protocols of light fields on a device or stored."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from clplen.lightfield.raw.raw_image import CameraModel, Spacing


class SampledViews(Protocol):
    """Views and their properties, on a device or stored; see `LightField`."""

    @property
    def parametrisation(self) -> str:
        """Parametrisation, "two-plane" or "point-angle"."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (v, u, y, x[, c])."""

    @property
    def spacing(self) -> Spacing | None:
        """Signed (dv, du, dy, dx) in metres."""

    @property
    def weights(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Weights of the views, shape (V, U)."""

    @property
    def camera(self) -> CameraModel | None:
        """Camera of the light field."""

    @property
    def positions(self) -> np.ndarray[Any, np.dtype[np.float64]] | None:
        """Positions of the views, shape (V, U, 2), in view steps."""

    @property
    def decode(self) -> str:
        """Decoding, "calibrated" or "naive"."""


class FocusableViews(SampledViews, Protocol):
    """Views with planes given by disparity or by alpha."""

    def disparity(self, alpha: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the disparity of the plane alpha = F/F'."""

    def alpha(self, disparity: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return alpha of a disparity; NaN without spacing."""
