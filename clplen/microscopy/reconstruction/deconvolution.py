"""Volumes from frames of a light-field microscope, by Richardson and Lucy's iteration.

    V <- V H'(w I/(w H V + b)) / H'w

raises the likelihood of Poisson counts I with the mean w H V + b in every step (Richardson 1972;
Lucy 1974; Broxton et al. 2013, section 3.3): b a background, w the sensitivity of the pixels.

The native plane is degenerate: within d^2/(2 M^2 lam) of it every lenslet sees its voxels as one,
and what they hold comes out blurred to d/M and spread over neighbouring planes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pyopencl.array as cla

from clplen.checks import is_finite, positive_integer, real_array, require
from clplen.compute.arrays import HostArray
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.microscopy.reconstruction.priors import Prior, prior_of
from clplen.microscopy.reconstruction.projector import Projector
from clplen.microscopy.reconstruction.volume_projector import VolumeProjector
from clplen.progress import notebook_bar
from clplen.results import Plottable, Savable
from clplen.wave.coherence.averaging import Progress

Vector = np.ndarray[Any, Any]

LEAST = 1e-6  # of the largest H'w: voxels that are seen less than that stay 0
FEWEST = 5  # lenslets of a frame along an axis
VOLUMES = 3  # of a frame on the device: found, H'w and back
OF_AHEAD = 4  # more of them
OF_PRIOR = 3  # padded, smoothed; steepness
LARGEST_STEP = 0.999  # of a, which is below 1
PICTURES = 5  # counts, white, background, expected and ratio


@dataclass(frozen=True, eq=False, repr=False)
class DeconvolutionResult(Savable, Plottable, HostArray):
    """What `deconvolve` found.

    Attributes
    ----------
    volume : numpy.ndarray
        float32, shape (..., planes, rows v, columns v): energy of each voxel.
    residuals : numpy.ndarray
        float64, shape (..., iterations): sum (I - w H V - b)^2 / sum I^2 before each iteration,
        over the pixels with w > 0.
    iterations : int
        How many were made.
    degenerate : tuple of float
        z in metres of the planes in which the volume cannot be resolved beyond d/M.
    planes : numpy.ndarray or None
        z of each plane in metres, shape (planes,); None when not known.
    voxel : tuple of float or None
        (dy, dx) in metres; None when not known.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.microscopy.point_images(
    ...     camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> projector = clplen.microscopy.Projector(images, (5, 5))
    >>> volume = np.zeros(projector.volume_shape)
    >>> volume[1, 7, 7] = 1.0  # a point 50 um from the native plane
    >>> found = clplen.microscopy.deconvolve(projector.forward(volume), projector, iterations=5)
    >>> found.volume.shape, np.argwhere(found.volume == found.volume.max()).tolist()
    ((2, 15, 15), [[1, 7, 7]])
    """

    _writer: ClassVar[str] = "write_volume"
    _figure: ClassVar[str] = "volume"
    _samples: ClassVar[str] = "volume"

    volume: Vector
    residuals: Vector
    iterations: int
    degenerate: tuple[float, ...]
    planes: Vector | None = None
    voxel: tuple[float, float] | None = None

    def save(self, path: str | Path, **options: Any) -> None:
        """Write the volume to OME-TIFF or OME-Zarr; see `clplen.io.write_volume` for options.

        ``planes`` and ``voxel`` are known of a result of `deconvolve`. Raise ValueError or
        `ShapeError` where they are not, or for a series: save each volume by
        `clplen.io.write_volume`.
        """
        options = {"planes": self.planes, "voxel": self.voxel} | options
        if options["planes"] is None or options["voxel"] is None:
            raise ValueError(
                "This result does not know where its voxels lie: give planes=, z of each plane, "
                "and voxel=, (dy, dx), in metres."
            )
        super().save(path, **options)

    def __repr__(self) -> str:
        last = np.array2string(np.asarray(self.residuals[..., -1]), precision=3)
        text = f"<DeconvolutionResult {self.volume.shape}, {self.iterations} iterations, residual "
        text += f"{last}"
        if self.degenerate:
            planes = ", ".join(f"{round(z * 1e6, 4) + 0.0:g}" for z in self.degenerate)
            text += f"; degenerate near the native plane: z = {planes} um"
        return text + ">"


@notebook_bar("deconvolving")
def deconvolve(
    frame: Any,
    projector: VolumeProjector,
    *,
    iterations: int = 20,
    background: Any = 0.0,
    white: Any = None,
    start: Any = None,
    residual: float | Literal["noise"] | None = None,
    variance: float = 1.0,
    accelerate: bool = False,
    prior: Literal["tv", "gaussian", "time"] | None = None,
    strength: float = 1.0,
    before: Any = None,
    progress: Progress | None = None,
    watch: Callable[[Vector], None] | None = None,
) -> DeconvolutionResult:
    """Find the volume that explains frames best, by Richardson and Lucy's iteration.

    Parameters
    ----------
    frame : array_like or RawImage
        Counts, not negative and finite, shape (..., rows n, columns n); leading axes are frames
        of a series, which are found together.
    projector : Projector or FourierProjector
        With the point images of the microscope that took them. Of a Fourier microscope frames
        have the shape of its sensor, and there is no prior "gaussian".
    iterations : int
        At most; each takes one projection and one back-projection.
    background : float or array_like
        Counts b that come from nowhere in the volume, not negative: of every pixel, or of each
        one, shape (..., rows n, columns n) that broadcasts to that of the frame.
    white : array_like, optional
        Sensitivity w of the pixels (a white frame over its mean), not negative, shape (rows n,
        columns n); pixels of 0 are left out, as saturated ones should be.
    start : array_like, optional
        Volume to begin with, such as that of the frame before; default an even one.
    residual : float or "noise", optional
        Stop when the residual of every frame is below it. "noise": that of Poisson counts about
        the true means, sum I/sum I^2, if counts are photons (camera counts over the gain).
    variance : float
        Of a count over its mean, for "noise": 1 for photons; `Preparation.variance` for photons
        that were rectified, because interpolation averages.
    accelerate : bool
        Begin each iteration ahead of the volume found (Biggs and Andrews 1997): fewer iterations
        for the same residual and the same noise, but memory for four volumes more.
    prior : {"tv", "gaussian", "time"}, optional
        "tv": little total variation (Dey et al. 2006), against noise. "gaussian": nothing finer
        than a lenslet about the native plane (Snyder and Miller 1985; Stefanoiu et al. 2019).
        "time": voxels that seldom change from frame to frame, little total variation along time.
    strength : float
        Of the prior, positive. "tv" and "time": times the noise of a step if counts are photons,
        `clplen.microscopy.reconstruction.priors.noise_level`. "gaussian": times the width of a
        lenslet.
    before : array_like, optional
        Volume of the frame before the first one, with which "time" compares that.
    progress : callable, optional
        Called as ``progress(done, total)`` after each iteration.
    watch : callable, optional
        Called as ``watch(residuals)``, those of each frame, before ``progress``.

    Returns
    -------
    DeconvolutionResult
        With the volume, float32, shape (..., planes, rows v, columns v), and the residuals of each
        iteration.

    Raises
    ------
    ShapeError
        If shapes do not fit, there is no frame, or it has fewer than five lenslets along an axis.
    ValueError
        If counts, sensitivities or a start are negative, not finite or 0 everywhere, or a number is
        out of range.
    TypeError
        If something is no array of real numbers, or the projector none.
    DeviceError
        If so many frames do not fit the device.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> projector = clplen.Projector(images, (5, 5))
    >>> volume = np.zeros(projector.volume_shape)
    >>> volume[1, 7, 7] = 1000  # a point 50 um beyond the native plane
    >>> found = clplen.deconvolve(projector.forward(volume), projector, iterations=5)
    >>> np.argwhere(found.volume == found.volume.max()).tolist()
    [[1, 7, 7]]
    """
    require(VolumeProjector, projector, "projector", "Projector(images, shape, device=device)")
    if isinstance(projector, Projector) and min(projector.lenslets) < FEWEST:
        rows, columns = projector.lenslets
        raise ShapeError(
            f"The frame has {rows} x {columns} lenslets; at least "
            f"{FEWEST} x {FEWEST} are needed to tell planes apart."
        )
    if not (is_finite(variance) and variance > 0):
        raise ValueError(f"variance is positive and finite, not {variance!r}.")
    if residual not in (None, "noise") and (
        isinstance(residual, str) or not (is_finite(residual) and residual > 0)
    ):
        raise ValueError(f"residual is a positive number, 'noise' or None, not {residual!r}.")
    iterations = positive_integer(iterations, "iterations")
    frame = real_array(frame, "A frame")
    lead = frame.shape[:-2]
    volumes = volumes_held(accelerate, prior)
    projector.require_memory(math.prod(lead), volumes=volumes, pictures=PICTURES)
    advice = "subtract less of the dark frame, or give such pixels a white level of 0 and any count"
    counts = _positive(frame, projector.frame_shape, "A frame", advice)
    counts = counts.reshape(-1, *projector.frame_shape)
    weight = np.ones(projector.frame_shape) if white is None else white
    weight = _positive(weight, projector.frame_shape, "A white frame", "give such pixels 0")
    if weight.ndim > 2:
        raise ShapeError(f"A white frame is one for all frames, not of shape {weight.shape}.")
    if not weight.any():
        raise ValueError("The white frame is 0 everywhere: no pixel is left to find a volume from.")
    if not counts[:, weight > 0].any(axis=1).all():
        raise ValueError("A frame is black: there is nothing to find.")
    dim = _background(background, np.shape(frame)).reshape(counts.shape)
    counts = np.where(weight > 0, counts, dim)
    known = prior_of(prior, strength, projector, counts, _before(before, prior, projector))
    found = _Iteration(projector, known, counts, weight, dim, start)
    least = variance * found.noise if residual == "noise" else residual
    ahead = Acceleration(found.volumes, found.device) if accelerate else None
    history: list[Vector] = []
    for done in range(iterations):
        if ahead is not None and done:
            ahead.move(found.volumes)
        history.append(found.step())
        if watch is not None:
            watch(history[-1])
        if progress is not None:
            progress(done + 1, iterations)
        if least is not None and (history[-1] < least).all():
            break
    volume = projector.device.download(known.volumes(found.volumes))
    volume = volume.reshape(*lead, *projector.volume_shape)
    residuals = np.stack(history, axis=-1).reshape(*lead, len(history))
    images = projector.images
    return DeconvolutionResult(
        volume,
        residuals,
        len(history),
        projector.degenerate,
        images.planes,
        images.sides,
    )


def _before(values: Any, prior: str | None, projector: VolumeProjector) -> Vector | None:
    """The volume of the frame before."""
    if values is None:
        return None
    if prior != "time":
        raise ValueError("before is the volume that prior='time' compares with: give that prior.")
    found = _positive(values, projector.volume_shape, "The volume before", "volumes have none")
    if found.ndim != len(projector.volume_shape):
        raise ShapeError(f"The volume before is one volume, not of shape {found.shape}.")
    return found


def volumes_held(accelerate: bool, prior: str | None) -> int:
    """Volumes of a frame that are on the device."""
    return VOLUMES + OF_AHEAD * accelerate + OF_PRIOR * bool(prior)


class Acceleration:
    """Steps that begin ahead of the volume of the iteration; four more volumes on the device.

        y = max(x + a (x - x'), 0),   a = <g, g'>/<g', g'> within 0 to 1,

    x' the volume of the iteration before, g = x - y the last step and g' the one before it (Biggs
    and Andrews 1997, "Acceleration of iterative image restoration algorithms"). Voxels that come to
    0 stay there, dark ones for the most part: to leave them a tenth changes residuals and errors by
    no more than 1 %.
    """

    def __init__(self, volumes: cla.Array, device: Device) -> None:
        self.device = device
        self.begun, self.before = (device.empty(volumes.shape, np.float32) for _ in range(2))
        for target in (self.begun, self.before):
            device.copy_into(target, volumes, 0)
        self.last: cla.Array | None = None

    def move(self, volumes: cla.Array) -> Vector:
        """Move volumes, as a step left them, ahead in place; a of each frame."""
        frames, planes, rows, columns = volumes.shape
        shape, device = (frames, planes * rows, columns), self.device
        step = device.empty(volumes.shape, np.float32)
        sizes = (np.int32(planes * rows), np.int32(columns))
        kernel = device.kernel("richardson_lucy.cl", "moved")
        device.launch_rows(kernel, shape, step, volumes, self.begun, *sizes)
        a = self._length(step, int(frames))
        kernel = device.kernel("richardson_lucy.cl", "ahead")
        device.launch_rows(
            kernel, shape, volumes, self.begun, self.before, device.upload(a), *sizes
        )
        self.last = step
        return a

    def _length(self, step: cla.Array, frames: int) -> Vector:
        """a of each frame, 0 after the first step."""
        if self.last is None:
            return np.zeros(frames, np.float32)
        on_host = self.device.on_host
        with on_host(step, write=False) as these, on_host(self.last, write=False) as those:
            pairs = [(g.ravel(), h.ravel()) for g, h in zip(these, those, strict=True)]
            found = [float(np.vdot(g, h)) / max(float(np.vdot(h, h)), 1e-30) for g, h in pairs]
        return np.clip(found, 0, LARGEST_STEP).astype(np.float32)


class _Iteration:
    """The volumes with everything that a step needs, on the device."""

    def __init__(
        self,
        projector: VolumeProjector,
        prior: Prior,
        counts: Vector,
        white: Vector,
        background: Vector,
        start: Any,
    ) -> None:
        self.projector, self.prior = projector, prior
        device = self.device = projector.device
        lit = counts[:, white > 0].astype(np.float64)
        self.norms = np.square(lit).sum(axis=1)
        self.noise = lit.sum(axis=1) / self.norms
        self.counts, self.white = device.upload(counts), device.upload(white)
        self.background = device.upload(background)
        self.seen = prior.gathered(projector.back_project(device.upload(white[None])))
        self.least = LEAST * float(device.download(self.seen).max())
        shape = (len(counts), *projector.volume_shape)
        if start is None:
            light = np.maximum(lit.sum(axis=1), 1e-30)
            even = light / np.prod(projector.volume_shape) / max(float(white.mean()), 1e-30)
            begin = np.broadcast_to(even[:, None, None, None], shape).astype(np.float32)
        else:
            begin = _positive(
                start, projector.volume_shape, "A start", "a start is 0 or more and finite"
            )
            begin = begin.reshape(-1, *shape[1:])
            if len(begin) not in (1, len(counts)):
                raise ShapeError(
                    f"A start is of one frame or of all {len(counts)}, not of {len(begin)}."
                )
            if not begin.any(axis=(1, 2, 3)).all():
                raise ValueError("A start is 0 everywhere, and would stay so: leave it out.")
            begin = np.broadcast_to(begin, shape)
        self.volumes = device.upload(np.ascontiguousarray(begin, np.float32))

    def step(self) -> Vector:
        """One iteration; the residual of each frame before it."""
        expected = self.projector.project(self.prior.volumes(self.volumes))
        _, ny, nx = expected.shape
        self._launch("expected", expected, self.white, self.background, ny, nx)
        on_host = self.device.on_host
        with on_host(expected, write=False) as means, on_host(self.counts, write=False) as counts:
            residual = [
                float(np.square(a - b).sum(dtype=np.float64))
                for a, b in zip(means, counts, strict=True)
            ]
        ratio = self.device.empty(expected.shape, np.float32)
        self._launch("ratio", ratio, self.counts, expected, self.white, ny, nx)
        back = self.prior.gathered(self.projector.back_project(ratio))
        self.prior.restrain(back, self.volumes)
        _, planes, rows, columns = back.shape
        self._launch(
            "update", self.volumes, back, self.seen, np.float32(self.least), planes * rows, columns
        )
        return np.asarray(residual) / self.norms

    def _launch(self, name: str, out: cla.Array, *rest: Any) -> None:
        *args, ny, nx = rest
        kernel = self.device.kernel("richardson_lucy.cl", name)
        sizes = (np.int32(ny), np.int32(nx))
        self.device.launch_rows(kernel, (int(out.shape[0]), ny, nx), out, *args, *sizes)


def _background(values: Any, shape: tuple[int, ...]) -> Vector:
    """Counts from nowhere in the volume, of each pixel of each frame."""
    found = real_array(values, "background")
    try:
        found = np.broadcast_to(found, shape)
    except ValueError:
        raise ShapeError(
            f"background is a number or broadcasts to the frame's shape {shape}, not {found.shape}."
        ) from None
    if not (found >= 0).all() or not np.isfinite(found).all():
        raise ValueError("background is not negative and finite: it has samples that are not.")
    return np.ascontiguousarray(found)


def _positive(values: Any, shape: tuple[int, ...], what: str, advice: str) -> Vector:
    """Values as float32 after a look at their shape and signs."""
    found = real_array(values, what)
    if found.shape[-len(shape) :] != shape or not found.size:
        raise ShapeError(
            f"{what} has shape (..., {', '.join(map(str, shape))}), not {found.shape}."
        )
    bad = int(np.count_nonzero(~(found >= 0) | ~np.isfinite(found)))
    if bad:
        raise ValueError(f"{what} has {bad} negative or not finite samples: {advice}.")
    return np.ascontiguousarray(found)
