"""Copies from the host to the device and back, beside copies within each."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clplen.bench import ceilings
from clplen.bench.measure import Case, finished, in_turn
from clplen.bench.report import Report, rate_rows
from clplen.bench.sizes import halved, numbers
from clplen.lightfield.model.light_field import LightField

if TYPE_CHECKING:
    from clplen.compute.device import Device

SUMMARY = "host to device and back, beside a copy within the host's memory"
SIZES = ("15x15x434x625x3",)
QUICK = "5x5x120x160x3"


def smaller(size: str) -> str:
    """Half the rows and columns."""
    return halved(size, (2, 3), 16)


def needs(size: str) -> int:
    """The light field eight times: three on the host, four on the device, one on its way."""
    return 8 * 4 * math.prod(numbers(size, (4, 5), "VxUxYxX[xC]"))


def run(device: Device, size: str, repeats: int) -> Report:
    """Rates of a light field's way in and out."""
    shape = numbers(size, (4, 5), "VxUxYxX[xC]")
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    twin = np.empty_like(values)
    weights = np.ones(shape[:2], np.float32)
    there = LightField.from_array(values, device=device, weights=weights)
    moved = values.nbytes

    def from_array() -> None:
        LightField.from_array(values, device=device, weights=weights)
        device.finish()

    cases = [
        Case("copy within the host", lambda: np.copyto(twin, values), moved, "bytes"),
        Case("copy within the device", ceilings.copy(device, moved).run, moved, "bytes"),
        Case("upload", finished(lambda: device.upload(values), device), moved, "bytes"),
        Case("download", lambda: device.download(there.data), moved, "bytes"),
        Case("LightField.from_array", from_array, moved, "bytes"),
        Case("LightField.to_numpy", there.to_numpy, moved, "bytes"),
    ]
    times = in_turn(cases, repeats)
    return Report("transfers", size, "rate over that within the host", rate_rows(times, times[0]))
