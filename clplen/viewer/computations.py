"""Computations that pages ask for: one at a time, in order, dropped where a newer one came."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from clplen.errors import ClplenError

logger = logging.getLogger("clplen.viewer")

Progress = Callable[[float, str], None]
Answer = tuple[dict[str, Any], list[bytes]]
Compute = Callable[[dict[str, Any], Progress], Answer]

MOST_WAITING = 32
_WAIT = 0.5  # seconds after which a page that waits is told so, and found if it is gone
_BUSY = "The computer is busy: try again when the present computations are done."


class OvertakenError(Exception):
    """A request that a newer one of its channel overtook, or whose page is gone."""


class BusyError(Exception):
    """More requests wait than are taken."""


@dataclass(eq=False)
class Request:
    """A computation that a page asked for."""

    channel: tuple[str, str]  # page and purpose: a newer request of the same channel drops this one
    # Set when it shall not be computed, or not to its end.
    overtaken: threading.Event = field(default_factory=threading.Event)

    def check(self) -> None:
        """Raise `OvertakenError` if it was."""
        if self.overtaken.is_set():
            raise OvertakenError


class Computations:
    """A queue for one device, in the order of arrival."""

    def __init__(self, compute: Compute) -> None:
        self._compute = compute
        self._waiting: list[Request] = []
        self._turn = threading.Condition()

    def run(self, request: Request, body: dict[str, Any], progress: Progress) -> Answer:
        """Wait for the device, and compute."""
        with self._turn:
            for other in self._waiting:
                if other.channel == request.channel:
                    other.overtaken.set()
            if len(self._waiting) >= MOST_WAITING:
                raise BusyError(_BUSY)
            self._waiting.append(request)
            self._turn.notify_all()
        try:
            while not self._has_turn(request):
                progress(0.0, "Waiting for the device")
            request.check()

            def report(share: float, what: str) -> None:
                request.check()
                progress(share, what)

            return self._compute(body, report)
        finally:
            with self._turn:
                self._waiting.remove(request)
                self._turn.notify_all()

    def _has_turn(self, request: Request) -> bool:
        """Wait a while; whether the request is the next, or dropped."""
        with self._turn:
            return self._turn.wait_for(
                lambda: request.overtaken.is_set() or self._waiting[0] is request, _WAIT
            )

    def end(self) -> None:
        """Drop everything that waits or runs."""
        with self._turn:
            for request in self._waiting:
                request.overtaken.set()
            self._turn.notify_all()


def sentence_of(error: Exception) -> str:
    """What a page says of an error; the traceback of one that was not foreseen is logged."""
    opencl = sys.modules.get("pyopencl")
    expected = [ClplenError, ValueError, OSError, MemoryError, BusyError]
    if opencl is not None:
        expected.append(opencl.Error)
    if isinstance(error, tuple(expected)):
        lines = str(error).splitlines()
        return lines[0] if lines else f"The computation failed ({type(error).__name__})."
    logger.debug("a computation of the viewer failed", exc_info=error)
    return f"The computation failed ({type(error).__name__})."
