"""The index of published figures, `claims.toml`."""

from __future__ import annotations

import datetime
import re
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TESTS = Path(__file__).parents[1] / "tests"
INDEX = Path(__file__).with_name("claims.toml")
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Claim:
    """A published figure and the command that measures it again.

    Attributes
    ----------
    name : str
        "group.row" of the index.
    says : str
        The quantity, with its unit.
    figures : str
        The figures as published; empty where the claim is a limit.
    date, machine : datetime.date, str
        When and on which machine the figures were measured.
    pages : list of str
        Pages that quote the figures.
    command : str
        A command line in the root of a checkout: a benchmark or `clplen bench`.
    test : str
        In place of a command, the name of a test that asserts a limit of the figures.
    find : str
        Regular expression whose groups are the figures in the output of the command; without one
        the exit status of the command decides.
    tolerance : float
        Largest relative difference of a new figure.
    """

    name: str
    says: str
    figures: str
    date: datetime.date
    machine: str
    pages: list[str]
    command: str = ""
    test: str = ""
    find: str = ""
    tolerance: float = 0.3

    @property
    def group(self) -> str:
        """First part of the name."""
        return self.name.partition(".")[0]

    @property
    def numbers(self) -> list[float]:
        """The published figures as numbers."""
        return numbers_of(self.figures)

    @property
    def words(self) -> list[str]:
        """The command as a list of words."""
        if not self.test:
            return self.command.replace("clplen bench", "python -m clplen bench").split()
        return ["python", "-m", "pytest", "-q", "-m", "", *tests()[self.test]]

    def numbers_in(self, output: str) -> list[float]:
        """Return the figures in the output of the command."""
        groups = [match.groups() for match in re.finditer(self.find, output, re.M)]
        return [float(group) for match in groups for group in match]

    def agrees_with(self, numbers: list[float]) -> bool:
        """Whether new figures are as near to the published ones as the tolerance asks for."""
        pairs = list(zip(self.numbers, numbers, strict=False))
        near = all(abs(new - old) <= self.tolerance * abs(old) for old, new in pairs)
        return near and len(numbers) == len(self.numbers)


def numbers_of(text: str) -> list[float]:
    """Return all numbers of a text, ".5" and "0.5" alike."""
    return [float(word) for word in NUMBER.findall(text)]


@cache
def tests() -> dict[str, list[str]]:
    """Return the pytest ids of all test functions by their names."""
    ids: dict[str, list[str]] = {}
    for file in sorted(TESTS.rglob("test_*.py")):
        for name in re.findall(r"^def (test_\w+)\(", file.read_text("utf-8"), re.M):
            ids.setdefault(name, []).append(f"{file.relative_to(TESTS.parent)}::{name}")
    return ids


def claims() -> list[Claim]:
    """Return all claims of the index in its order."""
    index: dict[str, Any] = tomllib.loads(INDEX.read_text(encoding="utf-8"))
    machines = index.pop("machines")
    found = []
    for group, shared in index.items():
        for name, row in shared.pop("rows").items():
            values = shared | row
            if "test" in row:
                values.pop("command", None)
            values["machine"] = machines[values["machine"]]
            found.append(Claim(name=f"{group}.{name}", **values))
    return found
