"""What a start from the volume before costs where things move: places of beads, and the norm.

    python -m benchmarks accuracy/series [--device pocl] [--frames 6] [--photons 3e6]

A simulated series: a dozen beads, .6 voxels wide (standard deviation), that drift by the same
length a frame, each in its own direction, with Poisson noise; 60x/1.2 water, 13 x 13 lenslets, 15
planes, voxels of .333 um. Each frame is deconvolved in 8 iterations from an even volume (none),
from the volume before (previous), from its square root (decayed) and from it as wide as beads move
(limited); and in 20 from an even one, also with little variation in time. The error of a place is
the distance along y and x of the centroid of 7 x 7 voxels in three planes from where the bead was;
the error of the volume is norm over norm after a Gaussian of one voxel. Means of the frames from
the third on. About two minutes.
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np
from scipy.ndimage import gaussian_filter

from clplen import Device, MicrolensArray, PlenopticCamera, Projector, point_images
from clplen.microscopy import deconvolve_series

LENSLETS, BEADS, PLANES = 13, 12, 15
BACKGROUND = 5.0
WARM, COLD = 8, 20  # iterations
DRIFTS = (0.0, 0.05, 0.1, 0.2, 0.4)  # um a frame
LARGEST = 3  # voxels along y and x, and 1 plane, from the nearest voxel: the window of a centroid

Values = np.ndarray[Any, Any]


def tracks(shape: tuple[int, ...], frames: int, step: float) -> Values:
    """Places of beads (frames, beads, 3) in voxels, ``step`` voxels apart; none near another."""
    random = np.random.default_rng(0)
    z = random.integers(0, shape[0] // 3, BEADS) * 3 + 1.0
    cells = random.permutation(16)[:BEADS]  # of 4 x 4 places
    side = (np.array(shape[1:]) - 24) / 4
    inside = random.uniform(0.3, 0.7, (BEADS, 2))
    at = 12 + side * (np.stack([cells // 4, cells % 4], axis=1) + inside)
    turns = random.uniform(0, 2 * np.pi, BEADS)
    along = np.stack([np.sin(turns), np.cos(turns)], axis=1)
    times = np.arange(frames)[:, None, None] - (frames - 1) / 2
    across = at + step * times * along
    return np.concatenate([np.broadcast_to(z[:, None], (frames, BEADS, 1)), across], axis=2)


def volume_of(places: Values, shape: tuple[int, ...], photons: float) -> Values:
    """Beads with a standard deviation of .6 voxels."""
    z, y, x = np.indices(shape)
    found = np.zeros(shape)
    for bz, by, bx in places:
        found += np.exp(-((4 * (z - bz)) ** 2 + (y - by) ** 2 + (x - bx) ** 2) / (2 * 0.6**2))
    return (found * photons / found.sum()).astype(np.float32)


def place_errors(volume: Values, places: Values) -> list[float]:
    """Distances of centroids from places along y and x, in voxels."""
    found = []
    for bz, by, bx in places:
        top, left = round(by) - LARGEST, round(bx) - LARGEST
        side = 2 * LARGEST + 1
        part = volume[int(bz) - 1 : int(bz) + 2, top : top + side, left : left + side].sum(axis=0)
        y, x = np.indices(part.shape)
        total = float(part.sum())
        cy, cx = float((y * part).sum()) / total + top, float((x * part).sum()) / total + left
        found.append(float(np.hypot(cy - by, cx - bx)))
    return found


def norm_error(found: Values, truth: Values) -> float:
    """Norm of the difference over that of the truth, both smoothed along x and y."""
    difference, known = (gaussian_filter(v, (0, 1, 1)) for v in (found - truth, truth))
    return float(np.linalg.norm(difference) / np.linalg.norm(known))


@click.command()
@click.option("--device", "selector", default=None)
@click.option("--frames", default=6)
@click.option("--photons", default=3e6)
def main(selector: str | None, frames: int, photons: float) -> None:
    """Print a line for each drift and start."""
    device = Device.open(selector)
    array = MicrolensArray(100e-6, 2.5e-3, count=LENSLETS, fill="full")
    camera = PlenopticCamera.microscope(
        magnification=60, na=1.2, medium_index=1.33, wavelength=593e-9, mla=array,
        pixels_per_lenslet=15, device=device,
    )  # fmt: skip
    images = point_images(camera, np.linspace(-14e-6, 14e-6, PLANES) + 1e-6, cut=1e-2)
    projector = Projector(images, (LENSLETS, LENSLETS), device=device)
    side = images.side * 1e6
    for drift in DRIFTS:
        print(f"drift of {drift:g} um a frame ({drift / side:.2f} voxels)")
        places = tracks(projector.volume_shape, frames, drift / side)
        truths = [volume_of(one, projector.volume_shape, photons) for one in places]
        random = np.random.default_rng(1)
        counts = random.poisson(projector.forward(np.stack(truths)) + BACKGROUND)
        counts = counts.astype(np.float32)
        motion = max(drift, side / 4) * 1e-6
        for name, iterations, how in (
            ("none", COLD, {}),
            ("none, prior time", COLD, {"prior": "time"}),
            ("none", WARM, {}),
            ("previous", WARM, {"start": "previous"}),
            ("decayed", WARM, {"start": "decayed"}),
            ("limited", WARM, {"start": "limited", "motion": motion}),
        ):
            for batch in (1, 3) if "start" in how else (3,):
                found = deconvolve_series(
                    counts, projector, iterations=iterations, background=BACKGROUND, batch=batch,
                    **how,
                )  # fmt: skip
                each = [
                    (
                        float(np.mean(place_errors(one.volume, at))) * side,
                        norm_error(one.volume, truth),
                        float(one.residuals[-1]),
                    )
                    for one, at, truth in zip(found, places, truths, strict=True)
                ]
                place, norm, residual = np.mean(each[2:], axis=0)
                print(
                    f"  {name:16s} {iterations:3d} iterations, batch {batch}: place {place:.3f} "
                    f"um, norm {norm:.3f}, residual {residual:.4f}"
                )

