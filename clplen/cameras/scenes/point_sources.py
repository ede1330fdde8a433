"""What a camera looks at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.compute import lengths
from clplen.compute.oneline import OneLine


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PointSources(OneLine):
    """Mutually incoherent point-like sources.

    Parameters
    ----------
    positions : array_like
        Shape (n, 3) or (3,): (x, y, dz) in metres relative to the axis point of the focused object
        plane; dz > 0 lies farther from the lens.
    diameter : float
        Each source is a uniform coherent disc of this diameter in metres; 0 is a point.
    power : float or array_like
        Energy that leaves the main lens' aperture, one or one per source, not negative.

    Attributes
    ----------
    positions : numpy.ndarray
        float64, shape (n, 3).
    diameter : float
    power : numpy.ndarray
        float64, shape (n,).

    Raises
    ------
    ValueError
        If a position is not three finite numbers, there is none, the diameter or a power is
        negative, or there are not as many powers as positions.
    """

    positions: np.ndarray[Any, np.dtype[np.float64]]
    diameter: float
    power: np.ndarray[Any, np.dtype[np.float64]]

    def __init__(
        self,
        positions: Sequence[Sequence[float]] | np.ndarray[Any, Any],
        *,
        diameter: float = 0.0,
        power: float | Sequence[float] | np.ndarray[Any, Any] = 1.0,
    ) -> None:
        places = np.atleast_2d(np.asarray(positions, np.float64)).copy()
        if places.ndim != 2 or places.shape[1] != 3 or places.shape[0] == 0:
            raise ValueError(
                f"Positions are (x, y, dz) for each source, shape (n, 3), not {places.shape}."
            )
        if not np.isfinite(places).all():
            raise ValueError("Positions of sources are finite numbers of metres.")
        if not (np.isfinite(diameter) and diameter >= 0):
            raise ValueError(f"The diameter of sources is not negative, in metres, not {diameter}.")
        lengths.POINT.check(diameter, "The diameter of sources")
        powers = np.asarray(power, np.float64)
        if powers.ndim and powers.shape != (len(places),):
            raise ValueError(f"{len(places)} sources have {powers.shape} powers: give one or each.")
        powers = np.broadcast_to(powers, (len(places),)).copy()
        if not (np.isfinite(powers).all() and (powers >= 0).all()):
            raise ValueError("Powers of sources are finite and not negative.")
        object.__setattr__(self, "positions", places)
        object.__setattr__(self, "diameter", float(diameter))
        object.__setattr__(self, "power", powers)

    def __len__(self) -> int:
        return len(self.positions)
