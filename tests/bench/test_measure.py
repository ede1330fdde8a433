"""Medians, ratios of rounds, sizes; benchmarks by name, and memory that does not suffice."""

from __future__ import annotations

from dataclasses import replace

import pyopencl as cl
import pytest

from clplen.bench import registry
from clplen.bench.measure import Case, Times, in_turn, numbers
from clplen.bench.report import Benchmark, Report, rate_rows, time_rows
from clplen.compute.device import Device
from clplen.errors import ClplenError, DeviceError, ShapeError


def times(name: str, *seconds: float, work: float = 1.0) -> Times:
    return Times(Case(name, lambda: None, work), seconds)


def test_cases_are_run_in_turn_after_one_that_does_not_count() -> None:
    order: list[str] = []
    cases = [Case("a", lambda: order.append("a")), Case("b", lambda: order.append("b"))]
    assert [len(t.seconds) for t in in_turn(cases, 3)] == [3, 3]
    assert order == ["a", "b"] * 4


def test_medians_spreads_and_ratios_of_the_same_round() -> None:
    t = times("t", 1.0, 2.0, 3.0, 4.0, 10.0, work=6.0)
    assert (t.median, t.rate) == (3, 2)
    assert t.spread == pytest.approx((4 - 2) / 3)
    assert times("once", 5.0).spread == 0
    # a machine twice as slow in the second half: the ratio stays 3
    mine, other = times("m", 3.0, 3.0, 6.0, 6.0), times("o", 1.0, 1.0, 2.0, 2.0)
    assert mine.over(other) == 3
    assert [row.ratio for row in time_rows([mine], other)] == [3]
    assert time_rows([mine])[0].ratio is None
    slow, fast = times("slow", 4.0, work=8.0), times("fast", 1.0, work=6.0)
    first, second = rate_rows([slow, fast], slow)
    assert first.ratio == 1
    assert second.ratio == pytest.approx((6 / 1) / (8 / 4))


def test_every_benchmark_has_its_parts() -> None:
    for name in registry.NAMES:
        benchmark = registry.find_benchmark(name)
        assert benchmark.name == name
        assert benchmark.summary
        assert all(benchmark.needs(size) >= 0 for size in (*benchmark.sizes, benchmark.quick))
    with pytest.raises(ClplenError, match=r"no benchmark 'stacks'; choose among .*transfers"):
        registry.find_benchmark("stacks")


def test_memory_that_does_not_suffice_is_said(device: Device) -> None:
    refused: Exception = MemoryError()

    def run(device: Device, size: str, repeats: int) -> Report:
        raise refused

    fake = Benchmark("fake", "", (), "", lambda size: 0, run)
    messages: list[str] = []
    for error in (
        MemoryError(),
        cl.MemoryError("out of memory"),
        DeviceError("The pictures needs 9 bytes, but the device has 8 bytes."),
    ):
        refused = error
        found = registry.run_benchmark(fake, device, size="16", repeats=1, say=messages.append)
        assert found is None
    refused = AssertionError("it began")
    large = replace(fake, needs=lambda size: 2**62)
    assert registry.run_benchmark(large, device, size="16", repeats=1, say=messages.append) is None
    assert messages == ["fake: the memory does not suffice for 16; choose a smaller --size."] * 4
    refused = DeviceError("The operands live on two devices.")
    with pytest.raises(DeviceError, match="two devices"):
        registry.run_benchmark(fake, device, size="2", repeats=1, say=messages.append)


def test_sizes() -> None:
    assert numbers("3x5x70x80", (4, 5), "VxUxYxX") == (3, 5, 70, 80)
    for size in ("", "3x5", "3x5x0x8", "3x5x7x-8", "3x5x7xa", "3x5x7x8x9x1"):
        with pytest.raises(ShapeError, match="must be VxUxYxX"):
            numbers(size, (4, 5), "VxUxYxX")
