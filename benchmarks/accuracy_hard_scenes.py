"""Depth on scenes that are hard: every cue, judged against exact truth.

    python benchmarks/accuracy_hard_scenes.py [--device pocl] [--shape 128x160] [--only haze]

BadPix(.07) and BadPix(.03) in %, MSE x 100 and Q25 x 100 as the HCI benchmark takes them, the
border of 15 pixels left out. "Sparsification" is the area between two curves of the mean error of
what is left when the least sure pixels are taken away, one after the other: by confidence, and by
the error itself; 0 where confidence ranks as the error does (Ilg et al. 2018; errors above one
pixel count as one). The last lines compare the default with the best of the single cues.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from hard_scenes import hard_scenes

import clplen

BORDER = 15
CUES = ("energy", "correspondence", "structure-tensor", "combined")
ALLOWED = 1.02  # times the best single cue, on every scene


def sparsification(error: np.ndarray, confidence: np.ndarray, steps: int = 50) -> float:
    """Area between the curves by confidence and by error."""
    error = np.minimum(np.nan_to_num(error, nan=1.0), 1.0)
    areas = []
    for rank in (np.argsort(confidence, kind="stable"), np.argsort(-error, kind="stable")):
        rest = error[rank][::-1].cumsum()[::-1] / np.arange(error.size, 0, -1)
        areas.append(rest[(np.arange(steps) * error.size) // steps].mean())
    return float(areas[0] - areas[1])


def judged(depth: clplen.DepthMap, truth: np.ndarray) -> tuple[float, ...]:
    """BadPix(.07), BadPix(.03), MSE, Q25 and the area of sparsification."""
    inside = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    found, known = depth.disparity[inside].ravel(), truth[inside].ravel()
    there = np.isfinite(known)
    error = np.abs(found - known)[there]
    confidence = depth.confidence[inside].ravel()[there]
    return (
        100 * float((error > 0.07).mean()),
        100 * float((error > 0.03).mean()),
        100 * float((error**2).mean()),
        100 * float(np.quantile(error, 0.25)),
        sparsification(error, confidence),
    )


@click.command(help=__doc__)
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--shape", default="128x160", show_default=True)
@click.option("--only", help="Scenes whose name holds this.")
def main(selector: str | None, shape: str, only: str | None) -> None:
    """A line for each scene and cue, and how the default compares."""
    device = clplen.Device.open(selector)
    ny, nx = (int(n) for n in shape.split("x"))
    columns = f"{'.07 %':>8s}{'.03 %':>8s}{'MSE':>9s}{'Q25':>7s}{'area':>8s}"
    click.echo(f"{'scene':28s}{'cue':>18s}{columns}")
    best, default, worse = [], [], []
    for scene in hard_scenes((ny, nx), device=device, only=only):
        lf = clplen.LightField.from_array(scene.samples, device=device)
        bad = {}
        for cue in CUES:
            depth = clplen.depth_map(lf, disparities=scene.planes, cue=cue)
            values = judged(depth, scene.disparity)
            bad[cue] = values[0]
            numbers = "{:8.2f}{:8.2f}{:9.3f}{:7.2f}{:8.4f}".format(*values)
            click.echo(f"{scene.name:28s}{cue:>18s}{numbers}")
        single = min(bad[cue] for cue in CUES[:-1])
        best.append(single)
        default.append(bad[CUES[-1]])
        if bad[CUES[-1]] > ALLOWED * single + 0.005:
            worse.append(scene.name)
    means = np.mean(default), np.mean(best)
    click.echo("mean BadPix(.07): default {:.2f} %, best single cue {:.2f} %".format(*means))
    where = ", ".join(worse) or "nowhere"
    click.echo(f"default worse than {ALLOWED} times the best single cue: {where}")


if __name__ == "__main__":
    main()
