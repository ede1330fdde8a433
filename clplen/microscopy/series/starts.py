"""Initial volume of a frame of a series, derived from the volume V of a previous frame.

    previous   V' = V
    decayed    V' = c V^s, a share s of the contrast (of log V); c conserves the total light
    limited    V' = G V, with Gaussian windows as wide as objects move until the frame

Richardson-Lucy steps are multiplicative: a dark voxel brightens slowly, and a bright voxel dims
slowly after an object has left it. Moving objects therefore leave a trail with "previous", while
"decayed" and "limited" add light where objects can have moved to. No voxel starts at 0, where it
would stay.
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
FLOOR = 1e-3  # minimum of an initial voxel over the mean voxel: a voxel at 0 would stay at 0
WINDOW_SIGMAS = 4.0  # half width of a window; less than 1e-4 of a Gaussian lies beyond it


class Start:
    """Rule for the initial volumes of the frames of a series."""

    def __init__(
        self,
        name: StartName | None,
        images: AnyImages,
        *,
        decay: float = 0.5,
        motion: float | None = None,
    ) -> None:
        if name not in (None, *NAMES):
            names = ", ".join(map(repr, NAMES))
            raise ValueError(f"start must be {names} or None, got {name!r}.")
        if not (is_finite(decay) and 0 <= decay <= 1):
            raise ValueError(f"decay must be a number from 0 to 1, got {decay!r}.")
        if motion is not None and not (is_finite(motion) and motion > 0):
            raise ValueError(f"motion must be a positive length in metres or None, got {motion!r}.")
        self.name, self.decay = name, float(decay)
        self.motion = 0.5 * images.side if motion is None else float(motion)
        self._side = images.side
        self._step = _step(images.planes)

    @property
    def provenance(self) -> list[str | float | None]:
        """Name and parameter of the rule, for JSON."""
        parameter = {"decayed": self.decay, "limited": self.motion}.get(self.name or "")
        return [self.name, parameter]

    def volumes(self, before: Vector, frames: int) -> Vector | None:
        """Return the initial volumes of so many frames, or None without a rule."""
        if self.name is None:
            return None
        mean = float(before.mean(dtype=np.float64))
        initial = before[None]
        if self.name == "decayed":
            initial = np.maximum(initial, 0) ** np.float32(self.decay)
            initial = initial * np.float32(mean / max(float(initial.mean(dtype=np.float64)), 1e-30))
        if self.name == "limited":
            initial = np.stack([self._smoothed(before, frame + 1) for frame in range(frames)])
        return np.maximum(initial, np.float32(FLOOR * mean))

    def _smoothed(self, volume: Vector, steps: int) -> Vector:
        """Smooth a volume by the motion over some frames, along z only between regular planes."""
        distance, across = self.motion * steps, self.motion * steps / self._side
        sigma = (0.0 if self._step is None else distance / self._step, across, across)
        return np.asarray(gaussian_filter(volume, sigma, mode="nearest", truncate=WINDOW_SIGMAS))


def _step(planes: Vector) -> float | None:
    """Return the distance between equidistant planes; None for other planes."""
    steps = np.abs(np.diff(planes))
    if steps.size == 0 or np.ptp(steps) > 1e-6 * steps[0]:
        return None
    return float(steps[0])
