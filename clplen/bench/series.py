"""A series of a microscope's frames: together, one at a time, and beside reading the matrices.

An iteration of one frame reads the matrices of the projector twice for little arithmetic; frames
that are found together read them once for all.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from clplen.bench.measure import Case, halved, in_turn, numbers
from clplen.bench.microscope import FORM, images_of, matrices_of
from clplen.bench.report import Benchmark, Goal, Report, time_rows
from clplen.compute.device import Device
from clplen.microscopy.reconstruction.deconvolution import PICTURES, VOLUMES, deconvolve
from clplen.microscopy.reconstruction.projector import Projector
from clplen.microscopy.series.series import BATCH, deconvolve_series
from clplen.types import Array

ITERATIONS = 8
GOAL = 3.0
_THREADS = 2  # that read
_PART = 1 << 29  # bytes, more than caches hold
_FLOATS = 1 << 24  # that one reads at a time


def _needs(size: str) -> int:
    """Matrices, and the frames of a batch."""
    planes, count = numbers(size, (2,), FORM)
    lenslets = count**2
    frame = 4 * lenslets * (VOLUMES * 25 * planes + (PICTURES + 4) * 225)
    return matrices_of(planes, count) + 3 * BATCH * frame


def measure_series(device: Device, size: str, repeats: int) -> Report:
    """Times of a batch and of a frame, each of eight iterations from the volume before."""
    planes, count = numbers(size, (2,), FORM)
    projector = Projector(images_of(device, planes), (count, count), device=device)
    rng = np.random.default_rng(1)
    volume = rng.random(projector.volume_shape, dtype=np.float32) ** 8
    frame = projector.forward(volume)
    frames = np.stack([frame * np.float32(1 + 0.01 * t) for t in range(BATCH)])
    part = np.ones(min(projector.nbytes, _PART) // 4, np.float32)
    passes = 2 * ITERATIONS * projector.nbytes // part.nbytes

    def one() -> None:
        deconvolve(frame, projector, iterations=ITERATIONS, start=volume + 1e-3)

    def together() -> None:
        found = deconvolve_series(
            frames, projector, iterations=ITERATIONS, batch=BATCH, start="previous", before=volume
        )
        list(found)

    def read() -> None:
        for _ in range(passes):
            _read(part)

    voxels = float(math.prod(projector.volume_shape))
    cases = [
        Case("a frame at a time", one, voxels, "voxels"),
        Case(f"{BATCH} frames together", together, BATCH * voxels, "voxels"),
        Case("reading of the matrices", read, float(passes * part.nbytes), "bytes"),
    ]
    times = in_turn(cases, repeats)
    ratio = BATCH / times[1].over(times[0])
    notes = (
        f"{BATCH / times[1].median:.3g} frames a second together, {1 / times[0].median:.3g} one at "
        f"a time, {ITERATIONS} iterations each; {BATCH} frames read what one does.",
        f"Matrices of {projector.nbytes / 2**30:.2f} GiB, read twice an iteration.",
    )
    goals = (Goal("one at a time over together, a frame", ratio, GOAL, "at least"),)
    rows = time_rows(times, times[0])
    return Report("series", size, "time over that of one frame", rows, goals, notes)


def _read(values: Array) -> None:
    """Every number once, by two threads."""
    parts = [values[first : first + _FLOATS] for first in range(0, values.size, _FLOATS)]
    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(np.max, parts))


BENCHMARKS = (
    Benchmark(
        "series",
        "frames of a microscope together, beside one at a time",
        sizes=("51x67",),
        quick="2x9",
        needs=_needs,
        run=measure_series,
        smaller=lambda size: halved(size, (0, 1), 2),
    ),
)
