"""Queue of the computations that pages request; a newer request replaces an older one."""

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

MAX_WAITING = 32  # requests in the queue
_WAIT = 0.5  # interval of progress messages to waiting pages in seconds; detects closed pages
_BUSY = "The device is busy: try again when the current computations are done."


class OvertakenError(Exception):
    """Cancellation of a request: a newer one replaced it, or its page was closed."""


class BusyError(Exception):
    """Rejection of a request because the queue is full."""


@dataclass(eq=False)
class Request:
    """Computation requested by a page."""

    channel: tuple[str, str]  # page and purpose; a newer request of the channel replaces this one
    overtaken: threading.Event = field(default_factory=threading.Event)  # set to cancel it

    def check(self) -> None:
        """Raise `OvertakenError` if the request was cancelled."""
        if self.overtaken.is_set():
            raise OvertakenError


class Computations:
    """Queue of computations on a device, in order of arrival."""

    def __init__(self, compute: Compute) -> None:
        self._compute = compute
        self._waiting: list[Request] = []
        self._turn = threading.Condition()

    def run(self, request: Request, body: dict[str, Any], progress: Progress) -> Answer:
        """Wait for the device, then compute."""
        with self._turn:
            for other in self._waiting:
                if other.channel == request.channel:
                    other.overtaken.set()
            if len(self._waiting) >= MAX_WAITING:
                raise BusyError(_BUSY)
            self._waiting.append(request)
            self._turn.notify_all()
        try:
            while not self._has_turn(request):
                progress(0.0, "Waiting for the device")
            request.check()

            def report(fraction: float, what: str) -> None:
                request.check()
                progress(fraction, what)

            return self._compute(body, report)
        finally:
            with self._turn:
                self._waiting.remove(request)
                self._turn.notify_all()

    def _has_turn(self, request: Request) -> bool:
        """Wait for a moment; return True if the request is next or cancelled."""
        with self._turn:
            return self._turn.wait_for(
                lambda: request.overtaken.is_set() or self._waiting[0] is request, _WAIT
            )

    def end(self) -> None:
        """Cancel all waiting and running requests."""
        with self._turn:
            for request in self._waiting:
                request.overtaken.set()
            self._turn.notify_all()


def sentence_of(error: Exception) -> str:
    """Return the message of an error for a page; log unexpected errors with their traceback."""
    opencl = sys.modules.get("pyopencl")
    expected = [ClplenError, ValueError, OSError, MemoryError, BusyError]
    if opencl is not None:
        expected.append(opencl.Error)
    if isinstance(error, tuple(expected)):
        lines = str(error).splitlines()
        return lines[0] if lines else f"The computation failed ({type(error).__name__})."
    logger.debug("a computation of the viewer failed", exc_info=error)
    return f"The computation failed ({type(error).__name__})."
