"""Copies between host and device, counted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import pyopencl as cl
import pytest

Counter = Callable[[int], AbstractContextManager[dict[str, int]]]


@pytest.fixture
def copies(monkeypatch: pytest.MonkeyPatch) -> Counter:
    """``with copies(nbytes) as count`` counts those of at least so many bytes, by direction."""

    @contextmanager
    def counting(nbytes: int) -> Iterator[dict[str, int]]:
        count = {"up": 0, "down": 0}
        enqueue_copy, buffer = cl.enqueue_copy, cl.Buffer

        def copied(queue: Any, dest: Any, src: Any, **options: Any) -> Any:
            for side, where in ((src, "up"), (dest, "down")):
                if not isinstance(side, cl.MemoryObjectHolder) and side.nbytes >= nbytes:
                    count[where] += 1
            return enqueue_copy(queue, dest, src, **options)

        def made(context: Any, flags: int, size: int = 0, hostbuf: Any = None) -> Any:
            copies_it = flags & cl.mem_flags.COPY_HOST_PTR and hostbuf is not None
            if copies_it and hostbuf.nbytes >= nbytes:
                count["up"] += 1
            return buffer(context, flags, size, hostbuf)

        with monkeypatch.context() as patch:
            patch.setattr(cl, "enqueue_copy", copied)
            patch.setattr(cl, "Buffer", made)
            yield count

    return counting
