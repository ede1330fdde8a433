"""Every cue of depth beside the focal stack of its planes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.bench.measure import Case, finished, in_turn
from clplen.bench.report import Goal, Report, time_rows
from clplen.bench.sizes import halved, numbers
from clplen.lightfield.depth.depth_map import CUES
from clplen.lightfield.focus_and_depth import depth_map, focal_stack
from clplen.lightfield.model.light_field import LightField

if TYPE_CHECKING:
    from clplen.compute.device import Device

SUMMARY = "every cue of depth, beside the focal stack of its planes"
SIZES = ("9x9x512x512",)
QUICK = "5x5x60x80"
FORM = "VxUxYxX[xC]"
PLANES = 31
RANGE = 1.5  # disparities from -1.5 to 1.5
MOST = 2.0  # of the stack's time, for the energy cue


def smaller(size: str) -> str:
    """Half the rows and columns."""
    return halved(size, (2, 3), 16)


def needs(size: str) -> int:
    """The light field three times, a stack, and the maps of the combined cue."""
    shape = numbers(size, (4, 5), FORM)
    return 4 * (3 * math.prod(shape) + 4 * PLANES * math.prod(shape[2:]))


def run(device: Device, size: str, repeats: int) -> Report:
    """Times of every cue over that of the focal stack."""
    shape = numbers(size, (4, 5), FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    lf = LightField.from_array(values, device=device)
    planes = np.linspace(-RANGE, RANGE, PLANES)

    def of(cue: str) -> Callable[[], Any]:
        return lambda: depth_map(lf, disparities=planes, cue=cue)

    stack = finished(lambda: focal_stack(lf, disparities=planes), device)
    pixels = float(PLANES * math.prod(shape[2:4]))
    cases = [Case(f"focal stack of {PLANES} planes", stack, pixels, "pixels")]
    cases += [Case(cue, of(cue), pixels, "pixels") for cue in CUES]
    times = in_turn(cases, repeats)
    goal = Goal("energy over the stack", times[1].over(times[0]), MOST, "at most")
    return Report("depth", size, "time over that of the stack", time_rows(times, times[0]), (goal,))
