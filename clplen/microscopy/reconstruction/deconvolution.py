"""Richardson-Lucy deconvolution of the frames of a light-field microscope.

    V <- V H'(w I/(w H V + b)) / H'w

increases the likelihood of Poisson counts I with mean w H V + b in every step (Richardson 1972;
Lucy 1974; Broxton et al. 2013, section 3.3), with background b and pixel sensitivity w.

The native plane is degenerate: within d^2/(2 M^2 lam) of it a lenslet cannot resolve its voxels.
Their light is reconstructed with a blur of d/M and spread over neighbouring planes.
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

MIN_SENSITIVITY = 1e-6  # over the largest H'w; voxels below it stay 0 to avoid divisions by 0
MIN_LENSLETS = 5  # along an axis of a frame, to resolve planes
VOLUMES = 3  # per frame on the device: volume, H'w and back-projection
ACCELERATION_VOLUMES = 4  # more volumes per frame, of `Acceleration`
PRIOR_VOLUMES = 3  # more volumes per frame of a prior: padded, smoothed, steepness
MAX_ACCELERATION = 0.999  # of the factor a, which is below 1
PICTURES = 5  # per frame: counts, white, background, expected and ratio


@dataclass(frozen=True, eq=False, repr=False)
class DeconvolutionResult(Savable, Plottable, HostArray):
    """Result of `deconvolve`.

    Attributes
    ----------
    volume : numpy.ndarray
        Energy of each voxel, float32, shape (..., planes, rows v, columns v).
    residuals : numpy.ndarray
        sum (I - w H V - b)^2 / sum I^2 over the pixels with w > 0, before each iteration, float64,
        shape (..., iterations).
    iterations : int
        Number of iterations.
    degenerate : tuple of float
        z in metres of the planes whose resolution is limited to d/M.
    planes : numpy.ndarray or None
        z of each plane in metres, shape (planes,); None if unknown.
    voxel : tuple of float or None
        Sides (dy, dx) of a voxel in metres; None if unknown.

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
    >>> result = clplen.microscopy.deconvolve(projector.forward(volume), projector, iterations=5)
    >>> result.volume.shape, np.argwhere(result.volume == result.volume.max()).tolist()
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

        A result of `deconvolve` has ``planes`` and ``voxel``; raise ValueError for a result without
        them. Raise `ShapeError` for a series: save each volume by `clplen.io.write_volume`.
        """
        options = {"planes": self.planes, "voxel": self.voxel} | options
        if options["planes"] is None or options["voxel"] is None:
            raise ValueError(
                "This result has no voxel positions: give planes=, z of each plane, and voxel=, "
                "(dy, dx), in metres."
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
    """Estimate the volume behind frames by Richardson-Lucy deconvolution.

    Parameters
    ----------
    frame : array_like or RawImage
        Counts, not negative and finite, shape (..., rows n, columns n). Leading axes are frames of
        a series, deconvolved together.
    projector : Projector or FourierProjector
        Projector with the point images of the microscope. Frames of a Fourier microscope have the
        shape of its sensor and cannot use the prior "gaussian".
    iterations : int
        Maximum number of iterations, each with a projection and a back-projection.
    background : float or array_like
        Background counts b, not negative: a number or an array that broadcasts to the shape of the
        frame.
    white : array_like, optional
        Pixel sensitivity w (a white frame over its mean), not negative, shape (rows n, columns n).
        Pixels with w = 0 are excluded; set saturated pixels to 0.
    start : array_like, optional
        Initial volume, such as the volume of the previous frame; default a uniform volume.
    residual : float or "noise", optional
        Threshold of the residual: stop when all frames are below. "noise" is the residual of
        Poisson counts, sum I/sum I^2, if counts are photons (camera counts over the gain).
    variance : float
        Variance of a count over its mean, for "noise": 1 for photons, `Preparation.variance` for
        rectified frames, because interpolation averages.
    accelerate : bool
        True to extrapolate the volume before each iteration (Biggs and Andrews 1997): fewer
        iterations for equal residual and noise, with memory for four more volumes.
    prior : {"tv", "gaussian", "time"}, optional
        Prior. "tv": small total variation (Dey et al. 2006), against noise. "gaussian": no detail
        finer than a lenslet near the native plane (Snyder and Miller 1985; Stefanoiu et al. 2019).
        "time": small total variation along time, for voxels that change rarely.
    strength : float
        Strength of the prior, positive, in units of the photon noise of a step ("tv", "time"; see
        `clplen.microscopy.reconstruction.priors.noise_level`) or of the lenslet width ("gaussian").
    before : array_like, optional
        Volume of the frame before the first frame, for the prior "time".
    progress : callable, optional
        Callback ``progress(done, total)``, called after each iteration.
    watch : callable, optional
        Callback ``watch(residuals)`` with the residual of each frame, called before ``progress``.

    Returns
    -------
    DeconvolutionResult
        Volume, float32, shape (..., planes, rows v, columns v), and residuals of each iteration.

    Raises
    ------
    ShapeError
        If shapes do not match, or the frame is empty or has fewer than five lenslets along an axis.
    ValueError
        If counts, sensitivities or an initial volume are negative, not finite or 0 everywhere, or a
        number is out of range.
    TypeError
        If an array does not contain real numbers, or the projector is not a projector.
    DeviceError
        If the frames do not fit the device.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> projector = clplen.Projector(images, (5, 5))
    >>> volume = np.zeros(projector.volume_shape)
    >>> volume[1, 7, 7] = 1000  # a point 50 um beyond the native plane
    >>> result = clplen.deconvolve(projector.forward(volume), projector, iterations=5)
    >>> np.argwhere(result.volume == result.volume.max()).tolist()
    [[1, 7, 7]]
    """
    require(VolumeProjector, projector, "projector", "Projector(images, shape, device=device)")
    if isinstance(projector, Projector) and min(projector.lenslets) < MIN_LENSLETS:
        rows, columns = projector.lenslets
        raise ShapeError(
            f"The frame must have at least {MIN_LENSLETS} x {MIN_LENSLETS} lenslets to resolve "
            f"planes, got {rows} x {columns}."
        )
    if not (is_finite(variance) and variance > 0):
        raise ValueError(f"variance must be positive and finite, got {variance!r}.")
    if residual not in (None, "noise") and (
        isinstance(residual, str) or not (is_finite(residual) and residual > 0)
    ):
        raise ValueError(f"residual must be a positive number, 'noise' or None, got {residual!r}.")
    iterations = positive_integer(iterations, "iterations")
    frame = real_array(frame, "A frame")
    lead = frame.shape[:-2]
    volumes = volume_count(accelerate, prior)
    projector.require_memory(math.prod(lead), volumes=volumes, pictures=PICTURES)
    advice = "subtract less of the dark frame, or exclude these pixels by a white level of 0"
    counts = _positive(frame, projector.frame_shape, "A frame", advice)
    counts = counts.reshape(-1, *projector.frame_shape)
    weight = np.ones(projector.frame_shape) if white is None else white
    weight = _positive(weight, projector.frame_shape, "A white frame", "set these pixels to 0")
    if weight.ndim > 2:
        raise ShapeError(
            f"A white frame must have two axes, common to all frames, got shape {weight.shape}."
        )
    if not weight.any():
        raise ValueError("The white frame is 0 everywhere, which excludes all pixels.")
    if not counts[:, weight > 0].any(axis=1).all():
        raise ValueError("A frame is black: it must have counts at pixels that are not excluded.")
    background_counts = _background(background, np.shape(frame)).reshape(counts.shape)
    counts = np.where(weight > 0, counts, background_counts)
    rule = prior_of(prior, strength, projector, counts, _before(before, prior, projector))
    iteration = _Iteration(projector, rule, counts, weight, background_counts, start)
    threshold = variance * iteration.noise if residual == "noise" else residual
    acceleration = Acceleration(iteration.volumes, iteration.device) if accelerate else None
    history: list[Vector] = []
    for done in range(iterations):
        if acceleration is not None and done:
            acceleration.move(iteration.volumes)
        history.append(iteration.step())
        if watch is not None:
            watch(history[-1])
        if progress is not None:
            progress(done + 1, iterations)
        if threshold is not None and (history[-1] < threshold).all():
            break
    volume = projector.device.download(rule.volumes(iteration.volumes))
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
    """Check the volume of the previous frame."""
    if values is None:
        return None
    if prior != "time":
        raise ValueError("before needs prior='time', which compares with it: give that prior.")
    advice = "give a volume of deconvolve"
    volume = _positive(values, projector.volume_shape, "The volume before", advice)
    if volume.ndim != len(projector.volume_shape):
        raise ShapeError(f"before must be a single volume, got shape {volume.shape}.")
    return volume


def volume_count(accelerate: bool, prior: str | None) -> int:
    """Return the number of volumes per frame on the device."""
    return VOLUMES + ACCELERATION_VOLUMES * accelerate + PRIOR_VOLUMES * bool(prior)


class Acceleration:
    """Extrapolation of the volume before each step, with four more volumes on the device.

        y = max(x + a (x - x'), 0),   a = <g, g'>/<g', g'> within 0 to 1,

    with the volume x' of the previous iteration, the last step g = x - y and the step g' before it
    (Biggs and Andrews 1997, "Acceleration of iterative image restoration algorithms"). Voxels that
    reach 0 stay at 0. Keeping a tenth of them instead changes residuals and errors by at most 1 %.
    """

    def __init__(self, volumes: cla.Array, device: Device) -> None:
        self.device = device
        self.begun, self.before = (device.empty(volumes.shape, np.float32) for _ in range(2))
        for target in (self.begun, self.before):
            device.copy_into(target, volumes, 0)
        self.last: cla.Array | None = None

    def move(self, volumes: cla.Array) -> Vector:
        """Extrapolate the volumes of the last step in place; return a of each frame."""
        frames, planes, rows, columns = volumes.shape
        shape, device = (frames, planes * rows, columns), self.device
        step = device.empty(volumes.shape, np.float32)
        sizes = (np.int32(planes * rows), np.int32(columns))
        kernel = device.kernel("richardson_lucy.cl", "moved")
        device.launch_rows(kernel, shape, step, volumes, self.begun, *sizes)
        a = self._factors(step, int(frames))
        kernel = device.kernel("richardson_lucy.cl", "ahead")
        device.launch_rows(
            kernel, shape, volumes, self.begun, self.before, device.upload(a), *sizes
        )
        self.last = step
        return a

    def _factors(self, step: cla.Array, frames: int) -> Vector:
        """Return the factor a of each frame, 0 after the first step."""
        if self.last is None:
            return np.zeros(frames, np.float32)
        on_host = self.device.on_host
        with on_host(step, write=False) as steps, on_host(self.last, write=False) as previous:
            pairs = [(g.ravel(), h.ravel()) for g, h in zip(steps, previous, strict=True)]
            factors = [float(np.vdot(g, h)) / max(float(np.vdot(h, h)), 1e-30) for g, h in pairs]
        return np.clip(factors, 0, MAX_ACCELERATION).astype(np.float32)


class _Iteration:
    """Volumes and all arrays of a Richardson-Lucy step, on the device."""

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
        self.sensitivity = prior.gathered(projector.back_project(device.upload(white[None])))
        self.threshold = MIN_SENSITIVITY * float(device.download(self.sensitivity).max())
        shape = (len(counts), *projector.volume_shape)
        if start is None:
            light = np.maximum(lit.sum(axis=1), 1e-30)
            level = light / np.prod(projector.volume_shape) / max(float(white.mean()), 1e-30)
            initial = np.broadcast_to(level[:, None, None, None], shape).astype(np.float32)
        else:
            initial = _positive(
                start, projector.volume_shape, "A start", "set these voxels to 0 or more"
            )
            initial = initial.reshape(-1, *shape[1:])
            if len(initial) not in (1, len(counts)):
                raise ShapeError(
                    f"start must have 1 volume or {len(counts)}, one per frame, got {len(initial)}."
                )
            if not initial.any(axis=(1, 2, 3)).all():
                raise ValueError("A start is 0 everywhere and would stay 0: leave it out.")
            initial = np.broadcast_to(initial, shape)
        self.volumes = device.upload(np.ascontiguousarray(initial, np.float32))

    def step(self) -> Vector:
        """Perform an iteration; return the residual of each frame before it."""
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
            "update", self.volumes, back, self.sensitivity, np.float32(self.threshold),
            planes * rows, columns,
        )  # fmt: skip
        return np.asarray(residual) / self.norms

    def _launch(self, name: str, out: cla.Array, *rest: Any) -> None:
        *args, ny, nx = rest
        kernel = self.device.kernel("richardson_lucy.cl", name)
        sizes = (np.int32(ny), np.int32(nx))
        self.device.launch_rows(kernel, (int(out.shape[0]), ny, nx), out, *args, *sizes)


def _background(values: Any, shape: tuple[int, ...]) -> Vector:
    """Check the background counts; return them for each pixel of each frame."""
    counts = real_array(values, "background")
    try:
        counts = np.broadcast_to(counts, shape)
    except ValueError:
        raise ShapeError(
            f"background must be a number or broadcast to the frame's shape {shape}, got shape "
            f"{counts.shape}."
        ) from None
    if not (counts >= 0).all() or not np.isfinite(counts).all():
        raise ValueError("background must be finite and not negative everywhere.")
    return np.ascontiguousarray(counts)


def _positive(values: Any, shape: tuple[int, ...], name: str, advice: str) -> Vector:
    """Check the shape and the signs of values; return them as float32."""
    samples = real_array(values, name)
    if samples.shape[-len(shape) :] != shape or not samples.size:
        raise ShapeError(
            f"{name} must have shape (..., {', '.join(map(str, shape))}), got {samples.shape}."
        )
    bad = int(np.count_nonzero(~(samples >= 0) | ~np.isfinite(samples)))
    if bad:
        raise ValueError(f"{name} has {bad} negative or non-finite samples: {advice}.")
    return np.ascontiguousarray(samples)
