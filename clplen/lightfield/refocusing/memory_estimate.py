"""Memory that a computation on a light field needs beside the samples, and how far it reaches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.model.alpha_law import shifts
from clplen.lightfield.model.sampled_views import SampledViews

Vector = np.ndarray[Any, np.dtype[np.float64]]

DEVICE_FLOAT = 4.5  # bytes of one on the device: its spare buffers are up to an eighth larger
HOST_FLOAT = 4  # bytes of one on the host
_TAPS = 2  # pixels beyond a shift that interpolations reach


@dataclass(frozen=True)
class MemoryEstimate:
    """What a computation needs beside the samples, so that it can be made in tiles."""

    what: str  # As the subject of a sentence
    planes: tuple[slice, ...]  # Groups of planes that are made one after the other of each tile
    halo: tuple[int, int]  # (y, x) pixels that a result depends on, on every side
    per_pixel: int  # Bytes a pixel that is read: temporary arrays and results, on device and host
    largest: int  # Those of the largest array among them
    kept: int = 0  # Bytes a pixel of the whole picture that are held until the end
    before: int = 0  # Those that are held, at most, before and after the pass over the tiles
    passes: int = 1  # How often all samples are read


def shear_halo(source: SampledViews, planes: Vector, reach: int) -> tuple[int, int]:
    """Pixels (y, x) around a tile: as far as the planes shift views, and windows reach."""
    ends = np.array([planes.min(), planes.max()])  # shifts are linear in the disparity
    down, right = shifts(source, ends)
    if source.positions is None:
        down, right = np.broadcast_arrays(down[:, :, None], right[:, None, :])
    lit = source.weights > 0
    y, x = (int(np.ceil(np.abs(shift[:, lit]).max())) + _TAPS + reach for shift in (down, right))
    return min(y, source.shape[2]), min(x, source.shape[3])
