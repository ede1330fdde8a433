"""Volumes behind light-field microscopes with other lattices of lenslets, without resampling.

    python -m benchmarks accuracy/lattices [--device pocl] [--only points,...] [--arrays turned,...]

The same objective (20x/0.5 in air, 525 nm) before square, turned, hexagonal and multi-focus arrays
of one pitch (125 um, 15 pixels of the camera, that integrate), simulated by waves on the array as
it lies; and what `deconvolve` finds with `FrameProjector`, beside the square array with
`Projector`: the place of points, the dip between two of them, a shell; and how well a point could
be placed at best. A line for each figure of docs/microscope_lattices.md with its limit; ratios are
to the square array, of the same points. Poisson noise throughout.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import click
import numpy as np
from scipy.ndimage import map_coordinates

from clplen import (
    Device,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    Projector,
    deconvolve,
    point_images,
)
from clplen.cameras import Microscope, PixelArray
from clplen.microscopy import FrameProjector, PointImages, lattice_of

Row = tuple[str, float, float]
Values = np.ndarray[Any, Any]

PITCH, M, PIXELS, VOXELS = 125e-6, 20, 15, 3
WHOLE = {"square": 17, "two foci upright": 18}  # lenslets across, on whole pixels
ACROSS = 17  # of others
PLANES = tuple(5e-6 * k for k in range(3, 8))
OPTICS = {"magnification": M, "na": 0.5, "wavelength": 525e-9}
F = 2.5e-3
ARRAYS: dict[str, dict[str, Any]] = {
    "square": {},
    "turned": {"rotation": 0.2, "offset": (20e-6, -30e-6)},
    "hexagonal": {"lattice": "hexagonal", "rotation": 0.05},
    "two foci": {"focal_length": (F, 1.1 * F), "rotation": -0.1},
    "two foci upright": {"focal_length": (F, 1.1 * F)},
    "three foci": {"lattice": "hexagonal", "focal_length": (F, 0.95 * F, 1.1 * F)},
}
WORSE = 1.1  # than the square array, at most
PHOTONS = 2e5  # of a point; of a shell a hundred times as many
ITERATIONS = 30


@dataclass(frozen=True)
class Way:
    """An array with what projects onto its frames."""

    name: str
    device: Device
    over: float = 1.5
    planes: tuple[float, ...] = PLANES

    def _array(self, **change: Any) -> MicrolensArray:
        values = {"focal_length": F, "count": 31, "fill": "full", **ARRAYS[self.name], **change}
        return MicrolensArray(PITCH, **values)

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx) of frames."""
        n = PIXELS * WHOLE.get(self.name, ACROSS)
        return n, n

    @cached_property
    def camera(self) -> Microscope:
        """As it takes frames."""
        pixels = PixelArray(pitch=PITCH / PIXELS, shape=self.shape)
        return PlenopticCamera.microscope(
            **OPTICS, mla=self._array(), pixels=pixels, device=self.device
        )

    @cached_property
    def images(self) -> PointImages:
        """Of the array along the axes, on finer pixels."""
        n, parts = (PIXELS, 3) if self.name in WHOLE else (round(PIXELS * self.over), 2)
        camera = PlenopticCamera.microscope(
            **OPTICS, mla=self._array(rotation=0.0, offset=(0, 0)), pixels_per_lenslet=parts * n,
            device=self.device,
        )  # fmt: skip
        integrated = {} if self.name in WHOLE else {"sensor_pixels": PIXELS}
        return point_images(
            camera, self.planes, voxels_per_lenslet=VOXELS, binning=parts, **integrated, cut=5e-3
        )

    @cached_property
    def projector(self) -> Projector:
        """Onto the camera's pixels."""
        if self.name in WHOLE:
            rows, columns = (WHOLE[self.name] // k for k in self.images.cell.lenslets)
            return Projector(self.images, (rows, columns), device=self.device)
        return FrameProjector(self.images, lattice_of(self.camera), device=self.device)

    @cached_property
    def place(self) -> tuple[Values, Values]:
        """(x, y) in metres of voxel (0, 0), and the steps (down, right) to the next ones."""
        projector = self.projector
        if isinstance(projector, FrameProjector):
            first, down, right = (np.array(one) for one in projector.voxel_grid().values())
        else:
            side = PIXELS / VOXELS
            first, down, right = (
                np.full(2, (side - 1) / 2),
                np.array([side, 0]),
                np.array([0, side]),
            )
        scale = PITCH / PIXELS / M
        middle = (np.array(self.shape) - 1) / 2
        return (first - middle)[::-1] * scale, np.array([down, right])[:, ::-1] * scale

    def voxels(self) -> Values:
        """(x, y, z) in metres of every voxel."""
        first, (down, right) = self.place
        z, i, k = np.indices(self.projector.volume_shape)
        xy = first + i[..., None] * down + k[..., None] * right
        return np.concatenate([xy, np.array(self.planes)[z][..., None]], axis=-1)

    def at(self, volume: Values, places: Values) -> Values:
        """A volume at places (x, y, z) in metres, linearly."""
        first, steps = self.place
        i, k = ((places[:, :2] - first) @ np.linalg.inv(steps)).T
        z = np.interp(places[:, 2], self.planes, np.arange(len(self.planes)))
        return np.asarray(map_coordinates(volume, (z, i, k), order=1))

    def found(self, scenes: list[PointSources], photons: float) -> tuple[Values, Values]:
        """Volumes of scenes, and their residuals."""
        rng = np.random.default_rng(7)
        frames = np.stack([self.camera.expose(scene).to_numpy() for scene in scenes])
        counts = rng.poisson(np.maximum(frames, 0) * photons).astype(np.float32)
        made = deconvolve(counts, self.projector, iterations=ITERATIONS)
        return made.volume, made.residuals[:, -1]


@cache
def camera_of(device: Device, pitch: float, name: str) -> Microscope:
    """That takes frames of a point alone."""
    values = {"focal_length": F, "count": 25, "fill": "full", **ARRAYS[name]}
    pixels = PixelArray(pitch=PITCH / PIXELS, shape=(13 * PIXELS,) * 2)
    return PlenopticCamera.microscope(
        **OPTICS, mla=MicrolensArray(pitch, **values), pixels=pixels, device=device
    )


@cache
def way_of(name: str, device: Device) -> Way:
    """With what it has made."""
    return Way(name, device)


@dataclass(frozen=True)
class Asked:
    """Arrays to be measured on a device, the square one first."""

    device: Device
    names: tuple[str, ...]

    def ways(self) -> Iterator[Way]:
        """All of them, one after the other."""
        return (way_of(name, self.device) for name in self.names)


def against_square(
    asked: Asked,
    measure: Callable[[Way], dict[str, Values]],
    together: Callable[[Values], float] = np.mean,
) -> Iterator[Row]:
    """Figures of every array, from a value for each object, and their ratios to the square array's.

    Standard deviations are those of ratios over 1000 draws of as many objects (Efron 1979).
    """
    rng, known = np.random.default_rng(1), dict[str, Values]()
    for way in asked.ways():
        for what, values in measure(way).items():
            first = known.setdefault(what, values)
            some = rng.integers(0, len(values), (1000, len(values)))
            ratios = [together(values[one]) / together(first[one]) for one in some]
            ratio, value = together(values) / together(first), together(values)
            text = f"{way.name}: {what}, {value:.4g}; over the square's, +-{np.std(ratios):.3f}"
            yield text, float(ratio), WORSE


def rms(values: Values) -> float:
    """Over the first axis."""
    return float(np.sqrt(np.square(values).sum() / len(values)))


def points(asked: Asked) -> Iterator[Row]:
    """198 points in 22 frames: their places by centroids."""
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(*[[-28e-6, 0, 28e-6]] * 2), -1).reshape(9, 2)
    scenes = [
        np.column_stack([grid + rng.uniform(-4e-6, 4e-6, (9, 2)), rng.uniform(17e-6, 33e-6, 9)])
        for _ in range(22)
    ]

    def measure(way: Way) -> dict[str, Values]:
        volumes, _ = way.found([PointSources(one) for one in scenes], PHOTONS)
        where, errors = way.voxels(), []
        for volume, scene in zip(volumes, scenes, strict=True):
            for point in scene:
                near = np.abs(where - point).max(axis=-1) < 10e-6
                light, off = volume[near].astype(float), where[near] - point
                errors.append(light @ off / light.sum())
        um = 1e6 * np.array(errors)
        return {
            "points, rms error across, um": um[:, :2],
            "points, rms error along z, um": um[:, 2],
        }

    yield from against_square(asked, measure, rms)


def pairs(asked: Asked) -> Iterator[Row]:
    """81 pairs, 6 um apart in all directions, 20 um away: least between over the lower peak."""
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(*[[-28e-6, 0, 28e-6]] * 2), -1).reshape(9, 2)
    scenes = []
    for _ in range(9):
        middle, angle = grid + rng.uniform(-4e-6, 4e-6, (9, 2)), rng.uniform(0, np.pi, 9)
        half = 3e-6 * np.column_stack([np.cos(angle), np.sin(angle)])
        scenes.append((middle, half))

    def measure(way: Way) -> dict[str, Values]:
        sources = [
            PointSources(np.column_stack([np.concatenate([m - h, m + h]), np.full(18, 20e-6)]))
            for m, h in scenes
        ]
        volumes, _ = way.found(sources, PHOTONS)
        dips = []
        for volume, (middle, half) in zip(volumes, scenes, strict=True):
            for m, h in zip(middle, half, strict=True):
                t = np.linspace(-1.4, 1.4, 57)
                line = np.column_stack([m + t[:, None] * h, np.full(57, 20e-6)])
                seen = way.at(volume, line)
                peaks = seen[t < -0.5].max(), seen[t > 0.5].max()
                dips.append(seen[np.abs(t) <= 0.5].min() / min(peaks))
        return {"pairs, least between over the peak": np.array(dips)}

    yield from against_square(asked, measure)


def shell(asked: Asked) -> Iterator[Row]:
    """A shell of 9 um about z = 25 um: radius and thickness of the light, residual."""
    rng, radius, middle = np.random.default_rng(9), 9e-6, np.array([1e-6, -2e-6, 25e-6])
    v = rng.normal(size=(60, 3))
    on_shell = middle + radius * v / np.linalg.norm(v, axis=1, keepdims=True)

    def measure(way: Way) -> dict[str, Values]:
        source = PointSources(on_shell, power=np.full(60, 1 / 60))
        volumes, residuals = way.found([source], 100 * PHOTONS)
        off = way.voxels() - middle
        r = np.linalg.norm(off, axis=-1)
        light = np.where(r < 14e-6, volumes[0], 0).astype(float)
        mean = (light * r).sum() / light.sum()
        thick = np.sqrt((light * (r - mean) ** 2).sum() / light.sum())
        inside = volumes[0][r < 4e-6].sum() / volumes[0].sum()
        return {
            "shell, radius, um": np.array([1e6 * mean]),
            "shell, thickness, um": np.array([1e6 * thick]),
            "shell, light in its middle": np.array([inside]),
            "shell, residual": residuals[:1],
        }

    yield from against_square(asked, measure)


def bound(asked: Asked) -> Iterator[Row]:
    """The least standard deviation of a point's place that photon noise allows (Cramer-Rao).

    Of unknown place and power, F_ij = sum of dm/di dm/dj / m over the pixels; rms of 24 places. The
    hexagonal array is also that whose lenslets have the square ones' area.
    """
    rng = np.random.default_rng(11)
    places = np.column_stack([rng.uniform(-8e-6, 8e-6, (24, 2)), rng.uniform(17e-6, 33e-6, 24)])
    arrays = {
        "square": (PITCH, "square"),
        "hexagonal": (PITCH, "hexagonal"),
        "hexagonal of equal area": (PITCH * (4 / 3) ** 0.25, "hexagonal"),
        "two foci": (PITCH, "two foci"),
    }
    known: dict[str, float] = {}
    for name, (pitch, array) in arrays.items():
        camera = camera_of(asked.device, pitch, array)
        sigma = 1e9 * np.array([least_deviation(camera, place) for place in places])
        for what, values in (("across", sigma[:, :2]), ("along z", sigma[:, 2])):
            first = known.setdefault(what, rms(values))
            text = f"{name}: bound of a point {what}, {rms(values):.3g} nm; over the square's"
            yield text, rms(values) / first, WORSE


def least_deviation(camera: Microscope, place: Values) -> Values:
    """Of x, y and z in metres."""

    def seen(at: Values) -> Values:
        frame: Values = camera.expose(PointSources([at])).to_numpy().astype(float).ravel()
        return frame

    steps = np.diag([1e-7, 1e-7, 2e-7])
    mean = seen(place)
    slopes = [(seen(place + s) - seen(place - s)) / (2 * s.sum()) for s in steps]
    all_of = np.array([*slopes, mean])
    information = PHOTONS * (all_of / np.maximum(mean, 1e-6 * mean.max())) @ all_of.T
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))[:3]))


SECTIONS: dict[str, Callable[[Asked], Iterator[Row]]] = {
    one.__name__: one for one in (points, pairs, shell, bound)
}


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--only", default=",".join(SECTIONS), show_default=True)
@click.option("--arrays", default=",".join(ARRAYS), show_default=True, help="Beside square.")
def main(selector: str | None, only: str, arrays: str) -> None:
    """A table of figures and limits; ends with 1 where one is not met."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    met = True
    names = [name for name in ARRAYS if name in ("square", *arrays.split(","))]
    asked = Asked(device, tuple(names))
    for name in only.split(","):
        for what, found, limit in SECTIONS[name](asked):
            met &= found <= limit
            says = "" if found <= limit else "  NOT MET"
            click.echo(f"{what:<88}{found:>9.3g}   at most {limit:g}{says}")
    sys.exit(0 if met else 1)

