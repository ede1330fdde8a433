"""Work shared by threads that are kept."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Barrier, Thread, get_ident
from time import sleep

import pytest

from clplen.compute.fft import columns
from clplen.compute.fft.columns import share


def test_every_part_is_done_once_by_whoever_is_free() -> None:
    done: list[tuple[int, str]] = []
    share(lambda part, own: done.append((part, own)), range(100), ["caller", "a", "b"])
    assert sorted(part for part, _ in done) == list(range(100))
    share(lambda part, own: done.append((part, own)), [], ["caller", "a"])
    share(lambda part, own: done.append((part, own)), [7], ["caller", "a"])
    assert done[100:] == [(7, "caller")]


def together() -> set[int]:
    """The two threads that are in the midst of a part at once."""
    both, met = Barrier(2, timeout=10), set()

    def meet(part: int, own: str) -> None:
        both.wait()
        met.add(get_ident())

    share(meet, [0, 1], ["caller", "other"])
    return met


def test_threads_are_kept() -> None:
    met = together()
    assert get_ident() in met
    assert together() == met


def test_the_caller_does_everything_where_the_other_is_busy() -> None:
    """Shares within a share: one waits for the thread that is at work on the outer one."""
    done: list[int] = []

    def inner(part: int, own: str) -> None:
        share(lambda n, _: done.append(n), [10 * part, 10 * part + 1], ["caller", "other"])

    share(inner, [1, 2, 3], ["caller", "other"])
    assert sorted(done) == [10, 11, 20, 21, 30, 31]


@pytest.mark.parametrize("failing", ["caller", "other"])
def test_a_failure_of_either_thread_is_raised_when_both_have_ended(failing: str) -> None:
    both, ended = Barrier(2, timeout=10), []

    def fails(part: int, own: str) -> None:
        both.wait()
        if own == failing:
            raise MemoryError("no room")
        ended.append(part)

    with pytest.raises(MemoryError, match="no room"):
        share(fails, [0, 1], ["caller", "other"])
    assert len(ended) == 1
    assert len(together()) == 2  # and again


class Interrupted(list[int]):
    """Parts that interrupt the calling thread when it asks for its second one."""

    def __iter__(self) -> Iterator[int]:
        caller, asked, left = get_ident(), 0, self[:]

        class Steps:
            def __iter__(self) -> Steps:
                return self

            def __next__(self) -> int:
                nonlocal asked
                asked += get_ident() == caller
                if get_ident() == caller and asked == 2:
                    raise KeyboardInterrupt
                if not left:
                    raise StopIteration
                return left.pop()

        return Steps()


def test_an_interrupt_between_parts_ends_the_work_of_all() -> None:
    both, done = Barrier(2, timeout=10), []

    def work(part: int, own: str) -> None:
        if part >= 98:
            both.wait()
        sleep(0.005)
        done.append(part)

    with pytest.raises(KeyboardInterrupt):
        share(work, Interrupted(range(100)), ["caller", "other"])
    assert len(done) < 50  # of 100, which the other would have gone on with


def test_the_caller_does_everything_where_no_thread_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """As under a limit of address space, which their stacks do not fit into."""

    def refused(self: Thread) -> None:
        raise RuntimeError("can't start new thread")

    columns._thread_pool.cache_clear()
    done: list[tuple[int, str]] = []
    with monkeypatch.context() as patch:
        patch.setattr(Thread, "start", refused)
        share(lambda part, own: done.append((part, own)), range(9), ["caller", "a", "b"])
    assert done == [(part, "caller") for part in range(9)]
    assert len(together()) == 2  # later ones start again
