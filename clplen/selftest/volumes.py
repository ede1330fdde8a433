"""Checks of microscopy: projection of volumes, deconvolution, what is known beforehand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.microscopy.deconvolution import LEAST, deconvolve
from clplen.microscopy.images import PointImages
from clplen.microscopy.priors import EVEN, SMOOTH, Sieve, TotalVariation, blurs
from clplen.microscopy.projector import Projector
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs

if TYPE_CHECKING:
    from clplen.compute.device import Device

SHAPE, V, N = (5, 6), 2, 3  # lenslets; voxels and pixels of one along an axis
OPTICS = {"na": 0.5, "medium_index": 1.0, "magnification": 20.0, "lenslet_pitch": 125e-6}


def _projector(device: Device) -> Projector:
    """Random point images of two planes, with the mirror symmetries of a square lattice."""
    planes = []
    for r in (1, 2):
        side = (2 * r + 1) * N
        h = twins.reals(r, side, side, low=0.1)
        planes.append((h + h.T)[None])
    z = np.array([1e-6, -4e-6])
    images = PointImages(OPTICS, z, V, N, tuple(planes), np.ones(2))
    return Projector(images, SHAPE, device=device)


def _matrix(projector: Projector) -> Any:
    """H[pixel, voxel]: the image of every voxel where it lies on the frame."""
    (planes, ny, nx), (height, width) = projector.volume_shape, projector.frame_shape
    H = np.zeros((height * width, planes, ny, nx))
    for z, y, x in np.ndindex(planes, ny, nx):
        image, r = projector.images.image(z, (y % V, x % V)), projector.images.radii[z]
        frame = np.zeros((height + 2 * r * N, width + 2 * r * N))
        top, left = y // V * N, x // V * N
        frame[top : top + len(image), left : left + len(image)] = image
        H[:, z, y, x] = frame[r * N : r * N + height, r * N : r * N + width].ravel()
    return H.reshape(height * width, -1)


def _projected(device: Device) -> Pairs:
    projector = _projector(device)
    H = _matrix(projector)
    volume, frame = twins.reals(3, *projector.volume_shape), twins.reals(4, *projector.frame_shape)
    yield (H @ volume.ravel()).reshape(frame.shape), projector.forward(volume)
    yield (H.T @ frame.ravel()).reshape(volume.shape), projector.backward(frame)


def _deconvolved(device: Device) -> Pairs:
    """V <- V H'(w I/(w H V + b)) / H'w, from points ahead (Biggs and Andrews 1997)."""
    projector = _projector(device)
    H = _matrix(projector)
    I, w = (twins.reals(k, *projector.frame_shape, low=0.5).astype(float) for k in (5, 6))  # noqa: E741
    b, (I, w) = 0.2, (I.ravel() * 50, w.ravel())  # noqa: E741
    seen, x = H.T @ w, np.full(H.shape[1], I.sum() / H.shape[1] / w.mean())
    begun = before = x
    last = None
    for k in range(4):
        if k:
            step = x - begun
            a = 0.0 if last is None else np.clip(step @ last / (last @ last), 0, 0.999)
            x, before, last = np.maximum(x + a * (x - before), 0), x, step
            begun = x
        back = H.T @ (w * I / (w * (H @ x) + b))
        x = np.where(seen > LEAST * seen.max(), x * back / seen, 0)
    shape = projector.frame_shape
    found = deconvolve(
        I.reshape(shape), projector, iterations=4, background=b, white=w.reshape(shape),
        accelerate=True,
    )  # fmt: skip
    yield x.reshape(projector.volume_shape), found.volume


def _restrained(device: Device) -> Pairs:
    """B/(1 - a div(g/|g|)), g the gradient of the density."""
    projector = _projector(device)
    volume, back = (twins.reals(k, 1, *projector.volume_shape) for k in (7, 8))
    counts = twins.reals(9, 1, *projector.frame_shape, high=100)
    prior = TotalVariation(projector, counts, 1.0)
    z = projector.images.planes / projector.images.side
    order = np.argsort(z)
    thick = np.full(2, np.diff(z[order])[0])
    e = SMOOTH * counts.sum(dtype=float) / (volume.size * thick.mean())
    rho = volume[0, order].astype(float) / thick[:, None, None]
    g = [np.diff(rho, axis=axis, append=rho.take([-1], axis)) for axis in range(3)]
    g[0] /= thick[0]
    p = [one / np.sqrt(sum(np.square(g)) + e**2) for one in g]
    dz, dy, dx = (np.diff(one, axis=axis, prepend=0) for axis, one in enumerate(p))
    expected = back[0].astype(float)
    expected[order] /= 1 - prior.weights[0] * (dz / thick[:, None, None] + dy + dx)
    target = device.upload(back)
    prior.restrain(target, device.upload(volume))
    yield expected, device.download(target)[0]


def _sieved(device: Device) -> Pairs:
    """Each plane smoothed by its own Gaussian, of so many voxels, reflected at the edges."""
    projector = _projector(device)
    volume = twins.reals(10, 1, *projector.volume_shape)
    sigma = 3.0 * EVEN * V * np.maximum(1 - blurs(projector.images), 0)
    expected = np.zeros(volume.shape)
    for z, width in enumerate(sigma):
        radius = int(min(np.ceil(4 * width), *projector.volume_shape[1:]))
        taps = np.exp(-0.5 * (np.arange(radius + 1) / width) ** 2)
        taps /= 2 * taps.sum() - 1
        plane = twins.reflected(volume[0, z].astype(float), taps, 0)
        expected[0, z] = twins.reflected(plane, taps, 1)
    yield expected, device.download(Sieve(projector, 3.0).volumes(device.upload(volume)))


VOLUME_CHECKS = (
    Check("projector", "volumes to frames of a microscope and back", _projected, 1e-5,
          ("projector.cl", "lattice.cl", "lattice_spectra.cl")),
    Check("richardson_lucy", "4 iterations of a deconvolution, accelerated", _deconvolved, 1e-4,
          ("richardson_lucy.cl",)),
    Check("total_variation", "what little variation asks of a step", _restrained, 2e-5,
          ("total_variation.cl",)),
    Check("sieve", "planes smoothed by windows of their own", _sieved, 1e-6, ("sieve.cl",)),
)  # fmt: skip
