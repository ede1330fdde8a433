"""Volumes that are known, and their frames in photons behind a light-field microscope."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen import Device, MicrolensArray, PlenopticCamera
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.model.psf import point_images
from clplen.microscopy.reconstruction.projector import Projector

Vector = np.ndarray[Any, Any]

SIDE = 1.25e-6  # of a voxel, five a lenslet


def projector_of(device: Device, planes: Any, lenslets: int = 9) -> Projector:
    """20x/0.5, 525 nm, lenslets of 125 um, f/20, 25 pixels, square."""
    camera = PlenopticCamera.microscope(
        magnification=20, na=0.5, wavelength=525e-9, pixels_per_lenslet=25,
        mla=MicrolensArray(125e-6, 2.5e-3, count=9, fill="full"), device=device,
    )  # fmt: skip
    shape = (lenslets, lenslets)
    return Projector(point_images(camera, planes, cut=5e-3), shape, device=device)


def any_projector(device: Device, shape: tuple[int, int] = (3, 5)) -> Projector:
    """Of point images of random numbers: 2 planes, 2 voxels and 3 pixels along a lenslet."""
    rng = np.random.default_rng(1)
    planes = tuple(rng.random((3, 9, 9)).astype(np.float32) for _ in range(2))
    about = {"na": 0.5, "medium_index": 1.0, "magnification": 20.0, "lenslet_pitch": 125e-6}
    images = PointImages(about, np.array([0.0, 1e-5]), 2, 3, planes, np.ones(2))
    return Projector(images, shape, device=device)


def axes(projector: Projector) -> tuple[Vector, Vector, Vector]:
    """(z, y, x) of voxels in um, to be broadcast."""
    _, ny, nx = projector.volume_shape
    y, x = (1e6 * SIDE * (np.arange(n) - (n - 1) / 2) for n in (ny, nx))
    return projector.images.planes[:, None, None] * 1e6, y[:, None], x


def shell(projector: Projector, radius: float = 18.0) -> Vector:
    """A hollow sphere, 2.5 um (rms) thick, its centre off the axis."""
    z, y, x = axes(projector)
    return np.exp(-0.5 * ((np.sqrt(z**2 + (y - 1) ** 2 + (x + 2) ** 2) - radius) / 2.5) ** 2)


def beads(projector: Projector, count: int = 12) -> Vector:
    """Single voxels anywhere, no nearer than 8 to the border."""
    volume, rng = np.zeros(projector.volume_shape), np.random.default_rng(1)
    for _ in range(count):
        at = rng.integers((0, 8, 8), np.array(volume.shape) - (0, 8, 8))
        volume[tuple(at)] += rng.uniform(0.5, 1)
    return volume


def filaments(projector: Projector, count: int = 5) -> Vector:
    """Straight lines of 50 um in any direction, 1.2 um (rms) thick, 2.5 um along z."""
    z, y, x = axes(projector)
    volume, rng = np.zeros(projector.volume_shape), np.random.default_rng(3)
    for _ in range(count):
        centre = (rng.random(3) - 0.5) * (30, 20, 20)
        along = rng.normal(size=3)
        along /= np.linalg.norm(along)
        for t in np.linspace(-25, 25, 100):
            cz, cy, cx = centre + t * along
            across = ((z - cz) / 2.5) ** 2 + ((y - cy) / 1.2) ** 2 + ((x - cx) / 1.2) ** 2
            volume += np.exp(-0.5 * across)
    return volume


def voxels(projector: Projector, *places: tuple[int, int, int]) -> Vector:
    """Equal light in some voxels."""
    volume = np.zeros(projector.volume_shape)
    for place in places:
        volume[place] = 1
    return volume


def counted(
    projector: Projector, volume: Vector, photons: float, seed: int = 0
) -> tuple[Vector, Vector]:
    """A frame in photons, and the volume in the photons of each voxel."""
    frame = projector.forward(volume).astype(np.float64)
    scale = photons / frame.sum()
    return np.random.default_rng(seed).poisson(frame * scale), volume * scale


def wrong(found: Vector, true: Vector) -> float:
    """Relative error, by energy."""
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def divergence(V: Vector, z: Vector, e: float) -> Vector:
    """div(g/sqrt(g^2 + e^2)) of V over the thickness of the planes; z: sorted, in voxels."""
    thick = np.gradient(z)
    rho = V / thick[:, None, None]
    g = [np.diff(rho, axis=axis, append=rho.take([-1], axis)) for axis in range(3)]
    g[0][:-1] /= np.diff(z)[:, None, None]
    p = [one / np.sqrt(sum(np.square(g)) + e**2) for one in g]
    dz, dy, dx = (np.diff(one, axis=axis, prepend=0) for axis, one in enumerate(p))
    return dz / thick[:, None, None] + dy + dx
