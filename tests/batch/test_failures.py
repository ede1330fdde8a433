"""What fails: disks, inputs, folders, bugs; each alone, with one sentence."""

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
from batchworks import Watcher, run

from clplen.batch import Job
from clplen.batch.jobs.items import tasks_of
from clplen.batch.jobs.task import Report
from clplen.batch.running.job import local_executor
from clplen.batch.running.manifest import Manifest, status_of
from clplen.batch.running.runner import execute_job, plan_tasks
from clplen.batch.work import products as making
from clplen.batch.work.execution import execute_task
from clplen.batch.work.resources import Resources
from clplen.compute.device import Device


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


def test_files_of_others_in_the_output_stay(small: tuple[Path, list[Path]], device: Device):
    job, _ = small
    run(job, device)
    folder = job.parent / "out" / "field_001"
    name = sorted(path.name for path in folder.glob("*.tif"))[0]
    (folder / name).write_text("notes of the user")
    (folder / "item.json").unlink()
    summary, _ = run(job, device)
    assert summary.failed.keys() == {"field_001"}
    assert f"{name} exists and was not written by clplen" in summary.failed["field_001"]
    assert (folder / name).read_text() == "notes of the user"


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
    made = making._light_field_products

    def slow(*given: Any) -> Any:
        os.utime(files[0], ns=(time.time_ns(), time.time_ns()))
        return made(*given)

    monkeypatch.setattr(making, "_light_field_products", slow)
    for file in files[1:]:
        file.unlink()
    summary, _ = run(job, device)
    assert "changed while it was read" in summary.failed["field_000"]


@pytest.mark.thorough
def test_an_output_folder_that_vanishes(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    job, files = small
    out = job.parent / "out"
    made, aside = making._light_field_products, job.parent / "aside"

    def vanishing(*given: Any) -> Any:
        if not aside.exists() and list(out.glob("*/item.json")):
            out.rename(aside)
        return made(*given)

    monkeypatch.setattr(making, "_light_field_products", vanishing)
    summary, _ = run(job, device)
    assert summary.done + len(summary.failed) == 6
    assert len(summary.failed) >= 1  # what was done before
    assert summary.unsaved == ""
    for said in summary.failed.values():
        assert "Cannot write" in said or "vanished" in said
    whole = [file for file in files if file.stem not in summary.failed]
    assert batchworks.wrong_outputs(out, whole, device) == []
    monkeypatch.undo()
    run(job, device)
    assert batchworks.wrong_outputs(out, files, device) == []


def test_what_may_pass_is_tried_again(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    job, _ = small
    made, calls = making._light_field_products, []

    def failing(*given: Any) -> Any:
        calls.append(1)
        if len(calls) in (2, 3):
            raise OSError(5, "Input/output error")
        return made(*given)

    monkeypatch.setattr(making, "_light_field_products", failing)
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
    resources = Resources(selector=device.place, memory=None)
    report = execute_task(task, resources)
    path = job.parent / "out" / task.name / "stack.ome.tif"
    inode = path.stat().st_ino
    assert execute_task(task, resources) == report
    assert path.stat().st_ino == inode
    path.unlink()
    assert execute_task(task, resources).started > report.started


_STAMP = {"bytes": 4, "sha256": "00"}
_DAMAGES: tuple[Any, ...] = (
    *("", "[]", "{}", "\0", {"outputs": {"a": 1}}, {"inputs": {"in/a": {}}}),
    *("[" * 100_000, '{"settings": {"a": ' * 5000, "9" * 10_000),
    {"outputs": {}},
    {"outputs": ["stack.ome.tif"]},
    {"outputs": {"stack.ome.tif": {"bytes": "4", "sha256": "00"}}},
    {"outputs": {"stack.ome.tif": {"bytes": 4.0, "sha256": "00"}}},
    {"outputs": {"stack.ome.tif": {"bytes": 4, "sha256": []}}},
    {"outputs": {"x" * 5000: _STAMP}},
    {"inputs": {"in/field_000.h5": _STAMP | {"changed": 10**400}}},
    *({"seconds": "x"}, {"seconds": {"total": "x"}}, {"seconds": {"total": float("inf")}}),
    *({"started": "x"}, {"started": None}, {"started": float("nan")}, {"started": 10**400}),
    *({"name": "field_001"}, {"name": 3}, {"state": "failed"}, {"state": ["done"]}),
    *({"worker": "\ud800"}, {"error": {}}, {"passing": 1}, {"unknown": 1}),
    {"settings": {"a": json.loads("[" * 100 + "]" * 100)}},
)


def test_every_damage_of_a_record_is_found(small: tuple[Path, list[Path]], device: Device):
    """It neither ends the run nor counts as done."""
    job, files = small
    for file in files[2:]:
        file.unlink()
    run(job, device)
    record = job.parent / "out" / "field_000" / "item.json"
    known = json.loads(record.read_text())
    for content in _DAMAGES:
        damaged = content if isinstance(content, str) else json.dumps(known | content)
        record.write_text(damaged)
        found = [state for _, state, _ in status_of(Job.read(job))]
        assert found == ["damaged", "done"], damaged[:200]
        assert len(plan_tasks(tasks_of(Job.read(job))).todo) == 1
    summary, _ = run(job, device)
    assert (summary.done, summary.skipped, summary.failed) == (1, 1, {})


def test_a_record_deletes_nothing_of_others(small: tuple[Path, list[Path]], device: Device):
    """Whoever wrote it: it names files of clplen in the folder of its item."""
    job, files = small
    for file in files[2:]:
        file.unlink()
    run(job, device)
    out, folder = job.parent / "out", job.parent / "folder"
    folder.mkdir()
    own = out / "field_000"
    kept = [job.parent / "a.txt", out / "b.txt", out / "field_001" / "c.txt", own / "d.txt"]
    kept += [folder / "e.txt", job.parent / "ours.txt"]
    for path in kept:
        path.write_text("precious")
    kept[-1].write_text("precious, Written by clplen")
    before = [path.read_text() for path in kept]
    record = own / "item.json"
    known = json.loads(record.read_text())
    names = ["../../a.txt", "../b.txt", "../field_001/c.txt", "../../folder", "..", "."]
    names += ["", "a/../../b.txt", str(kept[0]), str(folder), "../../ours.txt", "a\0b"]
    for listed in (names, ["d.txt"]):
        record.write_text(json.dumps(known | {"outputs": dict.fromkeys(listed, _STAMP)}))
        assert [state for _, state, _ in status_of(Job.read(job))] == ["damaged", "done"]
        assert run(job, device)[0].done == 1
        assert [path.read_text() for path in kept] == before


def test_what_another_job_made_goes(small: tuple[Path, list[Path]], device: Device):
    """Unless others changed it meanwhile."""
    job, files = small
    for file in files[2:]:
        file.unlink()
    run(job, device)
    out = job.parent / "out"
    (out / "field_001" / "depth.ome.tif").write_text("notes of the user")
    job.write_text(job.read_text().replace('[depth]\ndisparities = "-1:1:5"\ncue = "energy"', ""))
    assert run(job, device, force=True)[0].done == 2
    left = sorted(str(path.relative_to(out)) for path in out.glob("*/depth*"))
    assert left == [os.path.join("field_001", "depth.ome.tif")]


@pytest.mark.skipif(os.name != "posix", reason="pipes and links are those of POSIX")
def test_a_record_or_lock_that_is_no_file(small: tuple[Path, list[Path]], device: Device):
    """A pipe, which would be waited for, and a link to a file of others."""
    job, files = small
    for file in files[1:]:
        file.unlink()
    run(job, device)
    out = job.parent / "out"
    record, holder = out / "field_000" / "item.json", out / ".clplen" / "job.holder"
    record.unlink()
    os.mkfifo(record)
    (job.parent / "notes.txt").write_text("precious")
    holder.unlink()
    holder.symlink_to(job.parent / "notes.txt")
    assert [state for _, state, _ in status_of(Job.read(job))] == ["damaged"]
    assert run(job, device)[0].done == 1
    assert record.is_file()
    assert (job.parent / "notes.txt").read_text() == "precious"


def test_links_that_lead_nowhere(small: tuple[Path, list[Path]], device: Device):
    """Of an input, and of an item's folder: the status says what the run said."""
    job, files = small
    for file in files[1:]:
        file.unlink()
    try:
        (job.parent / "in" / "gone.npy").symlink_to("nowhere")
        (job.parent / "out").mkdir()
        (job.parent / "out" / files[0].stem).symlink_to("nowhere")
    except OSError:
        pytest.skip("no links can be made here")
    summary, _ = run(job, device)
    assert summary.failed.keys() == {"field_000", "gone"}
    found = {name: (state, why) for name, state, why in status_of(Job.read(job))}
    assert found == {name: ("failed", said) for name, said in summary.failed.items()}


def test_a_bug_stops_one_item(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    job, _ = small
    made, calls = making._light_field_products, []

    def failing(*given: Any) -> Any:
        calls.append(1)
        if len(calls) == 2:
            raise KeyError("what")
        return made(*given)

    monkeypatch.setattr(making, "_light_field_products", failing)
    summary, _ = run(job, device)
    assert summary.done == 5
    assert "unexpected KeyError" in next(iter(summary.failed.values()))


def test_an_interrupt_leaves_nothing_half_done(small: tuple[Path, list[Path]], device: Device):
    job, files = small
    watcher = Watcher()

    def interrupt(report: Report) -> None:
        raise KeyboardInterrupt

    watcher.report = interrupt  # type: ignore[method-assign]
    executor = partial(local_executor, selector=device.place, memory=None)
    with pytest.raises(KeyboardInterrupt):
        execute_job(Job.read(job), executor, watcher=watcher)
    out = job.parent / "out"
    assert batchworks.strays(out) == []
    with Manifest(out) as manifest:
        assert len(manifest.states()) == 1  # what was reported before
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
        summary, _ = run(job.relative_to(tmp_path), device)
        out = disk / "out"
        assert summary.done >= 3
        assert summary.failed
        for said in summary.failed.values():
            assert "No space left on device" in said or "free some space" in said
        assert batchworks.strays(out) == []
        for i, side in ((0, 32), (2, 40), (4, 36)):
            picture = tifffile.imread(out / f"field_{i}" / "stack.ome.tif")
            assert np.array_equal(picture, np.full((side, side), i + 1, np.float32))
        with Manifest(out) as manifest:
            assert len(manifest.states()) == 5
    finally:
        subprocess.run(["umount", str(disk)], check=True)
