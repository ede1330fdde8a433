"""Priors of the deconvolution.

"tv"        small total variation: steps are divided by 1 - a div(grad V/|grad V|), with a from
            the noise of the counts (Dey et al. 2006)
"gaussian"  no detail finer than a lenslet near the native plane, where lenslets resolve none:
            V = G U with Gaussian windows G, solved for U (method of sieves, Snyder and Miller
            1985; depth-dependent windows: Stefanoiu et al. 2019)
"time"      few changes between frames: small total variation of every voxel along time (Rudin,
            Osher and Fatemi 1992), with the steps of "tv"
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import is_finite
from clplen.microscopy.model.point_image_files import AnyImages
from clplen.microscopy.reconstruction.projector import Projector
from clplen.microscopy.reconstruction.volume_projector import VolumeProjector

Vector = np.ndarray[Any, Any]

NAMES = ("tv", "gaussian", "time")
UNIFORM_SIGMA = 1 / np.sqrt(12)  # standard deviation of a uniform distribution of width 1
MIN_GRADIENT = 1e-3  # over the mean voxel; smoothes the total variation below it
WINDOW_SIGMAS = 4.0  # half width of a window; less than 1e-4 of a Gaussian lies beyond it
MAX_TIME_WEIGHT = 0.125  # abs(p[t] - p[t - 1]) <= 2: steps change by a third at most


class Prior:
    """Flat prior, base class of all priors."""

    def volumes(self, unknowns: cla.Array) -> cla.Array:
        """Return the volumes of the unknowns."""
        return unknowns

    def gathered(self, back: cla.Array) -> cla.Array:
        """Apply the adjoint of `volumes`."""
        return back

    def restrain(self, back: cla.Array, unknowns: cla.Array) -> None:
        """Modify the factors of the next step in place."""


class TotalVariation(Prior):
    """Prior for a small total variation of volumes, isotropic in metres.

    Attributes
    ----------
    weights : numpy.ndarray
        Weights a, float64, shape (frames,), limited so that no step is more than doubled.
    """

    def __init__(self, projector: VolumeProjector, counts: Vector, strength: float) -> None:
        self.device = device = projector.device
        z = projector.images.planes / projector.images.side
        order = np.argsort(z)
        thickness, gap = np.ones((2, len(z)))
        above, below = np.tile(np.arange(len(z), dtype=np.int32), (2, 1))
        if len(z) > 1:
            thickness[order] = np.gradient(z[order])
            gap[order[:-1]] = np.diff(z[order])
            above[order[:-1]], below[order[1:]] = order[1:], order[:-1]
        max_weight = 0.5 / (4 + 2 / thickness.min())  # abs(div p) <= 4 + 2/t
        self.weights = np.minimum(strength * noise_level(counts, projector.images), max_weight)
        voxels = np.prod(projector.volume_shape) * thickness.mean()
        small = MIN_GRADIENT * counts.sum(axis=(1, 2), dtype=np.float64) / voxels
        values = (self.weights, small, thickness, gap)
        tables = [device.upload(np.ascontiguousarray(table, np.float32)) for table in values]
        self._a, self._e, self._t, self._gap = tables
        self._above, self._below = device.upload(above), device.upload(below)

    def restrain(self, back: cla.Array, unknowns: cla.Array) -> None:
        """Divide the back-projection by 1 - a div p, with p from the volumes."""
        frames, planes, ny, nx = (int(n) for n in back.shape)
        steepness = self.device.empty(back.shape, np.float32)
        planes_table = (self._t, self._gap, self._above)
        for name, args in (
            ("steepness", (steepness, unknowns, self._e, *planes_table)),
            ("restrain", (back, unknowns, steepness, self._a, *planes_table, self._below)),
        ):
            kernel = self.device.kernel("total_variation.cl", name)
            sizes = (np.int32(n) for n in (planes, ny, nx))
            self.device.launch_rows(kernel, (frames * planes, ny, nx), *args, *sizes)


class TimeVariation(Prior):
    """Prior for voxels of a series that change rarely.

    Attributes
    ----------
    weights : numpy.ndarray
        Weights a, float64, shape (frames,), at most `MAX_TIME_WEIGHT`; larger weights oscillate.
    """

    def __init__(
        self,
        projector: VolumeProjector,
        counts: Vector,
        strength: float,
        before: Vector | None = None,
    ) -> None:
        self.device = device = projector.device
        self.weights = np.minimum(strength * noise_level(counts, projector.images), MAX_TIME_WEIGHT)
        voxels = np.prod(projector.volume_shape)
        small = MIN_GRADIENT * counts.sum(axis=(1, 2), dtype=np.float64) / voxels
        self._a, self._e = (device.upload(t.astype(np.float32)) for t in (self.weights, small))
        self._begun = before is not None
        start = np.zeros(1, np.float32) if before is None else before
        self._before = device.upload(np.ascontiguousarray(start, np.float32))

    def restrain(self, back: cla.Array, unknowns: cla.Array) -> None:
        """Divide the back-projection by 1 - a (p[t] - p[t - 1]), with p from the volumes."""
        frames, planes, ny, nx = (int(n) for n in back.shape)
        kernel = self.device.kernel("time_variation.cl", "restrain_time")
        sizes = (np.int32(n) for n in (self._begun, frames, planes, ny, nx))
        tables = (self._before, self._a, self._e)
        self.device.launch_rows(kernel, (planes, ny, nx), back, unknowns, *tables, *sizes)


class Sieve(Prior):
    """Prior for volumes without detail finer than a lenslet near the native plane.

    The standard deviation of the windows on the native plane is d/(M sqrt 12), that of light
    distributed evenly over a lenslet. It falls linearly to 0 at the depth where the blur of a point
    covers the whole next lenslet. (An abrupt end drives light into the first planes without
    windows.)
    """

    def __init__(self, projector: Projector, strength: float) -> None:
        self.device, images = projector.device, projector.images
        sigma = strength * UNIFORM_SIGMA * images.voxels * np.maximum(1 - images.blurs, 0)
        radii = np.minimum(np.ceil(WINDOW_SIGMAS * sigma), min(projector.volume_shape[1:]))
        self.margin = int(radii.max())
        t = np.arange(self.margin + 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            taps = np.where(t == 0, 1, np.exp(-0.5 * (t / sigma[:, None]) ** 2))
        taps *= t <= radii[:, None]
        taps /= 2 * taps.sum(axis=1, keepdims=True) - 1
        upload = self.device.upload
        self._tables = (upload(taps.astype(np.float32)), upload(radii.astype(np.int32)))

    def volumes(self, unknowns: cla.Array) -> cla.Array:
        """Return G U."""
        frames, planes, ny, nx = (int(n) for n in unknowns.shape)
        padded = self.device.empty((frames, planes, ny, nx + 2 * self.margin), np.float32)
        out = self.device.empty(unknowns.shape, np.float32)
        sizes = [np.int32(n) for n in (self.margin, planes, ny, nx)]
        for name, target, source in (("down", padded, unknowns), ("across", out, padded)):
            kernel = self.device.kernel("sieve.cl", name)
            shape = (frames * planes, ny, nx)
            self.device.launch_rows(kernel, shape, target, source, *self._tables, *sizes)
        return out

    def gathered(self, back: cla.Array) -> cla.Array:
        """Apply the adjoint of `volumes`: G is self-adjoint."""
        return self.volumes(back)


def prior_of(
    name: str | None,
    strength: float,
    projector: VolumeProjector,
    counts: Vector,
    before: Vector | None = None,
) -> Prior:
    """Return the named prior for frames; ``before`` is the volume of the previous frame."""
    if name not in (None, *NAMES):
        raise ValueError(f"prior must be {', '.join(map(repr, NAMES))} or None, got {name!r}.")
    if not (is_finite(strength) and strength > 0):
        raise ValueError(f"strength must be positive and finite, got {strength!r}.")
    if name == "tv":
        return TotalVariation(projector, counts, strength)
    if name == "time":
        if len(counts) == 1 and before is None:
            raise ValueError(
                "prior='time' compares the frames of a series, got a single frame: give several "
                "frames, or before=, the volume of the previous frame."
            )
        return TimeVariation(projector, counts, strength, before)
    if name is None:
        return Prior()
    if not isinstance(projector, Projector):
        raise ValueError(
            "prior='gaussian' needs a native plane, which a Fourier microscope does not have: give "
            "'tv' or None."
        )
    return Sieve(projector, strength)


def noise_level(counts: Vector, images: AnyImages) -> Vector:
    """Estimate the relative noise of a voxel's factor H'(I/HV), if counts are photons.

    For the true volume, H'(I/HV) has the variance sum h^2/HV over the image h of a voxel. For
    uniform brightness this is 1/(P m), with the counts m = sum I (I - 1)/sum I of a lit pixel and
    the pixels P = (sum h)^2/sum h^2 of an image. For a shell, with brighter and dimmer pixels, the
    estimate is 0.7 of the true noise.
    """
    middle = (images.voxels // 2,) * 2
    central = (images.image(z, middle).astype(np.float64) for z in range(len(images.planes)))
    share = np.mean([np.square(h).sum() / h.sum() ** 2 for h in central])
    total = counts.sum(axis=(1, 2), dtype=np.float64)
    lit = np.square(counts, dtype=np.float64).sum(axis=(1, 2)) / total - 1
    return np.asarray(np.sqrt(share / np.maximum(lit, total / counts[0].size)))
