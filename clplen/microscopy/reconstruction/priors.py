"""What may be known of a volume before it is deconvolved.

"tv"        little total variation: steps are divided by 1 - a div(grad V/|grad V|), a from the
            noise of the counts (Dey et al. 2006)
"gaussian"  nothing finer than a lenslet where lenslets see no more: about the native plane the
            volume is V = G U with Gaussian windows G, and U is sought (method of sieves, Snyder
            and Miller 1985; windows that depend on depth: Stefanoiu et al. 2019)
"time"      few changes from frame to frame: little total variation of every voxel along time
            (Rudin, Osher and Fatemi 1992), in steps as those of "tv"
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
EVEN = 1 / np.sqrt(12)  # standard deviation of what is spread evenly over 1
SMOOTH = 1e-3  # of the mean voxel: gradients below count as none
REACH = 4.0  # sigma of a window
MOST_IN_TIME = 0.125  # abs(p[t] - p[t - 1]) <= 2: steps are changed by a third at most


class Prior:
    """No prior: every volume is as good as another."""

    def volumes(self, unknowns: cla.Array) -> cla.Array:
        """The volumes that unknowns stand for."""
        return unknowns

    def gathered(self, back: cla.Array) -> cla.Array:
        """The adjoint of `volumes`."""
        return back

    def restrain(self, back: cla.Array, unknowns: cla.Array) -> None:
        """Change the factors of the next step in place."""


class TotalVariation(Prior):
    """Volumes of little total variation, isotropic in metres.

    Attributes
    ----------
    weights : numpy.ndarray
        float64, shape (frames,): a. At most so large that no step is more than doubled.
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
        most = 0.5 / (4 + 2 / thickness.min())  # abs(div p) <= 4 + 2/t
        self.weights = np.minimum(strength * noise_level(counts, projector.images), most)
        voxels = np.prod(projector.volume_shape) * thickness.mean()
        small = SMOOTH * counts.sum(axis=(1, 2), dtype=np.float64) / voxels
        given = (self.weights, small, thickness, gap)
        tables = [device.upload(np.ascontiguousarray(one, np.float32)) for one in given]
        self._a, self._e, self._t, self._gap = tables
        self._above, self._below = device.upload(above), device.upload(below)

    def restrain(self, back: cla.Array, unknowns: cla.Array) -> None:
        """B/(1 - a div p) with p of the volumes."""
        frames, planes, ny, nx = (int(n) for n in back.shape)
        steepness = self.device.empty(back.shape, np.float32)
        places = (self._t, self._gap, self._above)
        for name, args in (
            ("steepness", (steepness, unknowns, self._e, *places)),
            ("restrain", (back, unknowns, steepness, self._a, *places, self._below)),
        ):
            kernel = self.device.kernel("total_variation.cl", name)
            sizes = (np.int32(n) for n in (planes, ny, nx))
            self.device.launch_rows(kernel, (frames * planes, ny, nx), *args, *sizes)


class TimeVariation(Prior):
    """Voxels of a series that seldom change.

    Attributes
    ----------
    weights : numpy.ndarray
        float64, shape (frames,): a, at most `MOST_IN_TIME`. Larger ones make volumes alternate.
    """

    def __init__(
        self,
        projector: VolumeProjector,
        counts: Vector,
        strength: float,
        before: Vector | None = None,
    ) -> None:
        self.device = device = projector.device
        self.weights = np.minimum(strength * noise_level(counts, projector.images), MOST_IN_TIME)
        voxels = np.prod(projector.volume_shape)
        small = SMOOTH * counts.sum(axis=(1, 2), dtype=np.float64) / voxels
        self._a, self._e = (device.upload(one.astype(np.float32)) for one in (self.weights, small))
        self._begun = before is not None
        start = np.zeros(1, np.float32) if before is None else before
        self._before = device.upload(np.ascontiguousarray(start, np.float32))

    def restrain(self, back: cla.Array, unknowns: cla.Array) -> None:
        """B/(1 - a (p[t] - p[t - 1])) with p of the volumes."""
        frames, planes, ny, nx = (int(n) for n in back.shape)
        kernel = self.device.kernel("time_variation.cl", "restrain_time")
        sizes = (np.int32(n) for n in (self._begun, frames, planes, ny, nx))
        tables = (self._before, self._a, self._e)
        self.device.launch_rows(kernel, (planes, ny, nx), back, unknowns, *tables, *sizes)


class Sieve(Prior):
    """Volumes without detail within a lenslet near the native plane.

    The windows' standard deviation there is that of light spread evenly over a lenslet, d/(M sqrt
    12); it falls linearly to 0 where the blur of a point reaches the whole next lenslet. (Windows
    that end at once drive light into the first planes without one.)
    """

    def __init__(self, projector: Projector, strength: float) -> None:
        self.device, images = projector.device, projector.images
        sigma = strength * EVEN * images.voxels * np.maximum(1 - images.blurs, 0)
        radii = np.minimum(np.ceil(REACH * sigma), min(projector.volume_shape[1:]))
        self.margin = int(radii.max())
        t = np.arange(self.margin + 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            taps = np.where(t == 0, 1, np.exp(-0.5 * (t / sigma[:, None]) ** 2))
        taps *= t <= radii[:, None]
        taps /= 2 * taps.sum(axis=1, keepdims=True) - 1
        upload = self.device.upload
        self._tables = (upload(taps.astype(np.float32)), upload(radii.astype(np.int32)))

    def volumes(self, unknowns: cla.Array) -> cla.Array:
        """G U."""
        frames, planes, ny, nx = (int(n) for n in unknowns.shape)
        padded = self.device.empty((frames, planes, ny, nx + 2 * self.margin), np.float32)
        out = self.device.empty(unknowns.shape, np.float32)
        sizes = [np.int32(n) for n in (self.margin, planes, ny, nx)]
        for name, to, of in (("down", padded, unknowns), ("across", out, padded)):
            kernel = self.device.kernel("sieve.cl", name)
            shape = (frames * planes, ny, nx)
            self.device.launch_rows(kernel, shape, to, of, *self._tables, *sizes)
        return out

    def gathered(self, back: cla.Array) -> cla.Array:
        """G is its own adjoint."""
        return self.volumes(back)


def prior_of(
    name: str | None,
    strength: float,
    projector: VolumeProjector,
    counts: Vector,
    before: Vector | None = None,
) -> Prior:
    """The prior of that name for frames, and the volume of the frame before them."""
    if name not in (None, *NAMES):
        raise ValueError(f"prior is {', '.join(map(repr, NAMES))} or None, not {name!r}.")
    if not (is_finite(strength) and strength > 0):
        raise ValueError(f"strength is positive and finite, not {strength!r}.")
    if name == "tv":
        return TotalVariation(projector, counts, strength)
    if name == "time":
        if len(counts) == 1 and before is None:
            raise ValueError(
                "prior='time' compares the frames of a series, and this is one frame: give several "
                "of them, or before=, the volume of the frame before it."
            )
        return TimeVariation(projector, counts, strength, before)
    if name is None:
        return Prior()
    if not isinstance(projector, Projector):
        raise ValueError(
            "prior='gaussian' is of lenslets on the native plane, where they see no detail; a "
            "Fourier microscope has no such plane: give 'tv' or None."
        )
    return Sieve(projector, strength)


def noise_level(counts: Vector, images: AnyImages) -> Vector:
    """Relative noise of what a voxel sees of I/HV, if counts are photons.

    Where V is right, H'(I/HV) has the variance sum h^2/HV over the image h of a voxel. For evenly
    bright pixels that is 1/(P m): m = sum I (I - 1)/sum I, the counts of a pixel that sees light,
    and P = (sum h)^2/sum h^2, the pixels of an image. Of a shell, whose frame has brighter and
    dimmer pixels, it is .7 of the true one.
    """
    middle = (images.voxels // 2,) * 2
    of_planes = (images.image(z, middle).astype(np.float64) for z in range(len(images.planes)))
    share = np.mean([np.square(h).sum() / h.sum() ** 2 for h in of_planes])
    total = counts.sum(axis=(1, 2), dtype=np.float64)
    lit = np.square(counts, dtype=np.float64).sum(axis=(1, 2)) / total - 1
    return np.asarray(np.sqrt(share / np.maximum(lit, total / counts[0].size)))
