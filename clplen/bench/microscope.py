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

from clplen.bench.measure import Case, Times, finished, halved, in_turn, numbers
from clplen.bench.report import Benchmark, Goal, Report, time_rows
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.compute.device import Device
from clplen.compute.fft.lines import smooth_length
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.model.psf import point_images
from clplen.microscopy.reconstruction.projector import Projector
from clplen.types import Array
from clplen.wave.elements.lenslets import MicrolensArray

FORM = "PLANESxLENSLETS"
PIXELS, VOXELS = 15, 5  # of a lenslet, along an axis
PLAIN = 2  # planes that the plain form is timed on
GOAL, MINUTES = 3.0, 10.0
_DEPTH = 10e-6  # outermost planes, from the native one
_SPREAD = 20  # lenslets that the widest image reaches to, at most


def _needs(size: str) -> int:
    """Matrices of all planes, and transfer functions of those of the plain form."""
    planes, count = numbers(size, (2,), FORM)
    plain = 5 * PLAIN * VOXELS**2 * (_window(count) * PIXELS) ** 2
    return matrices_of(planes, count) + plain


def _window(count: int) -> int:
    """Lattice points of a transform of so many lenslets."""
    return smooth_length(max(count + _SPREAD, 2 * _SPREAD + 1))


def matrices_of(planes: int, count: int) -> int:
    """Bytes of the matrices of so many planes and lenslets, at most."""
    return 5 * planes * (_window(count) // 2 + 2) ** 2 * (PIXELS * VOXELS) ** 2


def measure_microscope(device: Device, size: str, repeats: int) -> Report:
    """Times of one projection and one back-projection over those of the plain form."""
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
        Case("its bare transforms", plain.transforms, both / share, "voxels"),
        Case("forward and backward", finished(ours, device), both, "voxels"),
        Case("forward", finished(lambda: projector.project(there), device), both / 2, "voxels"),
    ]
    times = in_turn(cases, repeats)
    goals = (_goal(times, share), Goal("point images, minutes", made / 60, MINUTES, "at most"))
    notes = (
        f"The plain form takes {share * times[0].median:.3g} s for all {planes} planes; its bare "
        f"transforms take {times[1].over(times[0]):.2f} of that.",
        f"Matrices of {projector.nbytes / 2**30:.2f} GiB, point images of "
        f"{sum(one.nbytes for one in images.stored) / 2**20:.0f} MiB, made in {made:.3g} s.",
    )
    rows = time_rows(times, times[0])
    return Report("microscope", size, "time over the plain form's part", rows, goals, notes)


def _goal(times: list[Times], share: float) -> Goal:
    ratio = share / times[2].over(times[0])
    return Goal("plain over forward and backward", ratio, GOAL, "at least")


def images_of(device: Device, planes: int) -> PointImages:
    """A 60x/1.2 water objective, lenslets of 100 um and 2.5 mm, planes within 10 um."""
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
        """A volume's frame, of the first planes only."""
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
        """The adjoint."""
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

    def transforms(self) -> None:
        """As many transforms as forward and backward make, and nothing else."""
        field = np.ones((self.window, self.window), np.float32)
        for otf in self.otf:
            self.rfft(field)
            self.irfft(otf, self.window)


def _transforms() -> tuple[Callable[[Array], Array], Callable[[Array, int], Array]]:
    """Real transforms of float32 with all cores."""
    if find_spec("ducc0") is not None:
        import ducc0

        def rfft(a: Array) -> Array:
            return np.asarray(ducc0.fft.r2c(a, nthreads=0))

        def irfft(a: Array, n: int) -> Array:
            return np.asarray(ducc0.fft.c2r(a, lastsize=n, inorm=2, forward=False, nthreads=0))

        return rfft, irfft
    import scipy.fft

    return (
        lambda a: np.asarray(scipy.fft.rfft2(a, workers=-1)),
        lambda a, n: np.asarray(scipy.fft.irfft2(a, s=(n, n), workers=-1)),
    )


BENCHMARKS = (
    Benchmark(
        "microscope",
        "a volume to a microscope's frame and back, beside convolutions of whole frames",
        sizes=("51x67",),
        quick="2x9",
        needs=_needs,
        run=measure_microscope,
        smaller=lambda size: halved(size, (0, 1), 2),
    ),
)
