"""How right every depth cue is on scenes of exact disparity.

    python benchmarks/accuracy_depth.py [--device pocl] [--shape 512x512] [--plain]

The border of 15 pixels is left out. `surer` is BadPix 0.07 of the half of the pixels with the
higher confidence. With --plain the plain forms of numpy run beside (minutes at full size).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from reference_cues import plain_depth

from clplen import Device, SurfaceScene, depth_map
from clplen.cameras import Bars, Plane, Sphere, noise
from clplen.lightfield import CUES

Array = np.ndarray[Any, Any]
PLANES = np.linspace(-2, 2, 41)
BORDER = 15


def scenes(side: int) -> Iterator[tuple[str, SurfaceScene]]:
    """(name, scene) of four scenes whose sizes follow the shorter side of a view."""
    near = noise(2, contrast=0.15)
    ground = Plane(-0.8, texture=noise(1))
    yield "plane", SurfaceScene(Plane(0.37, texture=noise(3)))
    yield "slant", SurfaceScene(Plane(0.2, (-0.8 / side, 1.6 / side), texture=noise(4)))
    bars = Bars((0.0, 0.0), 0.7 * side, count=5, period=0.14 * side, width=0.06 * side, angle=0.2)
    yield "bars", SurfaceScene((ground, Plane(0.9, texture=near, outline=bars)))
    ball = Sphere((0.0, 0.0), 0.35 * side, disparity=0.0, height=1.2, texture=near)
    yield "sphere", SurfaceScene((ground, ball))


def judged(found: Array, truth: Array, confidence: Array | None = None) -> str:
    """Median in pixels, Q25 x 100, BadPix 0.07 of all and of the surer half."""
    inside = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    error = np.abs(found - truth)[inside].ravel()
    bad = error > 0.07
    numbers = f"{np.median(error):9.4f}{100 * np.quantile(error, 0.25):8.2f}{100 * bad.mean():8.2f}"
    if confidence is None:
        return numbers
    order = np.argsort(-confidence[inside].ravel(), kind="stable")
    return f"{numbers}{100 * bad[order[: bad.size // 2]].mean():8.2f}"


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--shape", default="512x512", show_default=True)
@click.option("--noise", "levels", multiple=True, type=float, default=(0.0, 0.02))
@click.option("--cue", "cues", multiple=True, type=click.Choice(CUES), default=CUES)
@click.option("--plain", is_flag=True, help="Beside the plain forms of numpy.")
def main(
    selector: str | None,
    shape: str,
    levels: tuple[float, ...],
    cues: tuple[str, ...],
    plain: bool,
) -> None:
    """A table of errors: scenes, noise, cues."""
    ny, nx = (int(n) for n in shape.split("x"))
    device = Device.open(selector)
    click.echo(f"{device!r}\n9 x 9 views of {ny} x {nx}, {PLANES.size} planes from -2 to 2\n")
    click.echo(f"{'':34s}{'median':>9s}{'Q25':>8s}{'BadPix':>8s}{'surer':>8s}")
    for name, scene in scenes(min(ny, nx)):
        for level in levels:
            lf, truth = scene.light_field((9, 9), (ny, nx), device=device, noise=level)
            for cue in cues:
                found = depth_map(lf, disparities=PLANES, cue=cue)
                line = judged(found.disparity, truth.disparity, found.confidence)
                click.echo(f"{name:8s}{level:5.2f} {cue:20s}{line}")
            for cue, disparity in plain_depth(lf.to_numpy(), PLANES).items() if plain else ():
                click.echo(
                    f"{name:8s}{level:5.2f} plain {cue:14s}{judged(disparity, truth.disparity)}"
                )


if __name__ == "__main__":
    main()
