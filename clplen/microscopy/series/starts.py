"""Volumes that a frame of a series begins with, made of the volume of a frame before it.

    previous   V' = V
    decayed    V' = c V^s, c so that the light is the same    a share s of the contrast (of log V)
    limited    V' = G V, Gaussian windows as wide as things move until that frame

Richardson and Lucy multiply: a voxel that begins dark stays dark for long, and one that begins
bright where nothing is any more dims slowly. What moves leaves a trail in "previous"; the other two
give light to places that things can have moved to. None of their voxels is 0, where it would stay.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from scipy.ndimage import gaussian_filter

from clplen.checks import is_finite
from clplen.microscopy.model.point_image_files import AnyImages

Vector = np.ndarray[Any, Any]
StartName = Literal["previous", "decayed", "limited"]

NAMES: tuple[str, ...] = get_args(StartName)
FLOOR = 1e-3  # of the mean voxel: no voxel of a start is at 0
WIDTH = 4.0  # standard deviations that a window reaches


class Start:
    """How frames of a series begin."""

    def __init__(
        self,
        name: StartName | None,
        images: AnyImages,
        *,
        decay: float = 0.5,
        motion: float | None = None,
    ) -> None:
        if name not in (None, *NAMES):
            raise ValueError(f"start is {', '.join(map(repr, NAMES))} or None, not {name!r}.")
        if not (is_finite(decay) and 0 <= decay <= 1):
            raise ValueError(f"decay is a number from 0 to 1, not {decay!r}.")
        if motion is not None and not (is_finite(motion) and motion > 0):
            raise ValueError(f"motion is a positive length in metres or None, not {motion!r}.")
        self.name, self.decay = name, float(decay)
        self.motion = 0.5 * images.side if motion is None else float(motion)
        self._side = images.side
        self._step = _step(images.planes)

    @property
    def words(self) -> list[str | float | None]:
        """What a volume depends on, of JSON."""
        number = {"decayed": self.decay, "limited": self.motion}.get(self.name or "")
        return [self.name, number]

    def volumes(self, before: Vector, frames: int) -> Vector | None:
        """Volumes to begin with."""
        if self.name is None:
            return None
        mean = float(before.mean(dtype=np.float64))
        found = before[None]
        if self.name == "decayed":
            found = np.maximum(found, 0) ** np.float32(self.decay)
            found = found * np.float32(mean / max(float(found.mean(dtype=np.float64)), 1e-30))
        if self.name == "limited":
            found = np.stack([self._spread(before, frame + 1) for frame in range(frames)])
        return np.maximum(found, np.float32(FLOOR * mean))

    def _spread(self, volume: Vector, steps: int) -> Vector:
        """A volume smoothed by the way of so many frames; unequal planes are not mixed."""
        way, across = self.motion * steps, self.motion * steps / self._side
        sigma = (0.0 if self._step is None else way / self._step, across, across)
        return np.asarray(gaussian_filter(volume, sigma, mode="nearest", truncate=WIDTH))


def _step(planes: Vector) -> float | None:
    """The distance of planes that are equidistant; None of others."""
    steps = np.abs(np.diff(planes))
    if steps.size == 0 or np.ptp(steps) > 1e-6 * steps[0]:
        return None
    return float(steps[0])
