"""How right tracks, positions and traces are, against simulated truth.

    python benchmarks/accuracy_tracks.py [--frames 12] [--seed 1]

Points of known places are drawn into volumes of voxels of 2 x .5 x .5 um with noise, found by
`find_points` and linked by `track_points`. Scenes are sparse, crowded, crossing, dim, a flow, and
blinking. A link is right if both of its points are the nearest found ones of the same bead; the
share is that of all links between successive frames in which the bead is there, and wrong ones
are a share of those made; "of true places" are both where nothing had to be found. Regions of known
dF/F are drawn with noise and light about them, and their traces compared. About a minute.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import click
import numpy as np

from clplen.microscopy import (
    Points,
    Tracks,
    find_points,
    match_points,
    sphere_labels,
    traces,
    track_points,
)

SHAPE = (24, 120, 120)
VOXEL = np.array([2e-6, 0.5e-6, 0.5e-6])
SIGMA = np.array([1.3, 1.4, 1.4])  # samples
AXES = tuple(side * np.arange(n) for side, n in zip(VOXEL, SHAPE, strict=True))
NEAR = (3e-6, 1e-6, 1e-6)  # a found point that far from a bead is it
EDGE = np.array([3, 6, 6])  # samples that beads keep from the borders

Values = np.ndarray[Any, Any]


@dataclass
class Scene:
    """Beads and how they move, lengths in metres."""

    name: str
    count: int
    step: float  # of random motion, rms along an axis
    height: float = 100.0
    noise: float = 4.0
    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed: float = 0.0  # of each bead in a direction of its own
    missing: float = 0.0  # share of the frames that a bead is dark in
    largest: float = 3.0e-6
    gaps: int = 0
    motion: str = "random"

    def paths(self, frames: int, rng: np.random.Generator) -> tuple[Values, Values, Values]:
        """Positions (frames, n, 3), numbers of the beads, and which are seen.

        A bead that leaves comes back as another one on the opposite side.
        """
        low, high = EDGE * VOXEL, (np.array(SHAPE) - 1 - EDGE) * VOXEL
        at = rng.uniform(low, high, (self.count, 3))
        velocity = np.array(self.drift) + self.speed * _directions(self.count, rng)
        numbers = np.arange(self.count)
        places, names = [], []
        for _ in range(frames):
            places.append(at)
            names.append(numbers)
            at = at + velocity + rng.normal(0, self.step, at.shape)
            inside = low + (at - low) % (high - low)
            numbers = numbers + self.count * (np.abs(inside - at) > 1e-9).any(axis=1)
            at = inside
        seen = rng.random((frames, self.count)) >= self.missing
        return np.array(places), np.array(names), seen

    def volume(self, at: Values, rng: np.random.Generator) -> Values:
        """Beads in noise."""
        values = self.noise * rng.standard_normal(SHAPE)
        for centre in at / VOXEL:
            box = tuple(slice(max(int(c - 5 * s), 0), int(c + 5 * s) + 1)
                        for c, s in zip(centre, SIGMA, strict=True))  # fmt: skip
            grids = np.ogrid[box]
            far = sum(((g - c) / s) ** 2 for g, c, s in zip(grids, centre, SIGMA, strict=True))
            values[box] += (
                self.height * np.exp(-far / 2)[tuple(slice(n) for n in values[box].shape)]
            )
        return values


def _directions(count: int, rng: np.random.Generator) -> Values:
    directions = rng.normal(size=(count, 3)) * (0.3, 1, 1)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


SCENES = [
    Scene("sparse", 20, 0.4e-6),
    Scene("sparse, longer steps", 20, 1.0e-6, largest=6e-6),
    Scene("crowded", 150, 0.4e-6),
    Scene("crowded, longer steps", 150, 1.0e-6, largest=5e-6),
    Scene("dim", 20, 0.4e-6, height=25.0),
    Scene("very dim", 20, 0.4e-6, height=14.0),
    Scene("blinking", 40, 0.4e-6, missing=0.15, gaps=2),
    Scene("crossing", 60, 0.1e-6, speed=2e-6, largest=4e-6),
    Scene("crossing, straight", 60, 0.1e-6, speed=2e-6, motion="straight"),
    Scene("flow", 60, 0.2e-6, drift=(0, 4e-6, 0), largest=6e-6),
    Scene("flow, straight", 60, 0.2e-6, drift=(0, 4e-6, 0), motion="straight", largest=6e-6),
]


def owners(tracks: Tracks, places: Values, names: Values, seen: Values) -> Values:
    """Which bead each point of the tracks is; -1 for none."""
    found = np.full(len(tracks.ids), -1)
    for frame, (at, name, there) in enumerate(zip(places, names, seen, strict=True)):
        rows, beads = np.flatnonzero(tracks.frames == frame), np.flatnonzero(there)
        pairs = match_points(tracks.positions[rows], at[beads], tolerance=NEAR)
        found[rows[pairs[:, 0]]] = name[beads[pairs[:, 1]]]
    return found


def share_of_links(tracks: Tracks, owner: Values, possible: int) -> tuple[float, float]:
    """Right links over those that are possible, and wrong ones over those that were made."""
    linked = np.diff(tracks.ids) == 0
    right = linked & (np.diff(owner) == 0) & (owner[1:] >= 0)
    return right.sum() / possible, (linked & ~right).sum() / max(linked.sum(), 1)


def judge(scene: Scene, frames: int, seed: int) -> str:
    """A row of the table."""
    rng = np.random.default_rng(seed)
    places, names, seen = scene.paths(frames, rng)
    size = (1.3, 1.4)
    points = [find_points(scene.volume(at[there], rng), axes=AXES, size=size)
              for at, there in zip(places, seen, strict=True)]  # fmt: skip
    tracks = track_points(
        points, step=scene.largest, gaps=scene.gaps, motion=scene.motion, unit="m"
    )
    owner = owners(tracks, places, names, seen)
    known_places = [
        Points(at[there], name[there].astype(float), np.ones(there.sum()), at[there])
        for at, name, there in zip(places, names, seen, strict=True)
    ]
    ideal = track_points(
        known_places, step=scene.largest, gaps=scene.gaps, motion=scene.motion, unit="m"
    )
    possible = 0
    for bead in np.unique(names):
        times = np.flatnonzero((seen & (names == bead)).any(axis=1))
        possible += np.count_nonzero(np.diff(times) <= scene.gaps + 1)
    known = owner >= 0
    off = tracks.positions[known] - places[tracks.frames[known], owner[known] % scene.count]
    rms = np.sqrt(np.mean(off**2, axis=0)) * 1e6
    right, wrong = share_of_links(tracks, owner, possible)
    best, worst = share_of_links(ideal, ideal.peaks.astype(int), possible)
    return (
        f"{scene.name:<24} {known.sum() / seen.sum():7.3f} {(~known).sum():6d} "
        f"{right:8.3f} {wrong:8.4f} {best:8.3f} {worst:8.4f} "
        f"{rms[0]:6.3f} {rms[1]:6.3f} {rms[2]:6.3f}"
    )


def traced(noise: float, haze: float, ring: bool, percentile: float, seed: int) -> str:
    """A row on traces: rms of dF/F less the truth, and the bias at rest."""
    rng = np.random.default_rng(seed)
    shape, frames, window = (9, 60, 60), 400, 150
    axes = tuple(side * np.arange(n) for side, n in zip(VOXEL, shape, strict=True))
    centres = [(8e-6, y, x) for y in (7e-6, 15e-6, 23e-6) for x in (7e-6, 15e-6, 23e-6)]
    labels = sphere_labels(centres, 2.6e-6, axes)
    t = np.arange(frames)
    truth = np.zeros((9, frames))
    for region in range(9):
        for start in rng.choice(frames, 4, replace=False):
            height = rng.uniform(0.3, 2)
            truth[region] += np.where(t >= start, height * np.exp(-(t - start) / 10.0), 0)
    rest = np.concatenate([[0], rng.uniform(20, 60, 9)])

    def volumes() -> Any:
        for k in range(frames):
            light = np.concatenate([[0], truth[:, k]])
            level = haze * (1 + 0.3 * np.sin(k / 15))
            yield (rest * (1 + light))[labels] + level + noise * rng.standard_normal(shape)

    words = {"ring": (1e-6, 4e-6), "axes": axes, "neuropil": 1.0} if ring else {}
    found = traces(volumes(), labels, window=window, percentile=percentile, **words)
    off = found.dff - truth
    quiet = truth < 0.01
    name = f"noise {noise:g}, haze {haze:g}" + (", ring" if ring else "")
    return (
        f"{name:<24} {percentile:7g} {np.sqrt(np.mean(off**2)):8.3f} {np.median(off[quiet]):8.3f} "
        f"{np.corrcoef(found.dff.ravel(), truth.ravel())[0, 1]:8.3f}"
    )


@click.command()
@click.option("--frames", default=12)
@click.option("--seed", default=1)
def main(frames: int, seed: int) -> None:
    """Print both tables."""
    head = f"{'scene':<24} {'found':>7} {'false':>6} {'links':>8} {'wrong':>8}"
    print(f"{head} {'of true':>8} {'places':>8}  rms z, y, x / um")
    for scene in SCENES:
        print(judge(scene, frames, seed), flush=True)
    print(f"\n{'traces':<24} {'F0 at %':>7} {'rms':>8} {'at rest':>8} {'corr.':>8}")
    for noise, haze, ring, percentile in (
        (0, 0, False, 8), (10, 0, False, 8), (10, 0, False, 50), (10, 40, False, 8),
        (10, 40, True, 8), (30, 0, False, 8), (30, 40, True, 8),
    ):  # fmt: skip
        print(traced(noise, haze, ring, percentile, seed), flush=True)


if __name__ == "__main__":
    main()
