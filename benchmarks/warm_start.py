"""What a time series of a light-field microscope gains from the volume before.

    python benchmarks/warm_start.py [--device pocl] [--frames 5] [--photons 3e6]

A simulated series: a shell and a dozen beads that move by up to a voxel a frame along x and y, with
Poisson noise. Each frame is deconvolved in 20 iterations from an even volume, and from the volume
of the frame before until the residual is the same. Errors are those against the known volume, norm
over norm, after a Gaussian of one voxel along x and y. About half a minute.
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np
from scipy.ndimage import gaussian_filter

from clplen import Device, MicrolensArray, PlenopticCamera, Projector, point_images
from clplen.microscopy import DeconvolutionSettings, Deconvolver, Prepared

LENSLETS = 13
BACKGROUND = 5.0
COLD = 20  # iterations
BEADS = 12

Values = np.ndarray[Any, Any]


class Scene:
    """A shell that stays and beads that move."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        random = np.random.default_rng(0)
        self.z, self.y, self.x = np.indices(shape)
        ends = np.array(shape) - 1
        self.at = random.uniform([2, 8, 8], ends - [2, 8, 8], (BEADS, 3))
        self.steps = 0.5 * random.normal(size=(BEADS, 3)) * [0.3, 1, 1]
        z, y, x = ends / 2
        radius = np.sqrt(((self.z - z) * 6) ** 2 + (self.y - y) ** 2 + (self.x - x) ** 2)
        self.shell = 0.3 * np.exp(-(((radius - 20) / 1.5) ** 2))

    def volume(self, time: int, photons: float) -> Values:
        """Of a frame, with so many photons."""
        found = self.shell.copy()
        for z, y, x in self.at + time * self.steps:
            found += 8 * np.exp(
                -((2 * (self.z - z)) ** 2 + (self.y - y) ** 2 + (self.x - x) ** 2) / 2
            )
        return (found * photons / found.sum()).astype(np.float32)


def error(found: Values, truth: Values) -> float:
    """Norm of the difference over that of the truth, both smoothed along x and y."""
    difference, known = (gaussian_filter(v, (0, 1, 1)) for v in (found - truth, truth))
    return float(np.linalg.norm(difference) / np.linalg.norm(known))


@click.command()
@click.option("--device", "selector", default=None)
@click.option("--frames", default=5)
@click.option("--photons", default=3e6)
def main(selector: str | None, frames: int, photons: float) -> None:
    """Print a line for each frame."""
    device = Device.open(selector)
    array = MicrolensArray(100e-6, 2.5e-3, count=LENSLETS, fill="full")
    camera = PlenopticCamera.microscope(
        magnification=60, na=1.2, medium_index=1.35, wavelength=593e-9, mla=array,
        pixels_per_lenslet=16, device=device,
    )  # fmt: skip
    images = point_images(camera, np.linspace(-20e-6, 20e-6, 21), cut=1e-2)
    projector = Projector(images, (LENSLETS, LENSLETS), device=device)
    series = Deconvolver(images, DeconvolutionSettings(COLD, BACKGROUND), device=device)
    scene, random = Scene(projector.volume_shape), np.random.default_rng(1)
    before: Values | None = None
    print("frame  residual, iterations, error of an even start;  of the volume before")
    for time in range(frames):
        truth = scene.volume(time, photons)
        counts = random.poisson(projector.forward(truth) + BACKGROUND).astype(np.float32)
        frame = Prepared(counts, np.ones_like(counts), 0, 0)
        cold = warm = series(frame)
        goal = float(cold.residuals[-1])
        if before is not None:
            series.how = DeconvolutionSettings(COLD, BACKGROUND, residual=goal * (1 + 1e-9))
            warm = series(frame, start=before)
            series.how = DeconvolutionSettings(COLD, BACKGROUND)
        before = warm.volume
        print(
            f"{time:5d}  {goal:.4f}  {cold.iterations}  {error(cold.volume, truth):.3f};  "
            f"{warm.residuals[-1]:.4f}  {warm.iterations}  {error(warm.volume, truth):.3f}"
        )


if __name__ == "__main__":
    main()
