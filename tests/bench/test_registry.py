"""Benchmarks by name, sizes, and memory that does not suffice."""

from __future__ import annotations

from types import SimpleNamespace

import pyopencl as cl
import pytest

from clplen.bench import registry
from clplen.bench.measure import halved, numbers
from clplen.bench.report import Report
from clplen.compute.device import Device
from clplen.errors import ClplenError, DeviceError, ShapeError


@pytest.mark.parametrize("name", registry.NAMES)
def test_every_benchmark_has_its_parts(name: str) -> None:
    benchmark = registry.find_benchmark(name)
    assert benchmark.summary
    for size in (*benchmark.sizes, benchmark.quick):
        assert benchmark.needs(size) >= 0
        less = benchmark.smaller(size)
        assert not less or benchmark.needs(less) <= benchmark.needs(size)


@pytest.mark.parametrize("name", registry.NAMES)
def test_smaller_sizes_come_to_an_end(name: str) -> None:
    benchmark = registry.find_benchmark(name)
    size, steps = benchmark.sizes[0], 0
    while size:
        size, steps = benchmark.smaller(size), steps + 1
        assert steps < 64


def test_a_name_that_does_not_exist() -> None:
    with pytest.raises(ClplenError, match=r"no benchmark 'stacks'; there are .*transfers"):
        registry.find_benchmark("stacks")


def refusing(error: Exception, above: int) -> SimpleNamespace:
    """A benchmark whose memory does not suffice above a size."""

    def run(device: Device, size: str, repeats: int) -> Report:
        if int(size) > above:
            raise error
        return Report("fake", size, "nothing", ())

    return SimpleNamespace(
        name="fake",
        needs=lambda size: 0,
        run=run,
        smaller=lambda size: str(int(size) // 2) if int(size) > 1 else "",
    )


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        cl.MemoryError("out of memory"),
        DeviceError("The pictures needs 9 bytes, but the device has 8 bytes."),
    ],
)
def test_a_smaller_size_is_tried_and_said(error: Exception, device: Device) -> None:
    benchmark = refusing(error, above=4)
    said: list[str] = []
    report = registry.run_benchmark(benchmark, device, size="16", repeats=1, say=said.append)
    assert report is not None
    assert report.size == "4"
    assert said == [
        "fake: the memory does not suffice for 16; 8 is measured instead.",
        "fake: the memory does not suffice for 8; 4 is measured instead.",
    ]


def test_no_size_fits(device: Device) -> None:
    benchmark = refusing(MemoryError(), above=0)
    said: list[str] = []
    assert registry.run_benchmark(benchmark, device, size="2", repeats=1, say=said.append) is None
    assert said[-1] == "fake: the memory does not suffice for 1, and there is no smaller size."


def test_what_needs_more_than_there_is_does_not_begin(device: Device) -> None:
    benchmark = refusing(AssertionError("it began"), above=4)
    benchmark.needs = lambda size: 2**62 if int(size) > 4 else 0
    report = registry.run_benchmark(benchmark, device, size="8", repeats=1, say=lambda words: None)
    assert report is not None
    assert report.size == "4"


def test_other_errors_of_a_device_are_errors(device: Device) -> None:
    error = DeviceError("The operands live on two devices.")
    benchmark = refusing(error, above=0)
    with pytest.raises(DeviceError, match="two devices"):
        registry.run_benchmark(benchmark, device, size="2", repeats=1, say=lambda words: None)


def test_sizes() -> None:
    assert numbers("3x5x70x80", (4, 5), "VxUxYxX") == (3, 5, 70, 80)
    assert halved("3x5x70x80", (2, 3), 16) == "3x5x35x40"
    assert halved("3x5x70x30", (2, 3), 16) == ""


@pytest.mark.parametrize("size", ["", "3x5", "3x5x0x8", "3x5x7x-8", "3x5x7xa", "3x5x7x8x9x1"])
def test_sizes_that_are_none(size: str) -> None:
    with pytest.raises(ShapeError, match="is VxUxYxX"):
        numbers(size, (4, 5), "VxUxYxX")
