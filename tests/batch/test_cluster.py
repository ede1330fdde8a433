"""Workers: processes of this computer and of a Dask cluster."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import batchworks
import numpy as np
import pytest

from clplen import __version__
from clplen.batch import Job
from clplen.batch.cluster import Cluster, check_workers, require_dask, workers_here, workers_of
from clplen.batch.runner import run_job
from clplen.batch.task import Report
from clplen.compute.device import Device
from clplen.errors import DeviceError, FormatError

pytest.importorskip("distributed", reason="the extra batch is not installed")
pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning"
)


class Watcher:
    """Does something when reports come."""

    def __init__(self, act: Any = None) -> None:
        self.reports: list[Report] = []
        self._act = act

    def begin(self, *, total: int, skipped: int) -> None:
        pass

    def report(self, report: Report) -> None:
        self.reports.append(report)
        if self._act is not None:
            self._act(self.reports)


def test_two_workers_and_one_that_is_killed(tmp_path: Path, device: Device):
    """Everything right and once, each worker on cores of its own, a lost item done again."""
    files = batchworks.write_inputs(tmp_path / "in", 24)
    job = Job.read(batchworks.write_job(tmp_path))
    killed: list[int] = []

    def kill(reports: list[Report]) -> None:
        if len(reports) == 4:
            killed.append(int(reports[-1].worker.rpartition(":")[2]))
            os.kill(killed[0], signal.SIGKILL)

    watcher = Watcher(kill)
    executor = partial(workers_here, workers=2, devices=[device.place], memory=None, retries=2)
    summary = run_job(job, executor, watcher=watcher)
    assert (summary.done, summary.failed) == (24, {})
    assert batchworks.wrong_outputs(tmp_path / "out", files, device) == []
    assert batchworks.strays(tmp_path / "out") == []
    assert sorted(report.name for report in watcher.reports) == [file.stem for file in files]
    workers = {report.worker for report in watcher.reports}
    assert len(workers) >= 2
    assert killed


def test_a_scheduler_that_does_not_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("clplen.batch.cluster._ANSWER", 0.5)
    with (
        pytest.raises(DeviceError, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:9 "),
        workers_of(tmp_path, scheduler="tcp://127.0.0.1:9", memory=None),
    ):
        pass


@pytest.mark.parametrize("address", ["nowhere", "tcp://", "carrier-pigeon://a:1"])
def test_an_address_that_is_none(tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("clplen.batch.cluster._ANSWER", 0.5)
    with (
        pytest.raises(DeviceError, match="No Dask scheduler answers at"),
        workers_of(tmp_path, scheduler=address, memory=None),
    ):
        pass


class Client:
    """Answers as a client of Dask does."""

    def __init__(self, found: dict[str, Any]) -> None:
        self._found = found

    def wait_for_workers(self, count: int, timeout: float) -> None:
        if len(self._found) < count:
            raise TimeoutError

    def run(self, work: Any, on_error: str) -> dict[str, Any]:
        return self._found


GOOD = {"version": __version__, "host": "h", "error": ""}


@pytest.mark.parametrize(
    ("found", "said"),
    [
        ({}, "has no workers: start some with 'clplen worker tcp://x'"),
        ({"a": {**GOOD, "version": "0.0.1"}, "b": GOOD}, "1 workers .*a has clplen 0.0.1, this is"),
        ({"a": {**GOOD, "error": "none"}}, r"a has no OpenCL device \(none\)"),
        ({"a": ModuleNotFoundError("No module named 'clplen'")}, "a has no clplen that answers"),
    ],
)
def test_workers_that_cannot_do_it(found: dict[str, Any], said: str):
    with pytest.raises(DeviceError, match=said):
        check_workers(Client(found), "tcp://x")
    found = {"a": GOOD, "b": GOOD, "c": {**GOOD, "host": "i"}}
    assert check_workers(Client(found), "tcp://x") == 2


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(FormatError, match=r'pip install "clplen\[batch\]"'):
        require_dask()


class Future:
    """A task that ends at once."""

    def __init__(self, key: str, status: str) -> None:
        self.key, self.status = key, status

    def exception(self) -> Exception:
        return ValueError("it has another version")


def test_a_scheduler_that_is_lost_is_said(tmp_path: Path):
    cluster = Cluster(None, tmp_path, memory=None, sharing=1)
    np.save(tmp_path / "a.npy", np.ones((2, 2, 9, 9)))
    from clplen.batch.items import tasks_of

    (task,) = tasks_of(Job(output="o", inputs=[{"files": "*"}], stack={}).within(tmp_path))
    for status in ("cancelled", "lost"):
        with pytest.raises(DeviceError, match=r"no longer answers: .* what is done stays done"):
            cluster._report(task, Future("k", status))
    report = cluster._report(task, Future("k", "error"))
    assert report.state == "failed"
    assert "it has another version" in report.error


def test_threads_end(tmp_path: Path, device: Device):
    """Nothing of a cluster is left."""
    before = {thread.name for thread in threading.enumerate()}
    (tmp_path / "in").mkdir()
    np.save(tmp_path / "in" / "a.npy", np.ones((2, 2, 20, 20), np.uint8))
    job = Job(output="o", inputs=[{"files": "in/*"}], stack={"disparities": [0.0]})
    executor = partial(workers_here, workers=2, devices=[device.place], memory=10**8, retries=0)
    assert run_job(job.within(tmp_path), executor, watcher=Watcher()).is_good
    time.sleep(0.2)
    after = {thread.name for thread in threading.enumerate()}
    assert not {name for name in after - before if "lane" in name}
