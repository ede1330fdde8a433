"""How much of a point's light leaves the cells of the lenslets that its cone of rays meets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.analysis.crosstalk import crosstalk, energy_in_cell
from clplen.analysis.placing import beside_lenslet, is_focused, middle_lenslet

if TYPE_CHECKING:
    from clplen.cameras.plenoptic import Plenoptic


def camera_crosstalk(camera: Plenoptic | Any) -> float:
    """Share of the light of a point of the focused plane outside the cells of its own lenslets.

    The point's chief ray goes through the centre of the middle lenslet. Of a 1.0 camera that one is
    the point's own (`crosstalk`); of a 2.0 camera all those are that the cone of rays, D abs(a)/F
    wide on the array, meets, with the cells of their sub-images.

    Parameters
    ----------
    camera : Plenoptic

    Returns
    -------
    float
        Between 0 and 1.
    """
    raw = camera.expose(beside_lenslet(camera, (0.0, 0.0), 0.0))
    light, middle = np.asarray(raw.to_numpy(), np.float64), middle_lenslet(camera)
    if not is_focused(camera):
        return crosstalk(light, raw.cells, cell=middle)
    own = sum(energy_in_cell(light, raw.sub_images, cell) for cell in met(camera, middle))
    return max(0.0, 1 - own / float(light.sum()))


def met(camera: Any, middle: tuple[int, int]) -> list[tuple[int, int]]:
    """(row, column) of the lenslets that the cone through one of them meets, itself included."""
    reach = camera.aperture_diameter * abs(camera.a) / camera.image_distance / 2
    mla = camera.mla
    centres = np.asarray(mla.centres())
    cos, sin = np.cos(mla.rotation), np.sin(mla.rotation)
    across = np.abs((centres - centres[middle]) @ [[cos, sin], [-sin, cos]])  # along its rows
    beyond = np.maximum(across - np.array((mla.row_pitch, mla.pitch)) / 2, 0)
    inside = np.hypot(beyond[..., 0], beyond[..., 1]) < max(reach, 1e-9)
    return [(int(i), int(k)) for i, k in np.argwhere(inside)]
