"""Scenes on which depth usually fails, with exact truth.

Views whose brightness differs, by place and direction, as behind real lenses; wide ranges of
disparity; fine texture on slants; thin things; highlights; haze; faint walls; repeated texture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

import clplen
from clplen.cameras import (
    Bars,
    Ellipse,
    Plane,
    Sphere,
    Spot,
    checker,
    noise,
    rectangle,
    uniform,
)

Array = np.ndarray[Any, Any]
LEVEL = 1 / 255  # of white


@dataclass(frozen=True)
class HardScene:
    """A light field with its truth.

    Attributes
    ----------
    name : str
    samples : numpy.ndarray
        float32, shape (V, U, y, x).
    disparity : numpy.ndarray
        Shape (y, x); the truth of the centre view.
    planes : numpy.ndarray
        Disparities that hold it.
    """

    name: str
    samples: Array
    disparity: Array
    planes: Array


def _smooth(random: np.random.Generator, shape: tuple[int, ...], reach: float) -> Array:
    """Random fields of deviation 1, smooth over some pixels along the last two axes."""
    sd = (*(0.0,) * (len(shape) - 2), reach, reach)
    values = gaussian_filter(random.standard_normal(shape), sd, mode="wrap")
    return values / values.std()


def _gains(samples: Array, random: np.random.Generator) -> Array:
    """Each view brighter or darker by some per cent, and by 2 levels from place to place."""
    V, U, *size = samples.shape
    gain = 1 + 0.03 * random.standard_normal((V, U, 1, 1))
    return samples * gain + 2 * LEVEL * _smooth(random, (V, U, *size), 20)


def _vignetting(samples: Array, random: np.random.Generator) -> Array:
    """Views dimmer towards the rim of the aperture, more so at the border that is on their side."""
    del random
    V, U, ny, nx = samples.shape
    v, u = np.meshgrid(np.linspace(-1, 1, V), np.linspace(-1, 1, U), indexing="ij")
    y, x = np.meshgrid(np.linspace(-1, 1, ny), np.linspace(-1, 1, nx), indexing="ij")
    away_y = v[..., None, None] + 0.5 * y
    away_x = u[..., None, None] + 0.5 * x
    return samples * (1 - 0.3 * (away_y**2 + away_x**2) / 4.5)


def _shading(samples: Array, random: np.random.Generator) -> Array:
    """Surfaces whose brightness depends on the direction: 2 levels, smooth over the aperture."""
    V, U, ny, nx = samples.shape
    v, u = np.meshgrid(np.linspace(-1, 1, V), np.linspace(-1, 1, U), indexing="ij")
    along = _smooth(random, (2, ny, nx), 8)
    return samples + 2 * LEVEL * (v[..., None, None] * along[0] + u[..., None, None] * along[1])


def _haze(samples: Array, random: np.random.Generator) -> Array:
    """A thin transparent layer before everything, which moves by 2.5 pixels a view."""
    V, U, ny, nx = samples.shape
    wide = _smooth(random, (ny + 40, nx + 40), 6)
    layer = np.empty_like(samples)
    for v, u in np.ndindex(V, U):
        dy, dx = round(2.5 * (v - V // 2)), round(2.5 * (u - U // 2))
        layer[v, u] = wide[20 - dy : 20 - dy + ny, 20 - dx : 20 - dx + nx]
    return 0.85 * samples + 0.1 + 0.01 * layer


def _front(seed: int, disparity: float, outline: Any, contrast: float = 0.15) -> Plane:
    return Plane(disparity, texture=noise(seed, contrast=contrast), outline=outline)


def _plain_scene(unit: float, seed: int) -> list[Any]:
    """A slanted ground, a disc and a bar before it."""
    return [
        Plane(-1.0, (0.3 / unit, 0.2 / unit), texture=noise(seed)),
        _front(seed + 1, 0.4, Ellipse((-0.3 * unit, -0.3 * unit), (0.45 * unit, 0.5 * unit))),
        _front(seed + 2, 1.1, rectangle((0.4 * unit, 0.3 * unit), (0.3 * unit, 1.1 * unit))),
    ]


def _wide(unit: float) -> list[Any]:
    return [
        Plane(-2.8, (0.2 / unit, 0.0), texture=noise(41, finest=0.45, exponent=0.5)),
        Plane(
            0.0,
            texture=noise(42, finest=0.45, exponent=0.5),
            outline=Ellipse((-0.2 * unit, -0.4 * unit), (0.6 * unit, 0.4 * unit)),
        ),
        Plane(
            2.5,
            texture=noise(43, finest=0.45, exponent=0.5),
            outline=rectangle((0.3 * unit, 0.4 * unit), (0.5 * unit, 0.6 * unit), angle=0.4),
        ),
    ]


def _slanted(unit: float) -> list[Any]:
    fine = noise(51, finest=0.5, exponent=0.3, contrast=0.2)
    return [
        Plane(0.0, (1.5 / unit, -0.4 / unit), texture=fine),
        Plane(
            1.6,
            (0.0, 0.3 / unit),
            texture=noise(52, finest=0.5, exponent=0.3),
            outline=rectangle((0.3 * unit, 0.5 * unit), (0.4 * unit, 0.4 * unit)),
        ),
    ]


def _thin(unit: float) -> list[Any]:
    bars = Bars((0, 0), 1.5 * unit, count=7, period=0.25 * unit, width=0.05 * unit)
    return [
        Plane(-0.8, (0.0, 0.3 / unit), texture=noise(61)),
        Plane(0.9, texture=noise(62), outline=bars),
    ]


def _glossy(unit: float) -> list[Any]:
    spots = [
        Spot((-0.25 * unit, -0.3 * unit), 0.08 * unit),
        Spot((0.1 * unit, 0.1 * unit), 0.05 * unit),
    ]
    return [
        Plane(-0.9, texture=noise(71)),
        Sphere(
            (-0.05 * unit, -0.05 * unit),
            0.6 * unit,
            disparity=-0.3,
            height=1.2,
            texture=noise(72, contrast=0.08),
            spots=spots,
        ),
    ]


def _faint(unit: float) -> list[Any]:
    return [
        Plane(-0.5, (0.4 / unit, 0.0), texture=noise(81, contrast=0.02, exponent=1.5)),
        Plane(
            0.6,
            texture=uniform(0.6),
            outline=rectangle((0.3 * unit, -0.4 * unit), (0.4 * unit, 0.5 * unit)),
        ),
        _front(83, 0.9, Ellipse((-0.3 * unit, 0.4 * unit), (0.3 * unit, 0.3 * unit)), 0.05),
    ]


def _repeated(unit: float) -> list[Any]:
    return [
        Plane(-0.7, (0.3 / unit, 0.2 / unit), texture=checker(11.0, low=0.2, high=0.8)),
        Plane(
            0.8,
            texture=checker(9.0, low=0.3, high=0.7),
            outline=Ellipse((0.1 * unit, -0.2 * unit), (0.5 * unit, 0.6 * unit)),
        ),
    ]


def _checkerboard(unit: float) -> list[Any]:
    return [Plane(0.35, (0.1 / unit, -0.15 / unit), texture=checker(0.3 * unit, low=0.1, high=0.9))]


Change = Callable[[Array, np.random.Generator], Array]
_SCENES: dict[str, tuple[Callable[[float], list[Any]], Change | None, float]] = {
    # name: surfaces, what happens to the views, noise
    "brightness of views": (lambda unit: _plain_scene(unit, 11), _gains, 0.005),
    "vignetting": (lambda unit: _plain_scene(unit, 21), _vignetting, 0.005),
    "shading": (lambda unit: _plain_scene(unit, 31), _shading, 0.005),
    "wide range": (_wide, None, 0.005),
    "wide range, brightness": (_wide, _gains, 0.005),
    "fine slant": (_slanted, None, 0.005),
    "thin bars": (_thin, None, 0.005),
    "thin bars, shading": (_thin, _shading, 0.005),
    "highlights": (_glossy, None, 0.005),
    "haze": (lambda unit: _plain_scene(unit, 91), _haze, 0.005),
    "faint walls": (_faint, None, 0.003),
    "faint walls, shading": (_faint, _shading, 0.003),
    "repeated texture": (_repeated, _gains, 0.005),
    "flat checkerboard, shading": (_checkerboard, _shading, 0.003),
}


def hard_scenes(
    shape: tuple[int, int] = (128, 160),
    *,
    views: tuple[int, int] = (9, 9),
    device: Any = None,
    only: str | None = None,
) -> Iterator[HardScene]:
    """Scenes of each kind, or those whose name holds ``only``."""
    unit = min(shape) / 2
    for number, (name, (surfaces, change, sd)) in enumerate(_SCENES.items()):
        if only is not None and only not in name:
            continue
        random = np.random.default_rng([7, number])
        scene = clplen.SurfaceScene(surfaces(unit))
        lf, truth = scene.light_field(views, shape, device=device)
        samples = lf.to_numpy().astype(np.float64)
        if change is not None:
            samples = change(samples, random)
        samples = samples + sd * random.standard_normal(samples.shape)
        eight_bits = np.round(np.clip(samples, 0, 1) * 255) / 255
        reach = 3.2 if "wide" in name else 2.0
        planes = np.linspace(-reach, reach, 41)
        yield HardScene(name, eight_bits.astype(np.float32), truth.disparity, planes)
