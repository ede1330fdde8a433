"""One exposure of a plenoptic camera beside the transforms in it, and its decoding."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from clplen import demo
from clplen.bench import ceilings
from clplen.bench.measure import Case, finished, in_turn
from clplen.bench.report import Report, time_rows
from clplen.bench.sizes import halved, numbers
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.raw import Transforms

if TYPE_CHECKING:
    from clplen.compute.device import Device

SUMMARY = "one point through the demo's camera, beside the bare transforms in it; its decoding"
SIZES = ("101",)
QUICK = "53"
FORM = "a number of lenslets across"
_FIELDS = 12  # of complex samples of the sensor that are held at a time, with all tables


def smaller(size: str) -> str:
    """Half the lenslets."""
    return halved(size, (0,), 24)


def needs(size: str) -> int:
    """Fields on the sensor, padded ones at most."""
    [count] = numbers(size, (1,), FORM)
    return 4 * _FIELDS * 8 * (30 * count) ** 2


def run(device: Device, size: str, repeats: int) -> Report:
    """Times of exposure and decoding over those of bare transforms."""
    [count] = numbers(size, (1,), FORM)
    cam = demo.camera(device, count=count)
    point = (0.0, 0.0, demo.DEPTHS[0])
    raw = demo.expose_point(cam, point)
    lf = LightField.from_raw(raw)
    pixels = float(math.prod(raw.shape))
    assert raw.exposure is not None
    cases = [
        bare_ffts(raw.exposure.transforms, device),
        Case("exposure of a point", lambda: demo.expose_point(cam, point), pixels, "pixels"),
        ceilings.copy(device, int(lf.data.nbytes), "copy of the light field"),
        Case("decoding", finished(lambda: LightField.from_raw(raw), device), pixels, "pixels"),
    ]
    times = in_turn(cases, repeats)
    note = f"Decoding takes {times[3].over(times[2]):.2f} of a copy of the light field it makes."
    rows = time_rows(times, times[0])
    return Report("camera", size, "time over the bare transforms", rows, (), (note,))


def bare_ffts(transforms: Transforms, device: Device) -> Case:
    """All the transforms of exposures, at their padded sizes, by the device's own route.

    Parameters
    ----------
    transforms : tuple
        (count, (ny, nx)) each, as `Exposure` tells them.
    device : Device
    """
    parts = [ceilings.bare_fft(shape, device, count=count) for count, shape in transforms]
    name = " + ".join(part.name for part in parts)

    def run() -> None:
        for part in parts:
            part.run()

    return Case(name, run, sum(part.work for part in parts), "transforms")


def added(transforms: Sequence[Transforms]) -> Transforms:
    """Transforms of several exposures, those of one shape together."""
    counts: dict[tuple[int, int], int] = {}
    for several in transforms:
        for count, shape in several:
            counts[shape] = counts.get(shape, 0) + count
    return tuple((count, shape) for shape, count in counts.items())
