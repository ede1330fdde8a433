"""Bars of long functions: in the kernel of a notebook, and nowhere else."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import pytest
import tqdm.auto

from clplen import progress
from clplen.progress import in_notebook, notebook_bar


@notebook_bar("inner")
def inner(*, progress: Any = None) -> bool:
    return progress is not None


@notebook_bar("counting")
def count(n: int, *, progress: Any = None) -> list[bool]:
    seen = []
    for k in range(n):
        seen.append(inner())
        if progress is not None:
            progress(k + 1, n)
    return [progress is not None, *seen]


@pytest.fixture
def bars(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Bars that are made, in a process that looks like the kernel of a notebook."""
    made: list[Any] = []

    class Bar:
        def __init__(self, *, total: int, desc: str, delay: float, leave: bool) -> None:
            self.total, self.desc, self.n, self.is_closed = total, desc, 0, False
            made.append(self)

        def update(self, n: int) -> None:
            self.n += n

        def close(self) -> None:
            self.is_closed = True

    monkeypatch.setattr(tqdm.auto, "tqdm", Bar)
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    return made


def test_no_bar_outside_of_notebooks(monkeypatch: pytest.MonkeyPatch) -> None:
    for shell in (None, SimpleNamespace()):  # a program, and IPython in a terminal
        ipython = SimpleNamespace(get_ipython=lambda shell=shell: shell)
        monkeypatch.setitem(sys.modules, "IPython", ipython)
        assert not in_notebook()
        assert count(2) == [False, False, False]


def test_one_bar_in_a_notebook(bars: list[Any]) -> None:
    assert count(3) == [True, False, False, False]
    (bar,) = bars
    assert (bar.desc, bar.total, bar.n, bar.is_closed) == ("counting", 3, 3, True)
    assert inner()
    assert len(bars) == 1  # nothing was reported


def test_the_callers_progress_is_called_instead(bars: list[Any]) -> None:
    calls: list[tuple[int, int]] = []
    assert count(2, progress=lambda done, total: calls.append((done, total)))[0]
    assert (calls, bars) == ([(1, 2), (2, 2)], [])


def test_a_bar_closes_after_an_error(bars: list[Any]) -> None:
    @notebook_bar("failing")
    def failing(*, progress: Any) -> None:
        progress(1, 4)
        raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011
        failing()
    assert bars[0].is_closed
    assert not progress._is_active.get()
