"""One point before the focused camera of 61 x 61 lenslets: figures 1.20, 1.21 and 1.23.

f = 120 mm in 2f and 2f, lenslets of 150 um and f_mu = 10 mm, 30 pixels each, 532 nm; the main
lens' aperture is matched to the pupil.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from common import Run
from drawing import LIGHT, centred
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.image import AxesImage

from clplen import MicrolensArray, PlenopticCamera, PointSources, RawImage

LEAST = 0.05  # of the brightest spot: darker ones are no spots
PIXELS = 12  # a lenslet of the reduced camera
QUICK = f"{PIXELS} pixels a lenslet"


@dataclass(frozen=True)
class Spots:
    """What every lenslet of a camera shows of one point; places in metres, shape (61, 61, 2)."""

    camera: Any
    raw: RawImage
    energy: np.ndarray
    centres: np.ndarray
    lenslets: np.ndarray

    @property
    def m(self) -> float:
        """Pitch of the spots over that of the lenslets, less 1, by a line weighted by energy."""
        use = self.energy > LEAST * self.energy.max()
        weight = np.sqrt(self.energy[use])
        slopes = [np.polyfit(self.lenslets[use][:, n], self.centres[use][:, n], 1, w=weight)[0]
                  for n in (0, 1)]
        return float(np.mean(slopes)) - 1

    @property
    def row(self) -> int:
        """Lenslets of the middle row with more than half of the brightest one's energy."""
        middle = self.energy[self.energy.shape[0] // 2]
        return int((middle > 0.5 * middle.max()).sum())


def spots(run: Run, m: float) -> Spots:
    """Expose a point in focus on the axis, and take the centroid of I^2 about every spot.

    A spot's window is p wide about its place by geometry, x (1 + m) of the lenslet at x.
    """
    array = MicrolensArray(150e-6, 10e-3, count=61, fill="full")
    camera = PlenopticCamera.type2(focal_length=0.12, mla=array, wavelength=532e-9, m=m,
                                   pixels_per_lenslet=PIXELS if run.quick else 30,
                                   device=run.device)
    raw = camera.expose(PointSources([(0, 0, 0)]))
    axis, x = (np.arange(61) - 30) * camera.mla.pitch, camera.grid.x
    window = (np.abs(x - axis[:, None] * (1 + m)) <= camera.mla.pitch / 2).astype(float)
    light = raw.to_numpy().astype(float)
    squares = np.maximum(window @ light**2 @ window.T, 1e-300)
    at = [(window * first) @ light**2 @ (window * second).T / squares
          for first, second in ((x, 1.0), (1.0, x))]
    lenslets = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    return Spots(camera, raw, window @ light @ window.T, np.stack(at, axis=-1), lenslets)


def show(axes: Axes, found: Spots, across: int, *, grid: bool = True) -> AxesImage:
    """The raw image behind so many lenslets about the middle, with their cells; square root."""
    n = round(found.camera.pixels_per_lenslet)
    low = (61 - across) // 2 * n
    values = found.raw.to_numpy()[low : low + across * n, low : low + across * n]
    drawn = axes.imshow(values / values.max(), cmap=LIGHT, norm=PowerNorm(0.5, 0, 1),
                        extent=centred(values.shape, found.camera.pixel_pitch * 1e3),
                        interpolation="antialiased", interpolation_stage="data")
    if grid:
        edge = across / 2 * found.camera.mla.pitch * 1e3
        lines = np.linspace(-edge, edge, across + 1)[1:-1]
        axes.vlines(lines, -edge, edge, color="w", lw=0.5, alpha=0.6)
        axes.hlines(lines, -edge, edge, color="w", lw=0.5, alpha=0.6)
    axes.set(xlabel="x / mm", ylabel="y / mm")
    return drawn
