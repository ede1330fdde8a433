"""Three letters that hide each other before cameras of examples/cameras, by waves: figure 4.7."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from common import pixels
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath
from scipy.ndimage import binary_dilation

from clplen import LightField, PointSources, RawImage, depth_map, refocus, render_focused
from clplen.cameras import Occluder, Plenoptic2
from clplen.lightfield import focused_depth

BLURS = {"A": -2.6, "B": 0.0, "C": 2.6}  # lenslets: near, in focus, far
VIRTUAL = {"A": 5.2, "B": 6.4, "C": 8.0}  # depths of the focused camera, in b
PLACES = {"A": (4.0, -8.0), "B": (0.0, 0.0), "C": (-4.0, 8.0)}  # (y, x), lenslets, seen upright
DARK = 0.15  # of the brightest: less has no depth that is shown
HALF = 16  # lenslets, of the pictures
SIZE = 17.0  # of the font, in lenslets


def mask(letter: str, n: int, step: float) -> np.ndarray:
    """Samples of a letter, upright, in an n x n square of so many lenslets a sample."""
    lines = TextPath((0, 0), letter, size=SIZE, prop={"weight": "bold"}).to_polygons()
    ends = np.vstack(lines)
    middle = (ends.max(axis=0) + ends.min(axis=0)) / 2
    at = (np.arange(n) - n // 2) * step
    y, x = np.meshgrid(at - PLACES[letter][0], at - PLACES[letter][1], indexing="ij")
    points = np.stack([x.ravel(), -y.ravel()], axis=-1) + middle
    return sum(Outline(line).contains_points(points) for line in lines).reshape(n, n) % 2


def distances(camera: Any) -> dict[str, float]:
    """dz of the letters."""
    if isinstance(camera, Plenoptic2):
        z2, b = camera.array_distance, camera.b
        return {name: float(camera.dz(camera.image_distance / (z2 + v * b)))
                for name, v in VIRTUAL.items()}
    tolerance = camera.mla.pitch / camera.aperture_diameter
    return {name: float(camera.dz(1 + blur * tolerance)) for name, blur in BLURS.items()}


def exposed(camera: Any, step: float) -> RawImage:
    """The raw image of the letters, made of stars, each of which hides what is behind it."""
    random, scene = np.random.default_rng(1), []
    for name, dz in distances(camera).items():
        samples = mask(name, 2 * int(HALF / step) + 1, step)
        pitch = step * camera.mla.pitch / abs(float(camera.array_scale(dz)))
        at = np.argwhere(samples)[:, ::-1] - len(samples) // 2
        places = pitch * (at + random.uniform(-0.5, 0.5, at.shape))
        scene += [PointSources(np.column_stack([places, np.full(len(at), dz)])),
                  Occluder(samples, pitch * len(samples), dz)]
    return camera.expose(scene)


def inside(name: str, shape: Sequence[int], pitches: Sequence[float]) -> np.ndarray:
    """Which samples of a map a letter covers alone; the map is upside down, pitches in lenslets."""
    found, n = {}, 4 * HALF + 1
    at = []
    for m, pitch in zip(shape, pitches, strict=True):
        place = -(np.arange(m) - (m - 1) / 2) * pitch / 0.5
        at.append(np.clip(np.rint(place).astype(int) + n // 2, 0, n - 1))
    for letter in BLURS:
        drawn = mask(letter, n, 0.5) > 0
        if letter != name:  # two lenslets beside it, too
            drawn = binary_dilation(drawn, iterations=4)
        found[letter] = drawn[np.ix_(*at)]
    others = [found[other] for other in found if other != name]
    return found[name] & ~np.any(others, axis=0)


def standard(camera: Any, raw: RawImage) -> tuple[Any, ...]:
    """Stack and depth (alpha) of a 1.0 camera, and what the letters' depth should be.

    The outermost views count nothing: behind lenslets as fast as the main lens they hold light of
    the neighbours.
    """
    lf = LightField.from_raw(raw)
    v, u = (np.abs(np.arange(n) - (n - 1) / 2) / n for n in lf.shape[:2])
    lf = replace(lf, weights=(np.hypot(v[:, None], u) < 0.47).astype(np.float32))
    stack = [pixels(refocus(lf, alpha=camera.alpha(dz))) for dz in distances(camera).values()]
    alphas = 1 + np.linspace(-4, 4, 33) * camera.mla.pitch / camera.aperture_diameter
    depth = depth_map(lf, alphas=alphas)
    blur = (np.asarray(lf.alpha(depth.disparity)) - 1) * camera.aperture_diameter / camera.mla.pitch
    lit = stack[1] > DARK * stack[1].max()
    pitches = np.divide(lf.spacing[2:], camera.mla.pitch)
    return stack, blur, np.where(lit, depth.confidence, 0), pitches, BLURS


def focused(camera: Any, raw: RawImage) -> tuple[Any, ...]:
    """The same of a 2.0 camera, with the virtual depth -1/m."""
    stack = [pixels(render_focused(raw, method="blended", m=-1 / v)) for v in VIRTUAL.values()]
    depth = focused_depth(raw, ms=(-0.24, -0.1), window=3.0)
    confidence = np.nan_to_num(depth.confidence)
    return stack, -1 / depth.m, confidence, (np.sqrt(3) / 2, 1.0), VIRTUAL
