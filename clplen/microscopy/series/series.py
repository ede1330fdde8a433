"""Deconvolution of a series of frames, several frames at a time.

An iteration of a single frame reads every number of the projector's matrices twice, for eight
multiplications and additions each: it is limited by memory bandwidth. A batch reads the matrices
once for all its frames; from about eight frames on, arithmetic and transforms are the limit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from clplen.checks import (
    check_keywords,
    host_array,
    keywords_of,
    positive_integer,
    real_array,
    require,
)
from clplen.errors import DeviceError
from clplen.microscopy.reconstruction import deconvolution
from clplen.microscopy.reconstruction.deconvolution import DeconvolutionResult, deconvolve
from clplen.microscopy.reconstruction.volume_projector import VolumeProjector
from clplen.microscopy.series.starts import Start, StartName
from clplen.wave.coherence.averaging import Progress

Vector = np.ndarray[Any, Any]

BATCH = 8  # frames; larger batches take no less time per frame (`clplen bench`)
_OPTIONS = ("iterations", "residual", "variance", "accelerate", "prior", "strength", "watch")


@dataclass(frozen=True, eq=False)
class SeriesFrame:
    """Counts of a frame of a series, with their background and sensitivity."""

    counts: Vector
    background: Any = 0.0  # b in `deconvolve`
    white: Vector | None = None  # pixel sensitivity


def deconvolve_series(
    frames: Iterable[Any],
    projector: VolumeProjector,
    *,
    batch: int | None = None,
    start: StartName | None = None,
    decay: float = 0.5,
    motion: float | None = None,
    before: Any = None,
    background: Any = 0.0,
    rolling: int | None = None,
    white: Any = None,
    progress: Progress | None = None,
    **options: Any,
) -> Iterator[DeconvolutionResult]:
    """Deconvolve a series of frames, a batch at a time.

    Parameters
    ----------
    frames : iterable of array_like
        Counts of each frame, shape (rows n, columns n), or an array (frames, rows n, columns n).
        At most a batch and the window of ``rolling`` are in memory.
    projector : Projector or FourierProjector
        Projector with the point images of the microscope.
    batch : int, optional
        Number of frames deconvolved together. Default: eight, or fewer if memory is scarce.
    start : {"previous", "decayed", "limited"}, optional
        Initial volume of the frames of a batch, derived from the last volume of the previous batch:
        unchanged, with reduced contrast, or smoothed by the motion. Default: a uniform volume.
        With "previous", moving objects leave a trail; see `clplen.microscopy.series.starts`.
    decay : float
        Share of the contrast that "decayed" keeps, from 0 to 1.
    motion : float, optional
        Motion between successive frames for "limited", in metres (standard deviation along an
        axis); default half a voxel.
    before : array_like, optional
        Volume of the frame before the first frame: the initial volume of the first batch if
        ``start`` is given, and the reference of the prior "time" for the first frame. Without it,
        a first frame in a batch of its own has no prior.
    background : float or array_like
        Background counts as in `deconvolve`, common to all frames.
    rolling : int, optional
        Number N of frames, from N//2 before to (N - 1)//2 after a frame. The minimum of each pixel
        over them is added to ``background``, so that static light is subtracted, too.
    white : array_like, optional
        Pixel sensitivity as in `deconvolve`.
    progress : callable, optional
        Callback ``progress(done, total)``, called after each iteration of a batch.
    **options
        Further options of `deconvolve`: ``iterations``, ``residual``, ``variance``,
        ``accelerate``, ``prior``, ``strength`` and ``watch``. With ``residual`` a batch continues
        until all its frames are below.

    Returns
    -------
    iterator of DeconvolutionResult
        Result of each frame, in order.

    Raises
    ------
    ShapeError, ValueError, TypeError, DeviceError
        See `deconvolve`; also if batch, window, decay or motion is out of range.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> projector = clplen.Projector(images, (5, 5))
    >>> volumes = np.zeros((3, *projector.volume_shape))
    >>> for t in range(3):
    ...     volumes[t, 1, 7, 6 + t] = 1000  # a point that moves by a voxel a frame
    >>> results = clplen.microscopy.deconvolve_series(
    ...     projector.forward(volumes), projector, batch=2, iterations=8)
    >>> [int(result.volume.argmax() % 15) for result in results]
    [6, 7, 8]
    """
    require(VolumeProjector, projector, "projector", "Projector(images, shape, device=device)")
    initial = Start(start, projector.images, decay=decay, motion=motion)
    check_keywords(options, (*keywords_of(deconvolve_series), *_OPTIONS), "deconvolve_series")
    batch_size = batch_for(projector, batch, **options)
    series: Iterable[SeriesFrame]
    if before is not None and start is None and options.get("prior") != "time":
        raise ValueError("before requires a start or prior='time': give one of them.")
    if rolling is None:
        series = (SeriesFrame(host_array(frame, "A frame"), background, white) for frame in frames)
    else:
        pairs = rolling_minimum((host_array(frame, "A frame") for frame in frames), rolling)
        series = (SeriesFrame(frame, np.add(low, background), white) for frame, low in pairs)
    return deconvolve_batches(
        series, projector, batch_size, initial, before=before, progress=progress, **options
    )


def batch_for(projector: VolumeProjector, batch: int | None = None, **options: Any) -> int:
    """Return the number of frames per batch: ``batch``, or at most eight that fit the memory."""
    if batch is not None:
        return positive_integer(batch, "batch")
    volumes = deconvolution.volume_count(options.get("accelerate", False), options.get("prior"))
    for frames in range(BATCH, 1, -1):
        try:
            projector.require_memory(frames, volumes=volumes, pictures=deconvolution.PICTURES)
        except DeviceError:
            continue
        return frames
    projector.require_memory(1, volumes=volumes, pictures=deconvolution.PICTURES)
    return 1


def deconvolve_batches(
    frames: Iterable[SeriesFrame],
    projector: VolumeProjector,
    batch: int,
    start: Start,
    *,
    before: Any = None,
    **options: Any,
) -> Iterator[DeconvolutionResult]:
    """Deconvolve a series whose frames have their own backgrounds and sensitivities.

    Frames of a batch with different excluded pixels are deconvolved separately, because frames
    deconvolved together share their pixel weights. All begin with the volume before the batch.
    """
    series = iter(frames)
    last = None if before is None else real_array(before, "before")
    while frames_of_batch := list(islice(series, batch)):
        initial = None if last is None else start.volumes(last, len(frames_of_batch))
        first = 0
        for group in _groups(frames_of_batch):
            part = initial
            if initial is not None and len(initial) > 1:
                part = initial[first : first + len(group)]
            time_options = _time_options(options, last, len(group))
            for result in _deconvolved(group, projector, part, time_options):
                last = result.volume
                yield result
            first += len(group)


def _time_options(options: dict[str, Any], last: Vector | None, frames: int) -> dict[str, Any]:
    """Add the previous volume to the options if the prior compares frames."""
    if options.get("prior") != "time":
        return options
    if last is None and frames == 1:  # a single first frame has no frame to compare with
        return options | {"prior": None}
    return options | {"before": last}


def _deconvolved(
    frames: list[SeriesFrame],
    projector: VolumeProjector,
    start: Vector | None,
    options: dict[str, Any],
) -> Iterator[DeconvolutionResult]:
    shape = frames[0].counts.shape
    background = np.stack([np.broadcast_to(np.asarray(f.background), shape) for f in frames])
    counts = np.stack([frame.counts for frame in frames])
    results = deconvolve(
        counts, projector, background=background, white=frames[0].white, start=start, **options
    )
    for volume, residuals in zip(results.volume, results.residuals, strict=True):
        yield replace(results, volume=volume, residuals=residuals)


def _groups(frames: list[SeriesFrame]) -> Iterator[list[SeriesFrame]]:
    """Yield runs of successive frames with equal shape and sensitivity."""
    group = [frames[0]]
    for frame in frames[1:]:
        if not _share_pixels(frame, group[-1]):
            yield group
            group = []
        group.append(frame)
    yield group


def _share_pixels(first: SeriesFrame, second: SeriesFrame) -> bool:
    if first.counts.shape != second.counts.shape:
        return False
    if first.white is None or second.white is None:
        return first.white is second.white
    return first.white is second.white or np.array_equal(first.white, second.white)


def rolling_minimum(frames: Iterable[Any], window: int) -> Iterator[tuple[Vector, Vector]]:
    """Yield each frame of a series with the minimum of its pixels over ``window`` frames about it.

    The minimum contains static light, such as haze and slowly changing autofluorescence, but not
    transient light. The minimum of N counts with noise s lies about s sqrt(2 ln N) below their
    mean, so that the background is underestimated rather than overestimated.
    """
    window = positive_integer(window, "window")
    ahead = (window - 1) // 2
    series, queue, before = iter(frames), deque[Vector](), 0  # queued frames before the next frame
    while True:
        missing = before + 1 + ahead - len(queue)
        queue.extend(host_array(frame, "A frame") for frame in islice(series, missing))
        if before == len(queue):
            return
        yield queue[before], np.minimum.reduce(queue)
        before += 1
        if before > window // 2:
            queue.popleft()
            before -= 1
