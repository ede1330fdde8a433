"""``clplen batch`` and ``clplen worker`` on the command line."""

from __future__ import annotations

import json
import os
import signal
import socket
import socketserver
import subprocess
import sys
import threading
import time
from pathlib import Path

import batchworks
import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from command_line import invoke as clplen

from clplen.batch import Job
from clplen.batch.jobs.task import Report
from clplen.cli.batch import _Bar
from clplen.compute.device import Device


@pytest.fixture
def job(tmp_path: Path, device: Device) -> Path:
    """A job over four small light fields."""
    batchworks.write_inputs(tmp_path / "in", 4)
    return batchworks.write_job(tmp_path, more=f'device = "{device.place}"')


def test_a_job_from_end_to_end(job: Path, device: Device):
    before = clplen("batch", job, "--dry-run")
    assert before.exit_code == 0, before.output
    assert "4 items to do" in before.output
    assert "Time: about" in before.output
    assert not (job.parent / "out").exists()
    done = clplen("batch", job)
    assert done.exit_code == 0, done.output
    assert "4 items done; the results are in" in done.output
    assert clplen("batch", "status", job, "--verify").output == "4 items: 4 done.\n"
    again = clplen("batch", "run", job)
    assert "0 items done, 4 done before" in again.output
    nothing = clplen("batch", job, "--dry-run")
    assert "0 items to do (0 B to read, 0 B to write)" in nothing.output
    assert "Every item is done." in nothing.output


def test_a_failure_is_said_and_told_by_the_status(job: Path):
    (job.parent / "in" / "bad.npy").write_bytes(b"no array")
    done = clplen("batch", job)
    assert done.exit_code == 1
    assert "4 items done, 1 failed" in done.output
    assert "bad failed: " in done.output
    status = clplen("batch", "status", job)
    assert status.exit_code == 1
    assert "bad: failed: " in status.output
    assert "5 items: 4 done, 1 failed." in status.output


def test_a_damaged_file_of_a_series_is_done_alone_when_it_is_whole(job: Path):
    """The others are done the first time, in which one sentence names the damaged one."""
    files = sorted((job.parent / "in").iterdir())
    damaged, whole = files[1], files[1].read_bytes()
    damaged.write_bytes(whole[: len(whole) // 2])
    first = clplen("batch", job)
    assert first.exit_code == 1
    said = [line for line in first.output.splitlines() if "failed: " in line]
    assert len(said) == 1
    assert said[0].startswith(f"{damaged.stem} failed: ")
    assert str(damaged) in said[0]
    assert "Traceback" not in first.output
    made = {path: path.stat().st_ino for path in (job.parent / "out").glob("*/*")}
    assert {path.parent.name for path in made if path.suffix == ".tif"} == {
        file.stem for file in files if file != damaged
    }
    damaged.write_bytes(whole)
    again = clplen("batch", job)
    assert again.exit_code == 0, again.output
    assert "1 items done, 3 done before" in again.output
    assert {path: path.stat().st_ino for path in made} == made
    new = set((job.parent / "out").glob("*/*")) - set(made)
    assert {path.parent.name for path in new} == {damaged.stem}
    assert any(path.suffix == ".tif" for path in new)


def _write_views(folder: Path, *, missing: str = "") -> None:
    folder.mkdir(parents=True)
    random = np.random.default_rng(len(folder.name))
    for name in ("0_0", "0_1", "1_0", "1_1"):
        if name != missing:
            picture = random.integers(0, 255, (16, 16), np.uint8)
            imageio.imwrite(folder / f"view_{name}.png", picture)


def test_missing_views_are_allowed_without_repeating_the_other_items(tmp_path: Path):
    """The dry run names the key of a job file, and only the incomplete item is computed."""
    _write_views(tmp_path / "in" / "whole")
    _write_views(tmp_path / "in" / "incomplete", missing="1_0")
    job = batchworks.write_job(tmp_path)
    estimate = clplen("batch", job, "--dry-run").output
    assert "incomplete: fails: 1 of 2 x 2 views" in estimate
    assert "Give them weight 0 by allow_missing = true." in estimate
    assert "1 items done, 1 failed" in clplen("batch", job).output
    stack = tmp_path / "out" / "whole" / "stack.ome.tif"
    planes, inode = tifffile.imread(stack), stack.stat().st_ino
    job.write_text(
        job.read_text().replace('"in/*"\n', '"in/*"\nlayout = { allow_missing = true }\n')
    )
    again = clplen("batch", job, "--force")
    assert again.exit_code == 0, again.output
    assert "1 items done, 1 done before" in again.output
    assert clplen("batch", "status", job).output == "2 items: 2 done.\n"
    assert stack.stat().st_ino == inode
    fresh = tmp_path / "fresh.toml"
    fresh.write_text(job.read_text().replace('output = "out"', 'output = "fresh"'))
    assert clplen("batch", fresh).exit_code == 0
    fresh_planes = tifffile.imread(tmp_path / "fresh" / "whole" / "stack.ome.tif")
    assert np.array_equal(fresh_planes, planes)


def test_an_interrupt_reports_the_finished_items(job: Path, monkeypatch: pytest.MonkeyPatch):
    report = _Bar.report

    def interrupt(bar: _Bar, outcome: Report) -> None:
        report(bar, outcome)
        raise KeyboardInterrupt

    monkeypatch.setattr(_Bar, "report", interrupt)
    done = clplen("batch", job)
    assert done.exit_code == 130
    assert "1 of 4 items are done; the next run continues." in done.output
    monkeypatch.setattr(_Bar, "report", report)
    assert "done before" in clplen("batch", job).output


def test_wrong_words_get_one_sentence(job: Path, monkeypatch: pytest.MonkeyPatch):
    for arguments, said in (
        (["none.toml"], "There is no job file none.toml"),
        (["status", "none.toml"], "There is no job file none.toml"),
        (["JOB", "--memory", "lots"], "memory must be a whole number of bytes"),
        (["JOB", "--workers", "0"], "--workers"),
        (["status", "JOB"], "run the job first"),
        (["JOB", "--scheduler", "nowhere"], "No Dask scheduler answers at nowhere"),
    ):
        pytest.importorskip("distributed", reason="the extra batch is not installed")
        monkeypatch.setattr("clplen.batch.running.cluster._ANSWER", 0.5)
        done = clplen("batch", *(str(job) if word == "JOB" else word for word in arguments))
        assert done.exit_code in (1, 2)
        assert said in done.output
        assert "Traceback" not in done.output


def test_a_folder_without_a_name(tmp_path: Path):
    for files in ("/", ".", ".."):
        job = batchworks.write_job(tmp_path, files=files)
        done = clplen("batch", job)
        assert done.exit_code == 1
        assert "inputs.0.name: an item name must be a path" in done.output
        assert "give another name, such as name = 'views'" in done.output


def test_a_worker_without_a_scheduler(monkeypatch: pytest.MonkeyPatch):
    """A port that is closed, one that is silent, and one that speaks something else."""
    pytest.importorskip("distributed", reason="the extra batch is not installed")
    monkeypatch.setattr("clplen.batch.running.network._GREETING", 0.1)
    monkeypatch.setattr("clplen.batch.running.network.check_scheduler.__defaults__", (0.1,))
    monkeypatch.setattr("os.execve", lambda *_: pytest.fail("started"))

    class Other(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.sendall(b"SSH-2.0-OpenSSH_9.6\r\n")

    with (
        socket.create_server(("127.0.0.1", 0)) as silent,
        socketserver.TCPServer(("127.0.0.1", 0), Other) as other,
    ):
        thread = threading.Thread(target=other.serve_forever, args=(0.01,))
        thread.start()
        for port in (9, silent.getsockname()[1], other.server_address[1]):
            done = clplen("worker", f"tcp://127.0.0.1:{port}")
            assert done.exit_code == 1
            assert f"No Dask scheduler answers at tcp://127.0.0.1:{port} within" in done.output
        other.shutdown()
        thread.join()


def test_options_stand_above_the_file(job: Path, device: Device):
    done = clplen("batch", job, "--memory", "1 GiB", "--workers", "1", "--device", device.place)
    assert done.exit_code == 0, done.output


def test_without_dask_one_process_does_it(job: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    several = clplen("batch", job, "--workers", "2")
    assert several.exit_code == 1
    assert 'pip install "clplen[batch]"' in several.output
    assert clplen("batch", job).exit_code == 0
    worker = clplen("worker", "tcp://localhost:1")
    assert 'pip install "clplen[batch]"' in worker.output


@pytest.mark.thorough
def test_a_second_run_at_the_same_time_is_refused(tmp_path: Path, device: Device):
    """Nothing is done twice; the first goes on undisturbed, also when it is interrupted."""
    random = np.random.default_rng(1)
    (tmp_path / "in").mkdir()
    for i in range(40):
        np.save(
            tmp_path / "in" / f"f{i:02d}.npy", random.integers(0, 9, (7, 7, 160, 160), np.uint8)
        )
    path = tmp_path / "job.toml"
    path.write_text(
        f'output = "out"\ndevice = "{device.place}"\n[[inputs]]\nfiles = "in/*"\n'
        '[stack]\ndisparities = "-1:1:21"\n[depth]\n'
    )
    first = subprocess.Popen(
        [sys.executable, "-m", "clplen", "batch", str(path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        until = time.monotonic() + 60
        while not list((tmp_path / "out").glob("*/item.json")) and time.monotonic() < until:
            time.sleep(0.02)
        second = clplen("batch", path)
        assert second.exit_code == 1
        assert f"The process {first.pid} on" in second.output
        assert "is using" in second.output
        first.send_signal(signal.SIGINT)
        said, _ = first.communicate(timeout=60)
    finally:
        first.kill()
        first.wait()
    assert "Interrupted" in said
    assert first.returncode == 130
    assert "Traceback" not in said
    records = list((tmp_path / "out").glob("*/item.json"))
    assert 1 <= len(records) < 40
    assert [json.loads(record.read_text())["state"] for record in records] == ["done"] * len(
        records
    )
    assert [p for p in (tmp_path / "out").glob("*/*") if p.name.startswith(".")] == []
    assert Job.read(path).output == "out"
