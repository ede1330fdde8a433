"""Threads that share work with the caller, kept from call to call.

A new thread begins on the core that made it and stays there until the scheduler notices.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from threading import Event
from typing import TypeVar

Part = TypeVar("Part")
Own = TypeVar("Own")


def share(work: Callable[[Part, Own], None], parts: Sequence[Part], owned: Sequence[Own]) -> None:
    """``work`` on every part, the calling thread and others taking the next one each.

    Parameters
    ----------
    work : callable
        Of a part and of what the thread owns.
    parts : sequence
    owned : sequence
        One for each thread, the first for the caller's.

    Raises
    ------
    BaseException
        What ``work`` raised, in the calling thread before the others, when all have ended.
    """
    left, failed = iter(parts), Event()

    def run(own: Own) -> None:
        try:
            for part in left:
                if failed.is_set():
                    return
                work(part, own)
        except BaseException:
            failed.set()
            raise

    helpers = owned[1 : len(parts)]
    others = [_kept(len(owned) - 1).submit(run, own) for own in helpers]
    try:
        run(owned[0])
    finally:
        begun = [other for other in others if not other.cancel()]
        try:
            wait(begun)
        except BaseException:  # an interrupt: what they work on is the caller's
            failed.set()
            wait(begun)
            raise
    for other in begun:
        other.result()


@cache
def _kept(count: int) -> ThreadPoolExecutor:
    """So many threads; a process that was forked off makes its own."""
    return ThreadPoolExecutor(count, thread_name_prefix="clplen-blocks")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_kept.cache_clear)
