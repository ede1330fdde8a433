"""A picture and its disparity, fitted together to the views of a light field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from clplen import LightField, SurfaceScene
from clplen.cameras import Plane, Sphere, bricks, checker
from clplen.lightfield import ViewWarp

ROUND = 0.02  # total variation is rounded below slopes of so much a pixel
BORDER = 6  # pixels that are not judged


def wall_and_ball(size: int) -> SurfaceScene:
    """A slanted wall of bricks with a chequered ball before it."""
    wall = Plane(-0.6, (0.003, 0.006), texture=bricks(1, size=(10, 22)))
    ball = Sphere((4, -10), 0.235 * size, disparity=-0.6, height=1.1, texture=checker(14))
    return SurfaceScene([wall, ball])


def total_variation(values: Any) -> tuple[float, Any]:
    """The sum of sqrt(|slope|^2 + ROUND^2) and its gradient."""
    down = np.diff(values, axis=0, append=values[-1:])
    right = np.diff(values, axis=1, append=values[:, -1:])
    size = np.sqrt(down**2 + right**2 + ROUND**2)
    down, right = down / size, right / size
    slope = -down - right
    slope[1:] += down[:-1]
    slope[:, 1:] += right[:, :-1]
    return float(size.sum()), slope


@dataclass
class JointFit:
    """The loss |views of the picture - light field|^2 / (2 noise^2) + total variations.

    Attributes
    ----------
    lf : LightField
    noise : float
        Standard deviation of its samples.
    weights : tuple of float
        Of the total variation of picture and disparity.
    """

    lf: LightField
    noise: float
    weights: tuple[float, float]

    def __post_init__(self) -> None:
        self.model, self.target = ViewWarp(self.lf), self.lf.to_numpy()

    def loss(self, values: Any) -> tuple[float, Any]:
        """Of picture and disparity, one behind the other, and its gradient."""
        picture, disparity = values.reshape(2, *self.target.shape[2:])
        rest = (self.model.forward(picture, disparity).to_numpy() - self.target) / self.noise
        slopes = np.stack(self.model.vjp(picture, disparity, rest / self.noise)).astype(float)
        value = float((rest.astype(float) ** 2).sum()) / 2
        for slope, part, weight in zip(slopes, (picture, disparity), self.weights, strict=True):
            roughness, gradient = total_variation(part)
            value += weight * roughness
            slope += weight * gradient
        return value, slopes.ravel()

    def fit(self, picture: Any, disparity: Any, note: Callable[[Any], None],
            iterations: int) -> Any:
        """L-BFGS from these; `note` is given picture and disparity after each step."""
        shape = (2, *np.shape(picture))
        start = np.stack([picture, disparity]).astype(float).ravel()
        found = minimize(self.loss, start, jac=True, method="L-BFGS-B",
                         callback=lambda x: note(x.reshape(shape)),
                         options={"maxiter": iterations})
        return found.x.reshape(shape)


def psnr(picture: Any, truth: Any) -> float:
    """In dB, of white 1, inside the border."""
    error = (picture - truth)[BORDER:-BORDER, BORDER:-BORDER]
    return float(-10 * np.log10((error**2).mean()))


def rms(disparity: Any, truth: Any) -> float:
    """Of its error, inside the border."""
    error = (disparity - truth)[BORDER:-BORDER, BORDER:-BORDER]
    return float(np.sqrt((error**2).mean()))
