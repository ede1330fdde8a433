"""The default depth cue beside plain energy and plain variance, on many sample scenes.

    python benchmarks/accuracy_samples.py [--device pocl] [--seeds 7,8,9] [--shape 128x160]

Each seed draws one scene of every kind, with noise of 0, 1, 2 or 5 % of white. BadPix is the share
of pixels off by more than .07 pixels, the border of 15 pixels left out; the plain forms are the
NumPy ones of tests/reference_depth.py. The last lines count the scenes on which the default is at
least as good.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import reference_depth

import clplen

BORDER = 15
PLAIN = ("energy", "variance")


def judged(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """BadPix in per cent, and the median error in pixels."""
    inside = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    error = np.abs(found - truth)[inside]
    error = error[np.isfinite(error)]
    return 100 * float((error > 0.07).mean()), float(np.median(error))


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--seeds", default="7,8,9", show_default=True)
@click.option("--shape", default="128x160", show_default=True)
def main(selector: str | None, seeds: str, shape: str) -> None:
    """A line for each scene, and the counts."""
    device = clplen.Device.open(selector)
    ny, nx = (int(n) for n in shape.split("x"))
    wins = np.zeros((len(PLAIN), 2), int)
    count = 0
    click.echo(f"{'BadPix % / median':24s}{'default':>16s}{'energy':>16s}{'variance':>16s}")
    for seed in map(int, seeds.split(",")):
        for sample in clplen.cameras.sample_scenes(seed, (ny, nx)):
            lf, truth = sample.scene.light_field(
                (9, 9), (ny, nx), device=device, noise=sample.noise, seed=seed
            )
            planes = reference_depth.PLANES
            found = judged(clplen.depth_map(lf, disparities=planes).disparity, truth.disparity)
            line = f"{seed:3d} {sample.name:20s}{found[0]:8.2f} {found[1]:.4f} "
            for i, cue in enumerate(PLAIN):
                plain = judged(reference_depth.depth(lf.to_numpy(), cue), truth.disparity)
                wins[i] += [found[j] <= plain[j] for j in range(2)]
                line += f"{plain[0]:8.2f} {plain[1]:.4f} "
            count += 1
            click.echo(line)
    for cue, (bad, median) in zip(PLAIN, wins, strict=True):
        click.echo(f"not worse than plain {cue}: BadPix {bad}, median {median} of {count} scenes")


if __name__ == "__main__":
    main()
