"""A job in one process: right, once, and again only what has to be."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import time
from functools import partial
from pathlib import Path
from typing import Any

import batchworks
import numpy as np
import pytest
import tifffile

from clplen.batch import Job
from clplen.batch import products as making
from clplen.batch.check import state_of
from clplen.batch.items import tasks_of
from clplen.batch.local import here
from clplen.batch.manifest import Manifest
from clplen.batch.runner import Summary, run_job, status_of
from clplen.batch.task import Report
from clplen.batch.work import perform
from clplen.batch.workshop import Workshop
from clplen.compute.device import Device
from clplen.errors import DeviceError, FormatError


class Watcher:
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.reports: list[Report] = []
        self.skipped = -1

    def begin(self, *, total: int, skipped: int) -> None:
        self.skipped = skipped

    def report(self, report: Report) -> None:
        self.reports.append(report)

    def running(self, name: str, done: int, total: int) -> None:
        pass


def run(job: Job | Path, device: Device, **how: Any) -> tuple[Summary, Watcher]:
    """Run a job in this process."""
    watcher = Watcher()
    executor = partial(here, selector=device.place, memory=how.pop("memory", None))
    chosen = job if isinstance(job, Job) else Job.read(job)
    return run_job(chosen, executor, watcher=watcher, **how), watcher


@pytest.fixture
def small(tmp_path: Path) -> tuple[Path, list[Path]]:
    """A job over six small light fields."""
    files = batchworks.write_inputs(tmp_path / "in", 6)
    return batchworks.write_job(tmp_path), files


def test_outputs_are_those_in_core(small: tuple[Path, list[Path]], device: Device):
    job, files = small
    summary, watcher = run(job, device)
    assert (summary.done, summary.skipped, summary.failed) == (6, 0, {})
    out = job.parent / "out"
    assert batchworks.wrong_outputs(out, files, device) == []
    assert batchworks.strays(out) == []
    assert sorted(report.name for report in watcher.reports) == [file.stem for file in files]
    for report in watcher.reports:
        assert {"read", "compute", "write", "digest", "total"} <= report.seconds.keys()
    assert [state for _, state, _ in status_of(Job.read(job), verify=True)] == ["done"] * 6


def test_only_what_is_missing_changed_or_failed_is_done_again(
    small: tuple[Path, list[Path]], device: Device
):
    job, files = small
    out = job.parent / "out"
    files[5].rename(job.parent / "aside")
    files[5].write_bytes(b"no light field")
    summary, _ = run(job, device)
    assert list(summary.failed) == ["field_005"]
    (job.parent / "aside").replace(files[5])  # failed before, good now
    os.utime(files[0])  # looked at, and the same
    np.save(files[1], np.load(files[1])[::-1])  # changed
    (out / "field_002" / "stack.ome.tif").unlink()  # missing
    states = {task.name: state for task, state, _ in status_of(Job.read(job))}
    assert [states[file.stem] for file in files] == [
        "done",
        "changed",
        "damaged",
        "done",
        "done",
        "failed",
    ]
    before = {path: path.stat().st_ino for path in out.glob("*/*")}
    summary, watcher = run(job, device)
    assert sorted(report.name for report in watcher.reports) == [
        "field_001",
        "field_002",
        "field_005",
    ]
    assert (summary.done, summary.skipped) == (3, 3)
    assert batchworks.wrong_outputs(out, files, device) == []
    again = {path.parent.name for path, inode in before.items() if path.stat().st_ino != inode}
    assert again == {"field_001", "field_002"}
    assert run(job, device)[0].skipped == 6


def test_digests_find_what_size_and_time_do_not(small: tuple[Path, list[Path]], device: Device):
    job, files = small
    run(job, device)
    path = job.parent / "out" / "field_003" / "stack.ome.tif"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    stat = files[1].stat()
    changed = bytearray(files[1].read_bytes())
    changed[-1] ^= 1
    files[1].write_bytes(changed)
    os.utime(files[1], ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert {state for _, state, _ in status_of(Job.read(job))} == {"done"}
    found = {task.name: state for task, state, _ in status_of(Job.read(job), verify=True)}
    assert found["field_003"] == "damaged"
    assert found["field_001"] == "changed"
    assert list(found.values()).count("done") == 4


def test_a_job_that_was_changed(small: tuple[Path, list[Path]], device: Device):
    job, _ = small
    run(job, device)
    out = job.parent / "out"
    text = job.read_text().replace("[all_in_focus]", "")
    job.write_text(text)
    with pytest.raises(FormatError, match=r"all_in_focus was \{\}, is not there.*--force"):
        run(job, device)
    assert (out / "field_000" / "all_in_focus.ome.tif").exists()
    summary, _ = run(job, device, force=True)
    assert summary.done == 6
    assert not (out / "field_000" / "all_in_focus.ome.tif").exists()
    job.write_text(f"workers = 1\nretries = 3\nmemory = '1 GiB'\n{text}")
    assert run(job, device)[0].skipped == 6


def test_more_inputs_are_no_other_job(small: tuple[Path, list[Path]], device: Device):
    job, _ = small
    run(job, device)
    np.save(job.parent / "in" / "new.npy", np.ones((3, 3, 20, 20), np.uint8))
    summary, _ = run(job, device)
    assert (summary.done, summary.skipped) == (1, 6)


def test_what_a_dead_process_did_is_found(small: tuple[Path, list[Path]], device: Device):
    """Records beside the results count although the manifest was lost."""
    job, _ = small
    run(job, device)
    (job.parent / "out" / "manifest.sqlite").unlink()
    summary, _ = run(job, device)
    assert (summary.done, summary.skipped) == (0, 6)
    with Manifest(job.parent / "out") as manifest:
        assert len(manifest.known()) == 6


def test_bad_inputs_fail_alone(small: tuple[Path, list[Path]], device: Device):
    job, files = small
    whole = files[1].read_bytes()
    files[1].write_bytes(whole[: len(whole) // 2])
    values = np.load(files[5])
    assert values.dtype == np.float32
    values[1, 1, 5, 5] = np.nan
    np.save(files[5], values)
    files[2].write_bytes(b"")
    summary, _ = run(job, device)
    assert summary.done == 3
    assert summary.failed.keys() == {"field_001", "field_002", "field_005"}
    for name, said in summary.failed.items():
        assert name in said
        assert "\n" not in said
    assert "truncated" in summary.failed["field_001"]
    assert "is empty" in summary.failed["field_002"]
    assert "1 samples that are NaN" in summary.failed["field_005"]
    out = job.parent / "out"
    assert not list((out / "field_005").glob("*.tif"))
    assert batchworks.strays(out) == []


def test_an_input_that_cannot_be_read(small: tuple[Path, list[Path]], device: Device):
    if os.getuid() == 0:
        pytest.skip("root may read everything")
    job, files = small
    files[0].chmod(0)
    summary, _ = run(job, device)
    assert summary.done == 5
    assert "Permission denied" in summary.failed["field_000"]


def test_an_input_that_changes_meanwhile(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    job, files = small
    in_core = making._in_core

    def slow(lf: Any, work: Any) -> Any:
        os.utime(files[0], ns=(time.time_ns(), time.time_ns()))
        return in_core(lf, work)

    monkeypatch.setattr(making, "_in_core", slow)
    for file in files[1:]:
        file.unlink()
    summary, _ = run(job, device)
    assert "was changed while it was read" in summary.failed["field_000"]


def test_an_output_folder_that_vanishes(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    job, files = small
    out = job.parent / "out"
    in_core, aside = making._in_core, job.parent / "aside"

    def vanishing(lf: Any, work: Any) -> Any:
        if not aside.exists() and list(out.glob("*/item.json")):
            out.rename(aside)
        return in_core(lf, work)

    monkeypatch.setattr(making, "_in_core", vanishing)
    summary, _ = run(job, device)
    assert summary.done + len(summary.failed) == 6
    assert len(summary.failed) >= 1  # what was done before
    assert summary.unsaved == ""
    for said in summary.failed.values():
        assert "cannot be written" in said or "vanished" in said
    whole = [file for file in files if file.stem not in summary.failed]
    assert batchworks.wrong_outputs(out, whole, device) == []
    monkeypatch.undo()
    run(job, device)
    assert batchworks.wrong_outputs(out, files, device) == []


def test_what_may_pass_is_tried_again(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    job, _ = small
    in_core, calls = making._in_core, []

    def failing(lf: Any, work: Any) -> Any:
        calls.append(1)
        if len(calls) in (2, 3):
            raise OSError(5, "Input/output error")
        return in_core(lf, work)

    monkeypatch.setattr(making, "_in_core", failing)
    summary, watcher = run(job, device)
    assert (summary.done, summary.failed) == (6, {})
    assert len(watcher.reports) == 6
    assert len(calls) == 8


def test_what_does_not_pass_is_not_tried_again(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    """A full disk, also where it is said in other words."""
    job, _ = small
    calls = []

    def full(*_: Any, **__: Any) -> None:
        calls.append(1)
        try:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise OSError("out.tif cannot be written: make room on the disk.") from error

    monkeypatch.setattr(making.io, "write_stack", full)
    summary, _ = run(job, device)
    assert set(summary.failed.values()) == {"out.tif cannot be written: make room on the disk."}
    assert len(calls) == len(summary.failed) == 6


def test_what_was_done_by_a_worker_that_was_lost_is_not_done_again(
    small: tuple[Path, list[Path]], device: Device
):
    """Its record is there, its report never came."""
    job, _ = small
    task = tasks_of(Job.read(job))[0]
    shop = Workshop(job.parent / "out", selector=device.place, memory=None)
    report = perform(task, shop)
    path = job.parent / "out" / task.name / "stack.ome.tif"
    inode = path.stat().st_ino
    assert perform(task, shop) == report
    assert path.stat().st_ino == inode
    path.unlink()
    assert perform(task, shop).started > report.started
    shop.close()


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", "\0", {"outputs": {"a": 1}}, {"inputs": {"in/a": {}}}]
)
def test_a_damaged_record_is_none(small: tuple[Path, list[Path]], device: Device, content: Any):
    job, files = small
    for file in files[1:]:
        file.unlink()
    run(job, device)
    record = job.parent / "out" / "field_000" / "item.json"
    if isinstance(content, dict):
        content = json.dumps(json.loads(record.read_text()) | content)
    record.write_text(content)
    assert [state for _, state, _ in status_of(Job.read(job))] == ["damaged"]
    assert run(job, device)[0].done == 1


def test_the_manifest_is_not_written_for_each_item(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    """Each writing waits for the disk, which takes longer than a small item."""
    job, _ = small
    puts, put = [], Manifest.put

    def counted(manifest: Manifest, *reports: Report) -> None:
        puts.append(len(reports))
        put(manifest, *reports)

    monkeypatch.setattr(Manifest, "put", counted)
    monkeypatch.setattr("clplen.batch.runner._SAVE", 1e3)
    run(job, device)
    assert puts == [0, 6]
    with Manifest(job.parent / "out") as manifest:
        assert len(manifest.known()) == 6


def test_temporary_files_of_the_output_are_removed(small: tuple[Path, list[Path]], device: Device):
    job, _ = small
    out = job.parent / "out"
    out.mkdir()
    (out / ".probe-0123456789ab.partial").touch()
    run(job, device)
    assert not list(out.glob(".probe*"))


def test_a_job_is_run_from_python(small: tuple[Path, list[Path]], device: Device):
    path, files = small
    job = Job.read(path)
    summary = job.run(device=device.place, memory="1 GiB")
    assert (summary.done, summary.is_good) == (6, True)
    assert batchworks.wrong_outputs(path.parent / "out", files, device) == []
    watcher = Watcher()
    assert job.run(device=device.place, watcher=watcher).skipped == watcher.skipped == 6
    with pytest.raises(DeviceError, match="No OpenCL device fits 'none such'"):
        Job(output="new", inputs=[{"files": "in/*"}], stack={}).within(path.parent).run(
            device="none such"
        )


def test_a_bug_stops_one_item(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    job, _ = small
    in_core, calls = making._in_core, []

    def failing(lf: Any, work: Any) -> Any:
        calls.append(1)
        if len(calls) == 2:
            raise KeyError("what")
        return in_core(lf, work)

    monkeypatch.setattr(making, "_in_core", failing)
    summary, _ = run(job, device)
    assert summary.done == 5
    assert "unexpected KeyError" in next(iter(summary.failed.values()))


def test_an_interrupt_leaves_nothing_half_done(small: tuple[Path, list[Path]], device: Device):
    job, files = small
    watcher = Watcher()

    def interrupt(report: Report) -> None:
        raise KeyboardInterrupt

    watcher.report = interrupt  # type: ignore[method-assign]
    executor = partial(here, selector=device.place, memory=None)
    with pytest.raises(KeyboardInterrupt):
        run_job(Job.read(job), executor, watcher=watcher)
    out = job.parent / "out"
    assert batchworks.strays(out) == []
    with Manifest(out) as manifest:
        assert len(manifest.known()) == 1  # what was reported before
    summary, _ = run(job, device)
    assert summary.skipped >= 1
    assert batchworks.wrong_outputs(out, files, device) == []


def test_a_full_disk(tmp_path: Path, device: Device):
    """A small file system in memory; the items that find no room fail, the others are right."""
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("no file system can be mounted here (not root)")
    try:
        folder = tmp_path / "in"
        folder.mkdir()
        for i, side in enumerate((32, 400, 40, 420, 36)):
            np.save(folder / f"field_{i}.npy", np.full((2, 2, side, side), i + 1, np.uint8))
        job = Job(output=str(disk / "out"), inputs=[{"files": "in/*"}], stack={"disparities": [0]})
        summary, _ = run(job.within(tmp_path), device)
        out = disk / "out"
        assert summary.done >= 3
        assert summary.failed
        for said in summary.failed.values():
            assert "No space left on device" in said or "make room" in said
        assert batchworks.strays(out) == []
        for i, side in ((0, 32), (2, 40), (4, 36)):
            picture = tifffile.imread(out / f"field_{i}" / "stack.ome.tif")
            assert np.array_equal(picture, np.full((side, side), i + 1, np.float32))
        with Manifest(out) as manifest:
            assert len(manifest.known()) == 5
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_all_kinds_of_work(tmp_path: Path, device: Device):
    """Views, light field and both formats, also where all of it is streamed."""
    zarr = pytest.importorskip("zarr", reason="the extra zarr is not installed")
    random = np.random.default_rng(3)
    values = random.integers(0, 255, (5, 4, 301, 257, 3), np.uint8)
    (tmp_path / "in").mkdir()
    np.save(tmp_path / "in" / "a.npy", values)
    words: dict[str, Any] = {
        "formats": ["ome-tiff", "ome-zarr"],
        "inputs": [{"files": "in/*", "layout": {"flip_v": True}}],
        "stack": {"disparities": [-1.0, 0.25, 1.5], "aperture": 3},
        "depth": {"disparities": [-1.0, 0.0, 1.0], "cue": "correspondence"},
        "all_in_focus": {},
        "views": {"at": [[0, 3], [1.5, 2.25]]},
    }
    core = Job(output="core", light_field={}, **words).within(tmp_path)
    assert run(core, device)[0].is_good
    streamed = Job(output="streamed", **words).within(tmp_path)
    summary, _ = run(streamed, device, memory=12_000_000)
    assert summary.failed == {}
    one, two = tmp_path / "core" / "a", tmp_path / "streamed" / "a"
    assert (one / "lightfield.h5").exists()
    names = ["stack", "depth", "all_in_focus", "view_0_3", "view_1.5_2.25"]
    for name in names:
        expected = tifffile.imread(one / f"{name}.ome.tif")
        assert np.array_equal(expected, tifffile.imread(two / f"{name}.ome.tif")), name
        stored = zarr.open_group(str(two / f"{name}.ome.zarr"), mode="r")["0"][...]
        if name != "depth":
            stored = np.moveaxis(stored, 0, -1)
        assert np.array_equal(stored, expected), name
    assert np.array_equal(
        tifffile.imread(one / "view_0_3.ome.tif"), values[::-1][0, 3].astype(np.float32)
    )


def test_what_is_missing_is_said(tmp_path: Path):
    (tmp_path / "in").mkdir()
    np.save(tmp_path / "in" / "a.npy", np.ones((2, 2, 8, 8), np.uint8))
    job = Job(output="o", inputs=[{"files": "in/*"}], stack={}).within(tmp_path)
    (task,) = tasks_of(job)
    assert state_of(task, None) == ("missing", "not done yet")
    with pytest.raises(FormatError, match="run the job first"):
        list(status_of(job))
