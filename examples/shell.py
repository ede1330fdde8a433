"""Hollow shells in volumes: where one lies, how large it is, how hollow; and how one is drawn.

Along rays from its centre the light has a ridge. An ellipsoid with axes along z, y and x is put
through the ridges, all directions weighing the same; single ones that err weigh little (soft L1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares

RAYS = 1500  # even over the sphere
POINTS = 60000  # of a shell that is drawn
STEPS = 120  # of a ray, from REACH[0] to REACH[1] of the radius
REACH = (0.4, 1.6)
CLEAR = 1.5  # a ridge is so many times brighter than the ray's median
ROUNDS = 4  # rays from the centre that the round before found
NEAR = 4e-6  # metres
MISFIT = 0.5e-6  # metres from which on a ridge weighs less


@dataclass(frozen=True)
class Voxels:
    """Where the voxels of a volume (planes, rows, columns) lie: z of the planes in equal steps, y
    and x about the axis, in metres.
    """

    planes: np.ndarray
    side: float
    shape: tuple[int, int, int]

    @property
    def first(self) -> np.ndarray:
        """(z, y, x) of the first one."""
        y, x = (-(count - 1) / 2 * self.side for count in self.shape[1:])
        return np.array([self.planes[0], y, x])

    @property
    def step(self) -> np.ndarray:
        """From one to the next."""
        return np.array([self.planes[1] - self.planes[0], self.side, self.side])

    def index(self, places: np.ndarray) -> np.ndarray:
        """Places (..., 3) in voxels."""
        return (places - self.first) / self.step


@dataclass(frozen=True)
class Shell:
    """An ellipsoid in metres, (z, y, x); what it was put through.

    spread is the rms distance of ridges from it, clear the share of rays with a ridge; ridges has
    shape (k, 3).
    """

    centre: np.ndarray
    radii: np.ndarray
    spread: float
    clear: float
    ridges: np.ndarray


def directions(count: int = RAYS) -> np.ndarray:
    """Unit vectors (z, y, x), even over the sphere."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    return np.stack([z, np.sqrt(1 - z**2) * np.sin(turn), np.sqrt(1 - z**2) * np.cos(turn)], 1)


def at(volume: np.ndarray, voxels: Voxels, places: np.ndarray) -> np.ndarray:
    """Values at places (..., 3) in metres, linear between voxels; beyond the volume 0."""
    return map_coordinates(volume, np.moveaxis(voxels.index(places), -1, 0), order=1)


def drawn(voxels: Voxels, centre: Any, radii: Any, *, dim: float = 0.0) -> np.ndarray:
    """A thin shell, 1 - dim cos^2 of the angle to z bright, of light 1, linear between voxels."""
    rays = directions(POINTS)
    light = (1 - dim * rays[:, 0] ** 2) / (1 - dim / 3) / POINTS
    index = voxels.index(np.asarray(centre) + np.asarray(radii) * rays)
    low = np.floor(index).astype(int)
    total = np.zeros(np.prod(voxels.shape))
    for corner in np.ndindex(2, 2, 2):
        share = np.abs(1 - np.array(corner) - (index - low)).prod(axis=1)
        place = np.ravel_multi_index((low + corner).T, voxels.shape, mode="clip")
        total += np.bincount(place, light * share, total.size)
    return total.reshape(voxels.shape).astype(np.float32)


def ridges(volume: np.ndarray, voxels: Voxels, rays: np.ndarray, centre: np.ndarray, radius: float
           ) -> tuple[np.ndarray, np.ndarray]:
    """Places of the ridges, shape (k, 3), and which rays have one."""
    far = np.linspace(*REACH, STEPS) * radius
    light = at(volume, voxels, centre + far[:, None] * rays[:, None])
    top = light.argmax(axis=1)
    inside = np.clip(top, 1, STEPS - 2)
    k = np.arange(len(rays))
    before, peak, after = (light[k, inside + d] for d in (-1, 0, 1))
    bend = np.minimum(before - 2 * peak + after, -1e-30)
    shift = np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    clear = (top == inside) & (peak > CLEAR * np.median(light, axis=1))
    r = far[0] + (inside + shift) * (far[1] - far[0])
    return (centre + r[:, None] * rays)[clear], clear


def find_shell(volume: np.ndarray, voxels: Voxels, *, centre: Any, radius: float,
               within: float = 90.0) -> Shell:
    """The ellipsoid through the ridges, from a centre and a radius that are roughly right.

    Rays rise up to ``within`` degrees from the plane z = 0.
    """
    rays = directions()
    rays = rays[np.abs(rays[:, 0]) <= np.sin(np.radians(within))]
    values = np.array([*centre, radius, radius, radius], float)
    for _ in range(ROUNDS):
        places, clear = ridges(volume, voxels, rays, values[:3], float(values[3:].mean()))
        fit = least_squares(misfit, values, args=(places,), loss="soft_l1", f_scale=MISFIT,
                            x_scale=np.full(6, 1e-6))
        values = fit.x
    off = misfit(values, places)
    return Shell(values[:3], values[3:], float(np.sqrt(np.mean(off**2))), clear.mean(), places)


def misfit(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Distances of places from an ellipsoid along rays from its centre, in metres."""
    from_centre = places - values[:3]
    length = np.linalg.norm(from_centre, axis=1)
    return length * (1 - 1 / np.linalg.norm(from_centre / values[3:], axis=1))


def grain(volume: np.ndarray, voxels: Voxels, shell: Shell) -> float:
    """Standard deviation over mean on the ring (.93 to 1.07), mean of planes within 4 um of z = 0.

    There the lattice of lenslets shows.
    """
    y, x = (voxels.first[n] + voxels.side * np.arange(voxels.shape[n]) for n in (1, 2))
    r = np.hypot(y[:, None] - shell.centre[1], x - shell.centre[2]) / shell.radii[1:].mean()
    light = volume[np.abs(voxels.planes) < NEAR][:, (r > 0.93) & (r < 1.07)]
    return float((light.std(axis=1) / light.mean(axis=1)).mean())


def contrast(volume: np.ndarray, voxels: Voxels, shell: Shell, *, normal: int | None = None
             ) -> tuple[float, float]:
    """Mean light within .5 of the shell and from 1.3 to 1.5 of it, over that of .9 to 1.1.

    ``normal`` (0, 1, 2: z, y, x) asks for the plane through the centre normal to that axis.
    """
    rays, power = directions(), 3
    if normal is not None:
        turn, power = np.linspace(0, 2 * np.pi, 360, endpoint=False), 2
        rays = np.insert(np.stack([np.sin(turn), np.cos(turn)], 1), normal, 0.0, axis=1)

    def mean(a: float, b: float) -> float:
        scale = np.linspace(a**power, b**power, 15)[:, None, None] ** (1 / power)
        return float(at(volume, voxels, shell.centre + scale * rays * shell.radii).mean())

    return mean(0.0, 0.5) / mean(0.9, 1.1), mean(1.3, 1.5) / mean(0.9, 1.1)
