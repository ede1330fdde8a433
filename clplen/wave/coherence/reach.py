"""Whether the light of a source, from everywhere on the object, reaches the first lens."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.errors import SamplingError
from clplen.wave.coherence.spatial_models import SpatialModel
from clplen.wave.field.field import Field
from clplen.wave.field.number_format import metres
from clplen.wave.systems.components import ConvergingLight, Lens, Part, Space, Stop
from clplen.wave.systems.optical_system import OpticalSystem


def check_reach(system: Any, field: Field, light: SpatialModel) -> None:
    """Refuse light of which nothing from the edge of the object reaches the first opening.

    Light leaves the object parallel to the axis, or towards the focus of `ConvergingLight`, and
    spreads by the half angle of the source. Only an `OpticalSystem` that begins with free space can
    be judged.

    Parameters
    ----------
    system : callable
    field : Field
        The object, shape (ny, nx).
    light : SpatialModel

    Raises
    ------
    SamplingError
        With where the light goes, how far it spreads and what would do.
    """
    opening = _first_opening(system.parts) if isinstance(system, OpticalSystem) else None
    if opening is not None:
        check_opening(field, light, opening)


@dataclass(frozen=True)
class Opening:
    """The first lens or stop behind an object.

    Attributes
    ----------
    z : float
        From the object, in metres.
    diameter : float
    focus : float
        Where the light converges, in metres from the object; infinite: it is parallel.
    centre : tuple of float
        (y, x) in metres.
    """

    z: float
    diameter: float
    focus: float = math.inf
    centre: tuple[float, float] = (0.0, 0.0)


def check_opening(field: Field, light: SpatialModel, opening: Opening) -> None:
    """As `check_reach`, of an opening that is known.

    Parameters
    ----------
    field : Field
    light : SpatialModel
    opening : Opening

    Raises
    ------
    SamplingError
    """
    angle = light.half_angle(field.wavelength)
    spread = opening.z * math.tan(min(angle, math.pi / 2 * (1 - 1e-9)))
    for axis, name in enumerate("yx"):
        for edge in _edges(field, axis):
            lands = edge * (1 - opening.z / opening.focus)
            beside = abs(lands - opening.centre[axis]) - opening.diameter / 2
            if beside > spread:
                raise SamplingError(
                    f"The source's light from the edge of the object, {name} = {metres(edge)}, "
                    f"goes to {metres(lands)} at the first opening of D = "
                    f"{metres(opening.diameter)} and spreads by {metres(spread)} only: it misses "
                    "the pupil. Use koehler=True (ConvergingLight), a smaller object, or a source "
                    f"of at least {math.atan(beside / opening.z):.3g} rad half angle for its "
                    f"{angle:.3g}."
                )


def _first_opening(parts: Sequence[Part]) -> Opening | None:
    """The first lens or stop behind free space alone."""
    z, focus = 0.0, math.inf
    for part in parts:
        if isinstance(part, ConvergingLight) and z == 0:
            focus = part.z
        elif isinstance(part, Space):
            z += part.z
        elif isinstance(part, Lens) and part.diameter is not None and z > 0:
            return Opening(z, part.diameter, focus)
        elif isinstance(part, Stop) and z > 0:
            return Opening(z, part.diameter, focus, part.centre)
        else:
            return None
    return None


def _edges(field: Field, axis: int) -> list[float]:
    """First and last coordinate along an axis at which the object is clear."""
    if field.grid.shape[axis] == 1:
        return []
    clear = np.flatnonzero((np.abs(field.to_numpy()) > 0).any(axis=1 - axis))
    coordinates = (field.grid.y, field.grid.x)[axis]
    return [float(coordinates[i]) for i in (clear[0], clear[-1])] if clear.size else []
