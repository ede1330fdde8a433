"""Errors of every depth cue on scenes of exact disparity.

    python -m benchmarks accuracy/depth [--scenes plain|hard|samples] [--shape 128x160]

plain: a plane, a slant, bars and a sphere, without noise and with 2 %. hard: scenes of
tests/hard_scenes.py. samples: one sample scene of every kind for each of three seeds, with noise of
0 to 5 %, beside energy and variance in NumPy. BadPix is the share of pixels in % whose disparity is
off by more than 0.07 (0.03) pixels; MSE and Q25 are those of the HCI benchmark times 100; a border
of 15 pixels is left out. "area" lies between two curves of the mean error of the remaining pixels
when the least certain ones are removed, by confidence and by the error itself (Ilg et al. 2018).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import click
import numpy as np
import reference_depth
from hard_scenes import hard_scenes

from clplen import Device, LightField, SurfaceScene, depth_map
from clplen.cameras import Bars, Plane, Sphere, noise, sample_scenes
from clplen.lightfield import CUES

Array = np.ndarray[Any, Any]
BORDER = 15
SEEDS = (7, 8, 9)
PLAIN = ("energy", "variance")  # in NumPy


class Scene(NamedTuple):
    """A light field with its true disparity."""

    name: str
    lf: LightField
    truth: Array
    planes: Array


def plain(device: Device, shape: tuple[int, int]) -> Iterator[Scene]:
    """Four scenes whose sizes follow the shorter side of a view."""
    side, near = min(shape), noise(2, contrast=0.15)
    ground = Plane(-0.8, texture=noise(1))
    bars = Bars((0.0, 0.0), 0.7 * side, count=5, period=0.14 * side, width=0.06 * side, angle=0.2)
    ball = Sphere((0.0, 0.0), 0.35 * side, disparity=0.0, height=1.2, texture=near)
    scenes = {
        "plane": Plane(0.37, texture=noise(3)),
        "slant": Plane(0.2, (-0.8 / side, 1.6 / side), texture=noise(4)),
        "bars": (ground, Plane(0.9, texture=near, outline=bars)),
        "sphere": (ground, ball),
    }
    for name, parts in scenes.items():
        for level in (0.0, 0.02):
            scene = SurfaceScene(parts)
            lf, truth = scene.light_field((9, 9), shape, device=device, noise=level)
            yield Scene(f"{name} {level:.2f}", lf, truth.disparity, np.linspace(-2, 2, 41))


def hard(device: Device, shape: tuple[int, int]) -> Iterator[Scene]:
    """Haze, gloss, thin structures and others."""
    for scene in hard_scenes(shape, device=device):
        lf = LightField.from_array(scene.samples, device=device)
        yield Scene(scene.name, lf, scene.disparity, scene.planes)


def samples(device: Device, shape: tuple[int, int]) -> Iterator[Scene]:
    """The sample scenes of the package."""
    for seed in SEEDS:
        for sample in sample_scenes(seed, shape):
            lf, truth = sample.scene.light_field(
                (9, 9), shape, device=device, noise=sample.noise, seed=seed
            )
            yield Scene(f"{seed} {sample.name}", lf, truth.disparity, reference_depth.PLANES)


def sparsification(error: Array, confidence: Array, steps: int = 50) -> float:
    """Return the area between the curves by confidence and by error."""
    error = np.minimum(np.nan_to_num(error, nan=1.0), 1.0)
    areas = []
    for rank in (np.argsort(confidence, kind="stable"), np.argsort(-error, kind="stable")):
        rest = error[rank][::-1].cumsum()[::-1] / np.arange(error.size, 0, -1)
        areas.append(rest[(np.arange(steps) * error.size) // steps].mean())
    return float(areas[0] - areas[1])


def errors(disparity: Array, truth: Array, confidence: Array | None = None) -> list[float]:
    """Return median, BadPix 0.07 and 0.03, MSE, Q25 and area."""
    inside = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    error = np.abs(disparity - truth)[inside]
    valid = np.isfinite(truth[inside])
    error = error[valid]
    area = 0.0 if confidence is None else sparsification(error, confidence[inside][valid])
    bad = [100 * float((~(error <= limit)).mean()) for limit in (0.07, 0.03)]
    error = error[np.isfinite(error)]
    squared, quarter = 100 * float((error**2).mean()), 100 * float(np.quantile(error, 0.25))
    return [float(np.median(error)), *bad, squared, quarter, area]


SCENES = {one.__name__: one for one in (plain, hard, samples)}


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--scenes", "kinds", multiple=True, type=click.Choice(list(SCENES)), default=SCENES)
@click.option("--shape", default="128x160", show_default=True)
def main(selector: str | None, kinds: tuple[str, ...], shape: str) -> None:
    device = Device.open(selector)
    ny, nx = (int(n) for n in shape.split("x"))
    click.echo(f"{device!r}, 9 x 9 views of {ny} x {nx}")
    for kind in kinds:
        head = ("median", ".07 %", ".03 %", "MSE", "Q25", "area")
        click.echo(f"{kind:28s}{'':>18s}" + "".join(f"{word:>9s}" for word in head))
        default, best, wins, count = [], [], dict.fromkeys(PLAIN, 0), 0
        for scene in SCENES[kind](device, (ny, nx)):
            rows = {}
            for cue in ("combined",) if kind == "samples" else CUES:
                depth = depth_map(scene.lf, disparities=scene.planes, cue=cue)
                rows[cue] = errors(depth.disparity, scene.truth, depth.confidence)
            default.append(rows["combined"][1])
            best.append(min(row[1] for cue, row in rows.items() if cue != "combined" or
                            kind == "samples"))  # fmt: skip
            for cue in PLAIN if kind == "samples" else ():
                rows[f"plain {cue}"] = errors(reference_depth.depth(scene.lf.to_numpy(), cue),
                                              scene.truth)  # fmt: skip
                wins[cue] += default[-1] <= rows[f"plain {cue}"][1]
            count += 1
            for cue, row in rows.items():
                click.echo(f"{scene.name:28s}{cue:>18s}" + "".join(f"{n:9.4f}" for n in row))
        click.echo(f"{kind}: mean BadPix(.07) of the default {np.mean(default):.2f} %, "
                   f"best single cue {np.mean(best):.2f} %")  # fmt: skip
        for cue in PLAIN if kind == "samples" else ():
            click.echo(f"not worse than plain {cue}: {wins[cue]} of {count} scenes")
