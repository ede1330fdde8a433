"""Medians, spreads, ratios of rounds, exponents."""

from __future__ import annotations

import pytest
from bench_growth import exponent

from clplen.bench.measure import Case, Times, in_turn
from clplen.bench.report import Goal, rate_rows, time_rows


def times(name: str, *seconds: float, work: float = 1.0) -> Times:
    return Times(Case(name, lambda: None, work), seconds)


def test_cases_are_run_in_turn_after_one_that_does_not_count() -> None:
    order = []
    cases = [Case("a", lambda: order.append("a")), Case("b", lambda: order.append("b"))]
    found = in_turn(cases, 3)
    assert order == ["a", "b"] * 4
    assert [len(t.seconds) for t in found] == [3, 3]


def test_median_spread_and_rate() -> None:
    t = times("t", 1.0, 2.0, 3.0, 4.0, 10.0, work=6.0)
    assert t.median == 3
    assert t.spread == pytest.approx((4 - 2) / 3)
    assert t.rate == 2
    assert times("once", 5.0).spread == 0


def test_ratios_are_of_the_same_round() -> None:
    # a machine twice as slow in the second half: the ratio stays 3
    mine, other = times("m", 3.0, 3.0, 6.0, 6.0), times("o", 1.0, 1.0, 2.0, 2.0)
    assert mine.over(other) == 3
    (row,) = time_rows([mine], other)
    assert row.ratio == 3
    assert time_rows([mine])[0].ratio is None


def test_ratios_of_rates_count_the_work() -> None:
    slow, fast = times("slow", 4.0, work=8.0), times("fast", 1.0, work=6.0)
    first, second = rate_rows([slow, fast], slow)
    assert first.ratio == 1
    assert second.ratio == pytest.approx((6 / 1) / (8 / 4))


@pytest.mark.parametrize(
    ("rule", "measured", "met"),
    [
        ("at least", 2.0, True),
        ("at least", 1.9, False),
        ("at most", 2.0, True),
        ("at most", 2.1, False),
    ],
)
def test_goals(rule: str, measured: float, met: bool) -> None:
    assert Goal("g", measured, 2.0, rule).met is met  # type: ignore[arg-type]


def test_the_exponent_of_a_power_law() -> None:
    found = exponent([times(str(n), 0.25 * n**1.5, work=float(n)) for n in (1, 2, 4, 8)])
    assert found == pytest.approx(1.5)
