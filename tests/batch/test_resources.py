"""Locks, gates and memory that items share."""

from __future__ import annotations

import errno
import shutil
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from clplen.batch.running.worker import share_cores, usable_cores, worker_environment
from clplen.batch.work.locks import item_lock, job_lock
from clplen.batch.work.resources import MemoryBudget, Resources, StoppedError
from clplen.compute.device import Device

HOLD = """
import sys, time
from pathlib import Path
from clplen.batch.work.locks import item_lock, job_lock
folder = Path(sys.argv[1])
if sys.argv[2] == "job":
    lock = job_lock(folder)
else:
    lock = item_lock(folder, sys.argv[2])
with lock:
    print("held", flush=True)
    time.sleep(30)
"""


def holding(folder: Path, what: str) -> subprocess.Popen[str]:
    """Another process that holds a lock."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder), what], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_a_second_job_is_refused_until_the_first_dies(tmp_path: Path):
    process = holding(tmp_path, "job")
    try:
        with (
            pytest.raises(BlockingIOError, match=f"process {process.pid} on .* is using"),
            job_lock(tmp_path),
        ):
            pass
    finally:
        process.kill()
        process.wait()
        process.stdout.close()  # type: ignore[union-attr]
    with job_lock(tmp_path):
        pass


def test_an_item_is_waited_for(tmp_path: Path):
    process = holding(tmp_path, "one")
    try:
        with item_lock(tmp_path, "another"):
            pass
        checks: list[int] = []
        threading.Timer(0.3, process.kill).start()
        with item_lock(tmp_path, "one", check=lambda: checks.append(1)):
            assert checks
    finally:
        process.kill()
        process.wait()
        process.stdout.close()  # type: ignore[union-attr]


def test_who_waits_can_be_told_to_stop(tmp_path: Path):
    """Also while a process that hangs holds the item."""
    process = holding(tmp_path, "one")
    try:
        with pytest.raises(KeyError), item_lock(tmp_path, "one", check=lambda: {}["stop"]):
            pass
    finally:
        process.kill()
        process.wait()
        process.stdout.close()  # type: ignore[union-attr]


def test_an_item_is_held_by_one_thread(tmp_path: Path):
    """A worker may be given an item again while a run that ended still does it there."""
    inside, most = [0], [0]

    def visit() -> None:
        with item_lock(tmp_path, "one"):
            inside[0] += 1
            most[0] = max(most[0], inside[0])
            time.sleep(0.02)
            inside[0] -= 1

    threads = [threading.Thread(target=visit) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(5)
    assert most == [1]


def test_locks_in_a_folder_that_was_removed(tmp_path: Path):
    """Who opened them before and who did after exclude each other."""
    with item_lock(tmp_path / "out", "another"):
        pass
    shutil.rmtree(tmp_path / "out")
    process = holding(tmp_path / "out", "one")
    try:
        with pytest.raises(KeyError), item_lock(tmp_path / "out", "one", check=lambda: {}["held"]):
            pass
        with item_lock(tmp_path / "out", "another"):
            pass
    finally:
        process.kill()
        process.wait()
        process.stdout.close()  # type: ignore[union-attr]


@pytest.mark.parametrize("lock", [job_lock, partial(item_lock, name="one")])
def test_a_disk_without_locks_is_refused(lock: Any, tmp_path: Path, monkeypatch: Any):
    """Such as a network disk without a lock service."""

    def refuse(_: Any) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(FileLock, "_acquire", refuse)
    with pytest.raises(OSError, match=r"cannot be locked \(No locks available\)"), lock(tmp_path):
        pass


def test_room_is_given_in_turn():
    room, order = MemoryBudget(100), []

    def take(name: str, size: int, seconds: float) -> None:
        with room.of(size):
            order.append(name)
            time.sleep(seconds)

    threads = []
    for name, size, seconds in (("a", 60, 0.2), ("b", 80, 0.0), ("c", 10, 0.0), ("d", 500, 0.0)):
        threads.append(threading.Thread(target=take, args=(name, size, seconds)))
        threads[-1].start()
        time.sleep(0.05)
    for thread in threads:
        thread.join(5)
    assert order == ["a", "b", "c", "d"]  # c would fit beside a, but b came first
    with room.of(100):
        pass


def test_one_item_in_a_stage(device: Device):
    resources = Resources(selector=device.place, memory=1000)
    inside, most = [0], [0]

    def visit() -> None:
        with resources.stage("read", {}):
            inside[0] += 1
            most[0] = max(most[0], inside[0])
            time.sleep(0.01)
            inside[0] -= 1

    threads = [threading.Thread(target=visit) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1]
    seconds: dict[str, float] = {}
    with resources.stage("compute", seconds):
        time.sleep(0.02)
    assert seconds["compute"] >= 0.02
    resources.stop()
    with pytest.raises(StoppedError), resources.stage("read", {}):
        pass


def test_cores_are_shared_out():
    cores = usable_cores()
    for workers in range(1, len(cores) + 1):
        shares = [share_cores(i, workers) for i in range(workers)]
        assert sorted(core for share in shares for core in share) == cores
        assert max(map(len, shares)) - min(map(len, shares)) <= 1
    assert len(share_cores(len(cores) + 3, 2 * len(cores) + 5)) == 1
    assert worker_environment([3, 5])["CLPLEN_CORES"] == "3,5"
    assert worker_environment([3, 5])["POCL_MAX_PTHREAD_COUNT"] == "2"
