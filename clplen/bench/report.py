"""What a benchmark found: rows of times, goals, and their form in JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from clplen.bench.measure import Times


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Attributes
    ----------
    name : str
    seconds : float
        Median of one run.
    spread : float
        Distance of the quartiles over the median.
    rate : float
        Work a second, in ``unit`` a second.
    unit : str
    ratio : float or None
        What this table compares: see `Report.ratio_is`.
    """

    name: str
    seconds: float
    spread: float
    rate: float
    unit: str
    ratio: float | None = None


@dataclass(frozen=True)
class Goal:
    """A figure that is to be reached.

    Attributes
    ----------
    name : str
    measured, limit : float
    rule : {"at least", "at most"}
    why : str
        The reason where it is not met, if it is known.
    """

    name: str
    measured: float
    limit: float
    rule: Literal["at least", "at most"]
    why: str = ""

    @property
    def met(self) -> bool:
        """Whether it is reached."""
        if self.rule == "at least":
            return self.measured >= self.limit
        return self.measured <= self.limit


@dataclass(frozen=True)
class Report:
    """One benchmark at one size.

    Attributes
    ----------
    name, size : str
    ratio_is : str
        What the rows' ratios are of: "rays/s over those of NumPy", "time over two bare FFTs".
    rows : tuple of Row
    goals : tuple of Goal
    notes : tuple of str
        Whole sentences below the table.
    """

    name: str
    size: str
    ratio_is: str
    rows: tuple[Row, ...]
    goals: tuple[Goal, ...] = ()
    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Plain dictionaries and lists."""
        found = asdict(self)
        for goal, plain in zip(self.goals, found["goals"], strict=True):
            plain["met"] = goal.met
        return found


def time_rows(times: Sequence[Times], by: Times | None = None) -> tuple[Row, ...]:
    """Rows whose ratio is their time over that of ``by``."""
    return tuple(
        Row(t.case.name, t.median, t.spread, t.rate, t.case.unit, t.over(by) if by else None)
        for t in times
    )


def rate_rows(times: Sequence[Times], by: Times) -> tuple[Row, ...]:
    """Rows whose ratio is their rate over that of ``by``."""
    scale = [t.case.work / by.case.work for t in times]
    return tuple(
        Row(t.case.name, t.median, t.spread, t.rate, t.case.unit, s / t.over(by))
        for t, s in zip(times, scale, strict=True)
    )
