"""Where a camera's point sources are put so that its picture is sampled below a lenslet."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.analysis.samples import Pair, Values
from clplen.cameras.optics.camera_aberrations import NONE
from clplen.cameras.plenoptic import Plenoptic
from clplen.cameras.scenes.scene_sources import PointSources


def is_focused(camera: Any) -> bool:
    """Whether it is a focused (2.0) camera."""
    return bool(camera.kind == "focused")


def offsets(step: float, count: int) -> Values:
    """``count`` places a step / count apart about 0, which together sample a grid of that step."""
    return np.asarray((np.arange(count) - (count - 1) / 2) * (step / count), np.float64)


def middle_lenslet(camera: Plenoptic) -> tuple[int, int]:
    """(row, column) of the lenslet next to the middle of the array, in a row that is not moved."""
    rows, columns = camera.mla.count
    row = rows // 2
    return row - (row % 2 if camera.mla.lattice == "hexagonal" else 0), columns // 2


def beside_lenslet(camera: Plenoptic, offset: Pair, dz: float) -> PointSources:
    """A point whose chief ray meets the array beside the middle lenslet's centre.

    Parameters
    ----------
    camera : Plenoptic
    offset : tuple of float
        Along the columns and the rows of the array, (y, x) in metres where it is not turned.
    dz : float
        Of the point, in metres.
    """
    turn = camera.mla.rotation
    y, x = offset
    across = (y * np.cos(turn) + x * np.sin(turn), -y * np.sin(turn) + x * np.cos(turn))
    place = np.asarray(camera.mla.centres()[middle_lenslet(camera)]) + across
    place = place / camera.array_scale(dz)
    return PointSources([(place[1], place[0], dz)])


def is_mirrored(camera: Plenoptic) -> bool:
    """Whether a camera looks the same in a mirror through the middle lenslet, both ways."""
    mla = camera.mla
    plain = mla.lattice == "square" and len(mla.focal_lengths) == 1
    centred = mla.rotation == 0 and tuple(mla.offset) == (0, 0) and all(n % 2 for n in mla.count)
    return plain and centred and camera.aberrations == NONE
