"""Letters and a star as surfaces before a plenoptic camera, by rays: figures 1.1 and 1.26.

Pictures lie upside down behind the lens and are shown turned by 180 degrees: Y goes up and X to
the left, in lenslets from the middle of the array.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.path import Path
from matplotlib.textpath import TextPath

from clplen import SurfaceScene
from clplen.cameras import Plane, Polygon, Texture, uniform

FINE = 5  # samples a lenslet


def outline(letter: str, place: Sequence[float], size: float) -> list[np.ndarray]:
    """Contours (Y, X) of a letter about a place (Y, X); ``size`` of its font, all in lenslets."""
    lines = TextPath((0, 0), letter, size=size, prop={"weight": "bold"}).to_polygons()
    ends = np.vstack(lines)
    middle = (ends.max(axis=0) + ends.min(axis=0)) / 2
    return [((one - middle) * (-1, 1))[:-1, ::-1] + place for one in lines]


def disparity(camera: Any, dz: float) -> float:
    """d of the plane dz in the light field on the array, (1 - z2/F') du/p."""
    du = camera.pixel_pitch * camera.array_distance / camera.sensor_distance
    return float(1 - camera.array_alpha(dz)) * du / camera.mla.pitch


def scene(camera: Any, letters: dict[str, tuple[float, Sequence[float], float]]) -> SurfaceScene:
    """White letters on black, {letter: (dz, (Y, X), size)}."""
    return SurfaceScene([Plane(disparity(camera, dz), texture=uniform(1.0),
                               outline=Polygon(*outline(letter, place, size)))
                         for letter, (dz, place, size) in letters.items()])


def covered(letter: str, place: Sequence[float], size: float, at: np.ndarray) -> np.ndarray:
    """The share of cells that a letter covers; cells in rows and columns at ``at``, in lenslets."""
    cell = at[1] - at[0]
    fine = (at[:, None] + cell * ((np.arange(FINE) + 0.5) / FINE - 0.5)).ravel()
    where = np.stack(np.meshgrid(fine, fine, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = sum(Path(one).contains_points(where) for one in outline(letter, place, size)) % 2
    return inside.reshape(len(at), FINE, len(at), FINE).mean(axis=(1, 3))


def star(count: int) -> Texture:
    """A star of 36 rays over so many lenslets, six samples a lenslet."""
    y, x = np.meshgrid(*[np.arange(-3 * count - 24, 3 * count + 24) / 6] * 2, indexing="ij")
    rim = 1 - np.exp(-((np.hypot(y, x) / 5) ** 4))
    return Texture(0.5 + 0.4 * rim * np.tanh(3 * np.sin(36 * np.arctan2(y, x))), 1 / 6)
