"""Volumes of a series of frames, several at a time.

An iteration of one frame reads every number of the projector's matrices twice, for eight
multiplications and additions each: memory sets the pace. Frames that are found together read them
once for all, so that from about eight frames on arithmetic and transforms do.
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

BATCH = 8  # frames: beyond that a frame takes no less time
_OPTIONS = ("iterations", "residual", "variance", "accelerate", "prior", "strength", "watch")


@dataclass(frozen=True, eq=False)
class SeriesFrame:
    """Counts of a frame of a series, with what of them is not light of the volume."""

    counts: Vector
    background: Any = 0.0  # b of `deconvolve`
    white: Vector | None = None  # sensitivity of its pixels


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
    """Find the volumes of a series of frames, a batch at a time.

    Parameters
    ----------
    frames : iterable of array_like
        Counts of each frame, shape (rows n, columns n), or an array (frames, rows n, columns n);
        no more than a batch (and the window of ``rolling``) is held.
    projector : Projector or FourierProjector
        With the point images of the microscope that took them.
    batch : int, optional
        Frames that are found together. Default: eight, or as many as the device has memory for.
    start : {"previous", "decayed", "limited"}, optional
        What the frames of a batch begin with, made of the volume of the last frame before it:
        itself, with a share of its contrast, or as wide as things can have moved. Default: an even
        volume.
        "previous" draws out what moves, see `clplen.microscopy.series.starts`.
    decay : float
        Share of the contrast that "decayed" keeps, from 0 to 1.
    motion : float, optional
        How far things move from a frame to the next one in "limited", in metres (standard deviation
        along an axis); default half a voxel.
    before : array_like, optional
        Volume of the frame before the first one. With a start other than None the first batch
        begins with it; the prior "time" compares the first frame with it. Without it a first frame
        that is found alone has no prior.
    background : float or array_like
        As of `deconvolve`, the same for all frames.
    rolling : int, optional
        N: the minimum of each pixel over the frames from N//2 before to (N - 1)//2 after is
        background, besides ``background``. Light of what never changes is then left out, too.
    white : array_like, optional
        As of `deconvolve`.
    progress : callable, optional
        Called as ``progress(done, total)`` after each iteration of a batch.
    **options
        Others of `deconvolve`: ``iterations``, ``residual``, ``variance``, ``accelerate``,
        ``prior``, ``strength`` and ``watch``. With ``residual`` a batch goes on until every frame
        of it is below.

    Returns
    -------
    iterator of DeconvolutionResult
        Of each frame, in order.

    Raises
    ------
    ShapeError, ValueError, TypeError, DeviceError
        As `deconvolve`; and if batch, window, decay or motion is out of range.

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
    >>> found = clplen.microscopy.deconvolve_series(
    ...     projector.forward(volumes), projector, batch=2, iterations=8)
    >>> [int(one.volume.argmax() % 15) for one in found]
    [6, 7, 8]
    """
    require(VolumeProjector, projector, "projector", "Projector(images, shape, device=device)")
    how = Start(start, projector.images, decay=decay, motion=motion)
    check_keywords(options, (*keywords_of(deconvolve_series), *_OPTIONS), "deconvolve_series")
    together = batch_for(projector, batch, **options)
    series: Iterable[SeriesFrame]
    if before is not None and start is None and options.get("prior") != "time":
        raise ValueError("before is for a start or for prior='time': give one of them.")
    if rolling is None:
        series = (SeriesFrame(host_array(one, "A frame"), background, white) for one in frames)
    else:
        pairs = rolling_minimum((host_array(one, "A frame") for one in frames), rolling)
        series = (SeriesFrame(one, np.add(low, background), white) for one, low in pairs)
    return found_in_batches(
        series, projector, together, how, before=before, progress=progress, **options
    )


def batch_for(projector: VolumeProjector, batch: int | None = None, **options: Any) -> int:
    """Frames that are found together: as asked, or at most eight for which there is memory."""
    if batch is not None:
        return positive_integer(batch, "batch")
    volumes = deconvolution.volumes_held(options.get("accelerate", False), options.get("prior"))
    for frames in range(BATCH, 1, -1):
        try:
            projector.require_memory(frames, volumes=volumes, pictures=deconvolution.PICTURES)
        except DeviceError:
            continue
        return frames
    projector.require_memory(1, volumes=volumes, pictures=deconvolution.PICTURES)
    return 1


def found_in_batches(
    frames: Iterable[SeriesFrame],
    projector: VolumeProjector,
    batch: int,
    start: Start,
    *,
    before: Any = None,
    **options: Any,
) -> Iterator[DeconvolutionResult]:
    """`deconvolve_series` of frames that have a background and a sensitivity each.

    Frames of a batch in which other pixels are left out are found apart: pixels are weighted alike
    in frames that are found together. All of them begin with the volume before the batch.
    """
    series = iter(frames)
    last = None if before is None else real_array(before, "before")
    while some := list(islice(series, batch)):
        begun = None if last is None else start.volumes(last, len(some))
        first = 0
        for alike in _alike(some):
            part = begun
            if begun is not None and len(begun) > 1:
                part = begun[first : first + len(alike)]
            for one in _found(alike, projector, part, _in_time(options, last, len(alike))):
                last = one.volume
                yield one
            first += len(alike)


def _in_time(options: dict[str, Any], last: Vector | None, frames: int) -> dict[str, Any]:
    """Options with the volume before, where the prior compares frames."""
    if options.get("prior") != "time":
        return options
    if last is None and frames == 1:  # the first frame, alone: there is nothing to compare
        return options | {"prior": None}
    return options | {"before": last}


def _found(
    frames: list[SeriesFrame],
    projector: VolumeProjector,
    start: Vector | None,
    options: dict[str, Any],
) -> Iterator[DeconvolutionResult]:
    shape = frames[0].counts.shape
    dim = np.stack([np.broadcast_to(np.asarray(one.background), shape) for one in frames])
    counts = np.stack([one.counts for one in frames])
    found = deconvolve(
        counts, projector, background=dim, white=frames[0].white, start=start, **options
    )
    for volume, residuals in zip(found.volume, found.residuals, strict=True):
        yield replace(found, volume=volume, residuals=residuals)


def _alike(frames: list[SeriesFrame]) -> Iterator[list[SeriesFrame]]:
    """Neighbouring frames of the same shape and sensitivity."""
    group = [frames[0]]
    for one in frames[1:]:
        if not _same(one, group[-1]):
            yield group
            group = []
        group.append(one)
    yield group


def _same(one: SeriesFrame, other: SeriesFrame) -> bool:
    if one.counts.shape != other.counts.shape:
        return False
    if one.white is None or other.white is None:
        return one.white is other.white
    return one.white is other.white or np.array_equal(one.white, other.white)


def rolling_minimum(frames: Iterable[Any], window: int) -> Iterator[tuple[Vector, Vector]]:
    """Yield each frame of a series with the minimum of its pixels over ``window`` frames about it.

    What is always there, haze and a slowly changing autofluorescence, stays in the minimum; what is
    brighter at times stands above it. The minimum of N counts with the noise s lies below their
    mean by about s sqrt(2 ln N), so that the background is estimated too low rather than too high.
    """
    window = positive_integer(window, "window")
    ahead = (window - 1) // 2
    series, held, before = iter(frames), deque[Vector](), 0  # frames held before the next one
    while True:
        missing = before + 1 + ahead - len(held)
        held.extend(host_array(frame, "A frame") for frame in islice(series, missing))
        if before == len(held):
            return
        yield held[before], np.minimum.reduce(held)
        before += 1
        if before > window // 2:
            held.popleft()
            before -= 1
