"""A volume to the frame of a light-field microscope and back, beside convolutions of whole frames.

The plain form of the same sum is written here with ducc0 (or SciPy): one transfer function for each
plane and place of a voxel in a lenslet, as large as the frame; the voxels of each place, zeros
between them, are transformed, multiplied and added. It is timed on two planes and counted for all:
each takes as long as the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.util import find_spec
from time import perf_counter

import numpy as np

from clplen.bench.measure import Case, finished, in_turn, numbers
from clplen.bench.report import Benchmark, Report, time_rows
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.compute.device import Device
from clplen.compute.fft.lines import smooth_length
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.model.psf import point_images
from clplen.microscopy.reconstruction.deconvolution import PICTURES, VOLUMES, deconvolve
from clplen.microscopy.reconstruction.projector import Projector
from clplen.microscopy.series.series import BATCH, deconvolve_series
from clplen.types import Array
from clplen.wave.elements.lenslets import MicrolensArray

FORM = "PLANESxLENSLETS"
PIXELS, VOXELS = 15, 5  # of a lenslet, along an axis
PLAIN = 2  # planes that the plain form is timed on
ITERATIONS = 8  # of a frame of a series
_DEPTH = 10e-6  # outermost planes, from the native one
_SPREAD = 20  # lenslets that the widest image reaches to, at most


def _needs(size: str) -> int:
    """Return the bytes of all matrices and of the plain form's transfer functions."""
    planes, count = numbers(size, (2,), FORM)
    plain = 5 * PLAIN * VOXELS**2 * (_window(count) * PIXELS) ** 2
    return matrices_of(planes, count) + plain


def _window(count: int) -> int:
    """Return the lattice points of a transform of so many lenslets."""
    return smooth_length(max(count + _SPREAD, 2 * _SPREAD + 1))


def matrices_of(planes: int, count: int) -> int:
    """Return the largest bytes of the matrices of so many planes and lenslets."""
    return 5 * planes * (_window(count) // 2 + 2) ** 2 * (PIXELS * VOXELS) ** 2


def measure_microscope(device: Device, size: str, repeats: int) -> Report:
    """Measure a projection and a back-projection beside the plain form."""
    planes, count = numbers(size, (2,), FORM)
    start = perf_counter()
    images = images_of(device, planes)
    made = perf_counter() - start
    projector = Projector(images, (count, count), device=device)
    rng = np.random.default_rng(1)
    volume = rng.random((1, *projector.volume_shape), dtype=np.float32)
    frame = rng.random((1, *projector.frame_shape), dtype=np.float32)
    there, seen = device.upload(volume), device.upload(frame)
    plain = Plain(images, min(PLAIN, planes), count)
    share = planes / plain.planes
    both = float(2 * math.prod(projector.volume_shape))

    def ours() -> None:
        projector.project(there)
        projector.back_project(seen)

    def theirs() -> None:
        plain.forward(volume[0])
        plain.backward(frame[0])

    cases = [
        Case(f"plain, {plain.planes} of {planes} planes", theirs, both / share, "voxels"),
        Case("forward and backward", finished(ours, device), both, "voxels"),
        Case("forward", finished(lambda: projector.project(there), device), both / 2, "voxels"),
    ]
    times = in_turn(cases, repeats)
    notes = (
        f"The plain form takes {share * times[0].median:.3g} s for all {planes} planes, "
        f"{share / times[1].over(times[0]):.3g} times forward and backward.",
        f"Matrices of {projector.nbytes / 2**30:.2f} GiB, point images of "
        f"{sum(one.nbytes for one in images.stored) / 2**20:.0f} MiB, made in {made:.3g} s.",
    )
    rows = time_rows(times, times[0])
    return Report("microscope", size, "time over the plain form's part", rows, notes)


def images_of(device: Device, planes: int) -> PointImages:
    """Simulate a 60x/1.2 water objective, lenslets of 100 um and 2.5 mm, planes within 10 um."""
    camera = PlenopticCamera.microscope(
        magnification=60,
        na=1.2,
        medium_index=1.33,
        wavelength=593e-9,
        mla=MicrolensArray(100e-6, 2.5e-3, count=5, fill="full"),
        pixels_per_lenslet=PIXELS,
        device=device,
    )
    return point_images(camera, np.linspace(-_DEPTH, _DEPTH, planes), voxels_per_lenslet=VOXELS)


class Plain:
    """The projector's sum with transforms of whole frames."""

    def __init__(self, images: PointImages, planes: int, count: int) -> None:
        self.planes, self.count = planes, count
        farthest = max(images.radii)
        self.window = smooth_length(max(count + farthest, 2 * farthest + 1) * PIXELS)
        self.rfft, self.irfft = _transforms()
        self.otf = [
            self.rfft(self._wrapped(images.image(z, divmod(s, VOXELS)), images.radii[z]))
            for z in range(planes)
            for s in range(VOXELS**2)
        ]

    def _wrapped(self, image: Array, r: int) -> Array:
        out = np.zeros((self.window, self.window), np.float32)
        out[: len(image), : len(image)] = image
        return np.roll(out, (-r * PIXELS, -r * PIXELS), axis=(0, 1))

    def forward(self, volume: Array) -> Array:
        """Return the frame of the first planes of a volume."""
        total = np.zeros_like(self.otf[0])
        for number, otf in enumerate(self.otf):
            z, (y, x) = number // VOXELS**2, divmod(number % VOXELS**2, VOXELS)
            points = np.zeros((self.window, self.window), np.float32)
            reach = self.count * PIXELS
            points[:reach:PIXELS, :reach:PIXELS] = volume[z, y::VOXELS, x::VOXELS]
            total += otf * self.rfft(points)
        frame = self.irfft(total, self.window)
        return np.maximum(frame[: self.count * PIXELS, : self.count * PIXELS], 0)

    def backward(self, frame: Array) -> Array:
        """Apply the adjoint."""
        padded = np.zeros((self.window, self.window), np.float32)
        reach = self.count * PIXELS
        padded[:reach, :reach] = frame
        spectrum = self.rfft(padded)
        out = np.empty((self.planes, self.count * VOXELS, self.count * VOXELS), np.float32)
        for number, otf in enumerate(self.otf):
            z, (y, x) = number // VOXELS**2, divmod(number % VOXELS**2, VOXELS)
            found = self.irfft(otf.conj() * spectrum, self.window)
            out[z, y::VOXELS, x::VOXELS] = found[:reach:PIXELS, :reach:PIXELS]
        return out


def _transforms() -> tuple[Callable[[Array], Array], Callable[[Array, int], Array]]:
    """Return real transforms of float32 with all cores, forward and inverse."""
    if find_spec("ducc0") is not None:
        from ducc0.fft import c2r, r2c

        return (
            lambda a: np.asarray(r2c(a, nthreads=0)),
            lambda a, n: np.asarray(c2r(a, lastsize=n, inorm=2, forward=False, nthreads=0)),
        )
    import scipy.fft

    return (
        lambda a: np.asarray(scipy.fft.rfft2(a, workers=-1)),
        lambda a, n: np.asarray(scipy.fft.irfft2(a, s=(n, n), workers=-1)),
    )


def _series_needs(size: str) -> int:
    """Return the bytes of the matrices and of the frames of a batch."""
    planes, count = numbers(size, (2,), FORM)
    lenslets = count**2
    frame = 4 * lenslets * (VOLUMES * 25 * planes + (PICTURES + 4) * 225)
    return matrices_of(planes, count) + 3 * BATCH * frame


def measure_series(device: Device, size: str, repeats: int) -> Report:
    """Measure a batch and a frame, each of eight iterations from the volume before."""
    planes, count = numbers(size, (2,), FORM)
    projector = Projector(images_of(device, planes), (count, count), device=device)
    rng = np.random.default_rng(1)
    volume = rng.random(projector.volume_shape, dtype=np.float32) ** 8
    frame = projector.forward(volume)
    frames = np.stack([frame * np.float32(1 + 0.01 * t) for t in range(BATCH)])
    def one() -> None:
        deconvolve(frame, projector, iterations=ITERATIONS, start=volume + 1e-3)

    def together() -> None:
        found = deconvolve_series(
            frames, projector, iterations=ITERATIONS, batch=BATCH, start="previous", before=volume
        )
        list(found)

    voxels = float(math.prod(projector.volume_shape))
    cases = [
        Case("a frame at a time", one, voxels, "voxels"),
        Case(f"{BATCH} frames together", together, BATCH * voxels, "voxels"),
    ]
    times = in_turn(cases, repeats)
    notes = (
        f"{BATCH / times[1].median:.3g} frames a second together, {1 / times[0].median:.3g} one at "
        f"a time, {ITERATIONS} iterations each; {BATCH} frames read what one does.",
        f"Matrices of {projector.nbytes / 2**30:.2f} GiB, read twice an iteration.",
    )
    rows = time_rows(times, times[0])
    return Report("series", size, "time over that of one frame", rows, notes)


BENCHMARKS = (
    Benchmark(
        "microscope",
        "a volume to a microscope's frame and back, beside convolutions of whole frames",
        sizes=("51x67",),
        quick="2x9",
        needs=_needs,
        run=measure_microscope,
    ),
    Benchmark(
        "series",
        "frames of a microscope together, beside one at a time",
        sizes=("51x67",),
        quick="2x9",
        needs=_series_needs,
        run=measure_series,
    ),
)
