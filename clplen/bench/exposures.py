"""Benchmarks of exposures, decoding and the demo, relative to their bare transforms."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clplen import demo
from clplen.bench import ceilings
from clplen.bench.measure import Case, finished, in_turn, numbers
from clplen.bench.report import Benchmark, Report, time_rows
from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.device import Device
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import RawImage, Transforms
from clplen.lightfield.stacks import focal_stack
from clplen.wave.elements.lenslets import MicrolensArray

_FORM = "a number of lenslets across"
_MIN_LENSLETS = 75  # lenslets across that cover the aperture of the focused camera
_FIELDS = 12  # complex fields of the sensor in memory at a time, tables included


def _needs(size: str) -> int:
    """Return the memory of the fields on the sensor in bytes."""
    [count] = numbers(size, (1,), _FORM)
    return 4 * _FIELDS * 8 * (30 * count) ** 2


def measure_camera(device: Device, size: str, repeats: int) -> Report:
    """Measure exposure and decoding relative to bare transforms."""
    [count] = numbers(size, (1,), _FORM)
    cam = demo.camera(device, count=count)
    point = (0.0, 0.0, demo.DEPTHS[0])
    raw = demo.expose_point(cam, point)
    lf = LightField.from_raw(raw)
    pixels = float(math.prod(raw.shape))
    assert raw.exposure is not None
    focused = focused_camera(device, count)
    behind = _expose(focused)
    assert behind.exposure is not None
    cases = [
        bare_ffts(raw.exposure.transforms, device),
        Case("exposure of a point", lambda: demo.expose_point(cam, point), pixels, "pixels"),
        ceilings.copy(device, int(lf.data.nbytes), "copy of the light field"),
        Case("decoding", finished(lambda: LightField.from_raw(raw), device), pixels, "pixels"),
        bare_ffts(behind.exposure.transforms, device, "focused: "),
        Case("focused: exposure of a point", lambda: _expose(focused), pixels, "pixels"),
    ]
    times = in_turn(cases, repeats)
    note = f"Decoding takes {times[3].over(times[2]):.2f} of a copy of the light field it makes."
    rows = (*time_rows(times[:4], times[0]), *time_rows(times[4:], times[4]))
    return Report("camera", size, "time over the bare transforms", rows, (note,))


def focused_camera(device: Device, count: int) -> Plenoptic2:
    """Create a 2.0 camera of the demo's sensor: f = 120 mm, f_mu = 3 mm, m = 0.2."""
    lenslets = MicrolensArray(150e-6, 3e-3, count=count, fill="full")
    return PlenopticCamera.type2(
        focal_length=0.120,
        mla=lenslets,
        wavelength=532e-9,
        pixels_per_lenslet=30,
        m=0.2,
        device=device,
    )


def _expose(cam: Plenoptic2) -> RawImage:
    """Expose one in-focus point of the demo's size on the axis."""
    return cam.expose(PointSources([(0.0, 0.0, 0.0)], diameter=demo.SOURCE_DIAMETER))


def bare_ffts(transforms: Transforms, device: Device, prefix: str = "") -> Case:
    """Create all transforms of exposures, at their padded sizes, by the device's FFT route."""
    parts = [ceilings.bare_fft(shape, device, count=count) for count, shape in transforms]
    name = prefix + " + ".join(part.name for part in parts)

    def run() -> None:
        for part in parts:
            part.run()

    return Case(name, run, sum(part.work for part in parts), "transforms")


def added(transforms: Sequence[Transforms]) -> Transforms:
    """Sum the transforms of several exposures by shape."""
    counts: dict[tuple[int, int], int] = {}
    for counted in transforms:
        for count, shape in counted:
            counts[shape] = counts.get(shape, 0) + count
    return tuple((count, shape) for shape, count in counts.items())


def measure_demo(device: Device, size: str, repeats: int) -> Report:
    """Measure the demo's computation relative to bare transforms."""
    [count] = numbers(size, (1,), _FORM)
    cam = demo.camera(device, count=count)
    cases = [
        bare_ffts(demo_transforms(cam), device),
        Case("raw images, decoding, stack", finished(lambda: compute_demo(cam), device)),
    ]
    times = in_turn(cases, repeats)
    note = (
        "Transforms of all exposures at their padded sizes: two for each propagation, from the "
        "lens to the array and from the array to the sensor."
    )
    rows = time_rows(times, times[0])
    return Report("demo", size, "time over the bare transforms", rows, (note,))


def compute_demo(cam: Plenoptic1) -> None:
    """Compute the scene's raw image, light field and stack, and the points of the depth table."""
    lf = LightField.from_raw(demo.scene(cam))
    focal_stack(lf, alphas=np.linspace(*demo.STACK_ALPHAS))
    for dz in demo.DEPTHS:
        LightField.from_raw(demo.expose_point(cam, (0.0, 0.0, dz)))


def demo_transforms(cam: Plenoptic1) -> Transforms:
    """Return the transforms of all exposures of `compute_demo`."""
    positions = [*demo.POINTS.values(), *((0.0, 0.0, dz) for dz in demo.DEPTHS)]
    reports = [demo.expose_point(cam, position).exposure for position in positions]
    return added([report.transforms for report in reports if report is not None])


BENCHMARKS = (
    Benchmark(
        "camera",
        "one point through the demo's camera and a focused one, beside bare transforms; decoding",
        sizes=("101",),
        quick=str(_MIN_LENSLETS),
        needs=_needs,
        run=measure_camera,
    ),
    Benchmark(
        "demo",
        "raw images, decoding and focal stack of the demo, beside the bare transforms in them",
        sizes=("101",),
        quick="53",
        needs=_needs,
        run=measure_demo,
    ),
)
