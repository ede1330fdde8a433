"""What comparing the frames of a series gains: cells that stay where they are and flash.

    python benchmarks/accuracy_time_prior.py [--device pocl] [--frames 16] [--iterations 20]

Eight cells of 5 um in 8 planes, each of which flashes once, to four times its light, and fades, on
a dim ground; 60x/1.2 water, 9 x 9 lenslets of 15 pixels, 5 voxels a lenslet, Poisson noise. Frames
are found eight together without a prior, with little total variation in space ("tv") and in time
("time"). The error is norm over norm after a Gaussian of one voxel; flicker is the standard
deviation of changes from frame to frame of voxels without a cell, over the mean voxel. A minute.
"""

from __future__ import annotations

import click
import numpy as np
from scipy.ndimage import gaussian_filter

from clplen import Device, MicrolensArray, PlenopticCamera, Projector, point_images
from clplen.microscopy import deconvolve_series

CELLS, GROUND, FADING = 8, 0.02, 4.0
PHOTONS = (3e4, 3e5, 3e6)
PRIORS = ((None, 1.0), ("tv", 1.0), ("time", 0.5), ("time", 1.0), ("time", 2.0), ("time", 4.0))


@click.command(help=__doc__)
@click.option("--device", "selector", help="As Device.open takes it.")
@click.option("--frames", default=16, show_default=True, type=click.IntRange(2))
@click.option("--iterations", default=20, show_default=True, type=click.IntRange(1))
def main(selector: str | None, frames: int, iterations: int) -> None:
    device = Device.open(selector)
    camera = PlenopticCamera.microscope(
        magnification=60,
        na=1.2,
        medium_index=1.33,
        wavelength=593e-9,
        pixels_per_lenslet=15,
        mla=MicrolensArray(100e-6, 2.5e-3, count=5, fill="full"),
        device=device,
    )
    images = point_images(camera, np.linspace(-7e-6, 7e-6, 8), voxels_per_lenslet=5, cut=2e-3)
    projector = Projector(images, (9, 9), device=device)
    random = np.random.default_rng(0)
    z, y, x = np.indices(projector.volume_shape)
    series = np.full((frames, *projector.volume_shape), GROUND)
    for k in range(CELLS):
        at = (random.integers(0, 8), random.uniform(8, 37), random.uniform(8, 37))
        far = 2 * (z - at[0]) ** 2 + ((y - at[1]) ** 2 + (x - at[2]) ** 2) / 4
        since = np.arange(frames) - 2 * k % frames
        light = 1 + 3 * np.where(since >= 0, np.exp(-np.maximum(since, 0) / FADING), 0)
        series += light[:, None, None, None] * np.exp(-far)
    empty = series.max(axis=0) < 2 * GROUND
    click.echo(f"{frames} frames, {iterations} iterations; empty voxels {empty.mean():.0%}")
    for photons in PHOTONS:
        scale = photons / projector.forward(series[0]).sum()
        true = series * scale
        counts = random.poisson(projector.forward(true)).astype(np.float32)
        soft = gaussian_filter(true, (0, 0.5, 1, 1))
        for prior, strength in PRIORS:
            found = np.stack([
                one.volume
                for one in deconvolve_series(
                    counts, projector, iterations=iterations, prior=prior, strength=strength
                )
            ])  # fmt: skip
            wrong = gaussian_filter(found, (0, 0.5, 1, 1)) - soft
            error = np.linalg.norm(wrong) / np.linalg.norm(soft)
            flicker = np.diff(found, axis=0)[:, empty].std() / true.mean()
            name = "none" if prior is None else f"{prior} {strength:g}"
            click.echo(
                f"{photons:.0e} photons, {name:8s}: error {error:.3f}, flicker {flicker:.3f}"
            )


if __name__ == "__main__":
    main()
