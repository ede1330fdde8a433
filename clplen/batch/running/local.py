"""Items done in this process, three at a time, one in each stage."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from clplen.batch.jobs.task import Report, Task
from clplen.batch.work.execution import perform
from clplen.batch.work.resources import LANES, StoppedError, Workshop

Running = Callable[[str, int, int], None]


class Here:
    """Does tasks in threads of this process.

    Parameters
    ----------
    shop : Workshop
    running : callable, optional
        (name, done, all) of the parts of an item under way.
    lanes : int
        Items under way at a time.
    """

    def __init__(
        self, shop: Workshop, running: Running | None = None, *, lanes: int = LANES
    ) -> None:
        self._shop = shop
        self._lanes = lanes
        self._running = running

    def run(self, tasks: Iterable[Task]) -> Iterator[Report]:
        """Do tasks, each once, and give their reports as they come."""
        waiting: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        found: queue.SimpleQueue[Report | BaseException | None] = queue.SimpleQueue()
        for task in tasks:
            waiting.put(task)
        threads = [
            threading.Thread(target=self._lane, args=(waiting, found), name=f"lane-{i}")
            for i in range(self._lanes)
        ]
        for thread in threads:
            waiting.put(None)
            thread.start()
        try:
            yield from _reports(found, self._lanes)
        except BaseException:
            self._shop.stop()
            raise
        finally:
            for thread in threads:
                thread.join()

    def _lane(
        self,
        waiting: queue.SimpleQueue[Task | None],
        found: queue.SimpleQueue[Report | BaseException | None],
    ) -> None:
        try:
            while (task := waiting.get()) is not None:
                found.put(perform(task, self._shop, advance=partial(self._say, task.name)))
        except StoppedError:
            pass
        except BaseException as error:
            found.put(error)
        finally:
            found.put(None)

    def _say(self, name: str, done: int, total: int) -> None:
        self._shop.check()
        if self._running is not None:
            self._running(name, done, total)


def _reports(
    found: queue.SimpleQueue[Report | BaseException | None], lanes: int
) -> Iterator[Report]:
    ended = 0
    while ended < lanes:
        report = found.get()
        if report is None:
            ended += 1
        elif isinstance(report, BaseException):
            raise report
        else:
            yield report


@contextmanager
def here(
    folder: Path,
    *,
    selector: str | None,
    memory: int | None,
    running: Running | None = None,
    lanes: int = LANES,
) -> Iterator[Here]:
    """An executor in this process.

    Parameters
    ----------
    folder : pathlib.Path
        Of the job's output.
    selector : str or None
        As for `Device.open`.
    memory : int or None
        As in `Job`.
    running, lanes
        As for `Here`.
    """
    shop = Workshop(folder, selector=selector, memory=memory)
    try:
        yield Here(shop, running, lanes=lanes)
    finally:
        shop.close()
