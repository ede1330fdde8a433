"""Whether the light of a source, from everywhere on the object, reaches the first lens."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from clplen.errors import SamplingError
from clplen.wave.field import Field
from clplen.wave.parts import ConvergingLight, Lens, Part, Space, Stop
from clplen.wave.quantity import metres
from clplen.wave.spatial import SpatialModel
from clplen.wave.system import OpticalSystem


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
    found = _first_opening(system.parts) if isinstance(system, OpticalSystem) else None
    if found is None:
        return
    z, focus, diameter, centre = found
    angle = light.half_angle(field.wavelength)
    spread = z * math.tan(min(angle, math.pi / 2 * (1 - 1e-9)))
    for axis, name in enumerate("yx"):
        for edge in _edges(field, axis):
            lands = edge * (1 - z / focus)
            missed = abs(lands - centre[axis]) - diameter / 2 - spread
            if missed > 0:
                needed = math.atan((abs(lands - centre[axis]) - diameter / 2) / z)
                raise SamplingError(
                    f"The source's light from the edge of the object, {name} = {metres(edge)}, "
                    f"goes to {metres(lands)} at the first opening of D = {metres(diameter)} and "
                    f"spreads by {metres(spread)} only: it misses the pupil. Use koehler=True "
                    "(ConvergingLight), a smaller object, or a source of at least "
                    f"{needed:.3g} rad half angle for its {angle:.3g}."
                )


def _first_opening(
    parts: Sequence[Part],
) -> tuple[float, float, float, tuple[float, float]] | None:
    """Distance, focus of the light, diameter and centre of the first lens or stop."""
    z, focus = 0.0, math.inf
    for part in parts:
        if isinstance(part, ConvergingLight) and z == 0:
            focus = part.z
        elif isinstance(part, Space):
            z += part.z
        elif isinstance(part, Lens) and part.diameter is not None and z > 0:
            return z, focus, part.diameter, (0.0, 0.0)
        elif isinstance(part, Stop) and z > 0:
            return z, focus, part.diameter, part.centre
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
