"""Flat things that hide what lies behind them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from clplen.checks import is_finite, real_array
from clplen.compute.arrays import HostArray
from clplen.errors import ShapeError
from clplen.reprs import OneLine

Values = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Occluder(OneLine, HostArray):
    """A flat screen across the optical axis that attenuates the light of what lies behind it.

    It sends no light itself. Sample i of an axis of n samples covers a square about
    (i - n//2) width/nx from the axis, as in `PicturePlane`; beside the screen light passes.

    Parameters
    ----------
    opacity : array_like
        Shape (ny, nx), from 0 to 1: the share of the light's intensity that is stopped.
    width : float
        Of the whole screen along x in metres, nx samples.
    z : float
        In metres from the focused object plane; > 0 lies farther from the lens.

    Attributes
    ----------
    opacity : numpy.ndarray
        float64, shape (ny, nx).
    width, z : float
        As given, in metres.

    Raises
    ------
    ShapeError
        If the opacity is not two-dimensional or empty.
    TypeError
        If it is no array of real numbers.
    ValueError
        For an opacity, a width or a z outside their range.

    Examples
    --------
    >>> stops = np.zeros((4, 4))
    >>> stops[:, 2:] = 1.0  # nothing passes from x = -1 mm on
    >>> screen = clplen.cameras.Occluder(stops, 8e-3, z=-20e-3)  # before the focused plane
    >>> y, x = screen.edges()
    >>> np.round(x * 1e3, 3).tolist()  # in millimetres
    [-5.0, -3.0, -1.0, 1.0, 3.0]
    """

    _samples: ClassVar[str] = "opacity"

    opacity: Values
    width: float
    z: float

    def __init__(self, opacity: Any, width: float, z: float = 0.0) -> None:
        try:
            values = np.array(real_array(opacity, "An opacity", np.float64))
        except TypeError as error:
            raise TypeError(
                f"An opacity is an array of real numbers, (ny, nx), not {type(opacity).__name__}."
            ) from error
        if values.ndim != 2 or values.size == 0:
            raise ShapeError(f"An opacity has shape (ny, nx), not {values.shape}.")
        if not ((values >= 0) & (values <= 1)).all():
            raise ValueError("An opacity is a share, from 0 to 1, and no NaN.")
        if not (is_finite(width) and width > 0):
            raise ValueError(f"The width of a screen is positive, in metres, not {width!r}.")
        if not is_finite(z):
            raise ValueError(f"z of a screen is a finite number of metres, not {z!r}.")
        object.__setattr__(self, "opacity", values)
        object.__setattr__(self, "width", float(width))
        object.__setattr__(self, "z", float(z))

    def edges(self) -> tuple[Values, Values]:
        """Sides of the samples in metres, shapes (ny + 1,) and (nx + 1,)."""
        ny, nx = self.opacity.shape
        pitch = self.width / nx
        return tuple((np.arange(n + 1) - n // 2 - 0.5) * pitch for n in (ny, nx))
