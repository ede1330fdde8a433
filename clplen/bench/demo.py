"""What ``clplen demo`` computes, beside the bare transforms in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clplen import demo
from clplen.bench import camera
from clplen.bench.measure import Case, finished, in_turn
from clplen.bench.report import Goal, Report, time_rows
from clplen.bench.sizes import numbers
from clplen.lightfield.focus_and_depth import focal_stack
from clplen.lightfield.model.light_field import LightField

if TYPE_CHECKING:
    from clplen.cameras.plenoptic1 import Plenoptic1
    from clplen.compute.device import Device
    from clplen.lightfield.raw.raw_image import Transforms

SUMMARY = "raw images, decoding and focal stack of the demo, beside the bare transforms in them"
SIZES = ("101",)
QUICK = "53"
MOST = 1.3  # of the bare transforms' time
needs = camera.needs
smaller = camera.smaller


def run(device: Device, size: str, repeats: int) -> Report:
    """Time of the demo's computation over that of bare transforms."""
    [count] = numbers(size, (1,), camera.FORM)
    cam = demo.camera(device, count=count)
    cases = [
        camera.bare_ffts(transforms(cam), device),
        Case("raw images, decoding, stack", finished(lambda: compute(cam), device)),
    ]
    times = in_turn(cases, repeats)
    goal = Goal("computation over bare FFTs", times[1].over(times[0]), MOST, "at most")
    note = (
        "The transforms of all exposures, at their padded sizes: two of each propagation, from the "
        "lens to the array and from there to the sensor."
    )
    rows = time_rows(times, times[0])
    return Report("demo", size, "time over the bare transforms", rows, (goal,), (note,))


def compute(cam: Plenoptic1) -> None:
    """The scene's raw image, light field and stack; then every point of the depth table."""
    lf = LightField.from_raw(demo.scene(cam))
    focal_stack(lf, alphas=np.linspace(*demo.STACK_ALPHAS))
    for dz in demo.DEPTHS:
        LightField.from_raw(demo.expose_point(cam, (0.0, 0.0, dz)))


def transforms(cam: Plenoptic1) -> Transforms:
    """Those of all exposures of `compute`."""
    places = [*demo.POINTS.values(), *((0.0, 0.0, dz) for dz in demo.DEPTHS)]
    reports = [demo.expose_point(cam, place).exposure for place in places]
    return camera.added([report.transforms for report in reports if report is not None])
