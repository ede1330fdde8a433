"""Workers: processes of this computer and of a Dask cluster."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import batchworks
import numpy as np
import pytest

from clplen import __version__
from clplen.batch import Job
from clplen.batch.jobs.task import Report
from clplen.batch.running import cluster, runner
from clplen.batch.running import worker as dask_worker
from clplen.batch.running.cluster import (
    ClusterExecutor,
    check_workers,
    existing_cluster,
    local_cluster,
)
from clplen.batch.running.network import network_of, require_dask
from clplen.batch.running.runner import execute_job
from clplen.compute.device import Device
from clplen.errors import DeviceError, FormatError

pytest.importorskip("distributed", reason="the extra batch is not installed")
pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning"
)


class Watcher(runner.Watcher):
    """Does something when reports come."""

    def __init__(self, act: Any = None) -> None:
        self.reports: list[Report] = []
        self._act = act

    def report(self, report: Report) -> None:
        self.reports.append(report)
        if self._act is not None:
            self._act(self.reports)


@pytest.mark.thorough
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
    executor = partial(local_cluster, workers=2, devices=[device.place], memory=None, retries=2)
    summary = execute_job(job, executor, watcher=watcher)
    assert (summary.done, summary.failed) == (24, {})
    assert batchworks.wrong_outputs(tmp_path / "out", files, device) == []
    assert batchworks.strays(tmp_path / "out") == []
    assert sorted(report.name for report in watcher.reports) == [file.stem for file in files]
    workers = {report.worker for report in watcher.reports}
    assert len(workers) >= 2
    assert killed


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_an_item_that_kills_its_workers_fails_alone(tmp_path: Path, device: Device):
    """What was lost with it is done again."""
    files = batchworks.write_inputs(tmp_path / "in", 8)
    deadly = tmp_path / "deadly.py"
    deadly.write_text(
        "import os\n"
        "from clplen.batch.work import execution as work\n"
        "read = work.read\n"
        "def deadly(task, *rest):\n"
        "    if task.name == 'field_002':\n"
        "        os._exit(9)\n"
        "    return read(task, *rest)\n"
        "def dask_setup(worker):\n"
        "    work.read = deadly\n"
    )
    job = Job.read(batchworks.write_job(tmp_path))
    with pytest.MonkeyPatch.context() as patch:
        options = cluster._options

        def with_deadly(*words: Any) -> dict[str, Any]:
            known = options(*words)
            return known | {"preload": [*known["preload"], str(deadly)]}

        patch.setattr(cluster, "_options", with_deadly)
        executor = partial(local_cluster, workers=1, devices=[device.place], memory=None, retries=0)
        summary = execute_job(job, executor, watcher=Watcher())
    assert summary.done == 7
    assert summary.failed.keys() == {"field_002"}
    assert "its workers died" in summary.failed["field_002"]
    whole = [file for file in files if file.stem != "field_002"]
    assert batchworks.wrong_outputs(tmp_path / "out", whole, device) == []


@pytest.mark.thorough
def test_a_worker_without_a_device_is_refused(tmp_path: Path):
    """Before it fails one item after the other."""
    executor = local_cluster(tmp_path, workers=1, devices=["no such"], memory=None, retries=0)
    with pytest.raises(DeviceError, match=r"1 workers of this computer cannot.*No OpenCL device"):
        executor.__enter__()


class Counting:
    """A client whose workers come and go."""

    workers = 1

    def nthreads(self) -> dict[str, int]:
        return dict.fromkeys(map(str, range(self.workers)), 3)


def test_workers_that_join_late_get_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cluster, "_LOOK", 0.0)
    client = Counting()
    works = ClusterExecutor(client, tmp_path, memory=None, sharing=1)
    first = works._window()
    client.workers = 7
    assert works._window() == 7 * first
    client.workers = 0
    assert works._window() == first  # waits for others


class Worker:
    """Keeps attributes."""


def test_memory_is_that_of_the_latest_run(tmp_path: Path, device: Device, monkeypatch: Any):
    monkeypatch.setenv("CLPLEN_DEVICE", device.place)
    worker = Worker()
    how = {"run": "a", "folder": str(tmp_path), "memory": 5000, "sharing": 1}
    resources = dask_worker._resources_of(worker, how)
    assert dask_worker._resources_of(worker, how) is resources
    assert resources.memory == 5000
    again = dask_worker._resources_of(worker, how | {"run": "b", "memory": 7000})
    assert again is resources
    assert resources.memory == 7000
    one = dask_worker._resources_of(worker, how | {"run": "c", "memory": None}).memory
    half = dask_worker._resources_of(
        worker, how | {"run": "d", "memory": None, "sharing": 2}
    ).memory
    assert 0.4 * one < half < 0.6 * one  # free memory changes meanwhile


def test_a_scheduler_that_does_not_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("clplen.batch.running.cluster._ANSWER", 0.5)
    with (
        pytest.raises(DeviceError, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:9 "),
        existing_cluster(tmp_path, network=network_of("tcp://127.0.0.1:9"), memory=None),
    ):
        pass


def test_an_address_that_is_none(tmp_path: Path):
    for address in ("nowhere", "tcp://", "carrier-pigeon://a:1"):
        job = Job(output="o", scenes=[{"kind": "bars"}]).relative_to(tmp_path)
        with pytest.raises(DeviceError, match="No Dask scheduler answers at"):
            job.run(scheduler=address)


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


def test_workers_that_cannot_do_it():
    for found, said in (
        ({}, "has no workers: start them with 'clplen worker tcp://x'"),
        ({"a": {**GOOD, "version": "0.0.1"}, "b": GOOD}, "1 workers .*a has clplen 0.0.1, this is"),
        ({"a": {**GOOD, "error": "none"}}, r"a has no OpenCL device \(none\)"),
        ({"a": ModuleNotFoundError("No module named 'clplen'")}, "a has no working clplen"),
    ):
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
    works = ClusterExecutor(None, tmp_path, memory=None, sharing=1)
    np.save(tmp_path / "a.npy", np.ones((2, 2, 9, 9)))
    from clplen.batch.jobs.items import tasks_of

    (task,) = tasks_of(Job(output="o", inputs=[{"files": "*"}], stack={}).relative_to(tmp_path))
    for status in ("cancelled", "lost"):
        with pytest.raises(DeviceError, match=r"no longer answers: .* finished items are kept"):
            works._report(task, Future("k", status))
    report = works._report(task, Future("k", "error"))
    assert report.state == "failed"
    assert "it has another version" in report.error


class Scheduler:
    """A client whose scheduler answers, or does not."""

    status = "running"

    def __init__(self, answers: bool) -> None:
        self.answers = answers

    def nthreads(self) -> dict[str, int]:
        if not self.answers:
            raise OSError("the scheduler is gone")
        return {"worker": 1}


@pytest.mark.parametrize("answers", [True, False])
def test_what_a_living_scheduler_dropped_is_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answers: bool
):
    """As where a worker dies with results that were not fetched yet."""
    works = ClusterExecutor(Scheduler(answers), tmp_path, memory=None, sharing=1)
    states = {"a": iter(("cancelled", "error")), "b": iter(("error",))}
    asked: list[list[str]] = []

    def ended(tasks: Any, window: Any) -> Any:
        names = [task.name for task in tasks]
        asked.append(names)
        for name in names:
            yield SimpleNamespace(name=name, parameters={}), Future(name, next(states[name]))

    monkeypatch.setattr(works, "_completed", ended)
    tasks: Any = [SimpleNamespace(name=name) for name in ("a", "b")]
    if not answers:
        with pytest.raises(DeviceError, match="no longer answers"):
            list(works.run(tasks))
        return
    assert [report.name for report in works.run(tasks)] == ["b", "a"]
    assert asked == [["a", "b"], ["a"]]


@pytest.mark.thorough
def test_threads_end(tmp_path: Path, device: Device):
    """Nothing of a cluster is left."""
    before = {thread.name for thread in threading.enumerate()}
    (tmp_path / "in").mkdir()
    np.save(tmp_path / "in" / "a.npy", np.ones((2, 2, 20, 20), np.uint8))
    job = Job(output="o", inputs=[{"files": "in/*"}], stack={"disparities": [0.0]})
    executor = partial(local_cluster, workers=2, devices=[device.place], memory=10**8, retries=0)
    assert execute_job(job.relative_to(tmp_path), executor, watcher=Watcher()).is_good
    time.sleep(0.2)
    after = {thread.name for thread in threading.enumerate()}
    assert not {name for name in after - before if "lane" in name}
