"""A job in one process: right, once, and again only what has to be."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import batchworks
import numpy as np
import pytest
import tifffile
from batchworks import Watcher, run

from clplen import LightField, all_in_focus
from clplen.batch import Job
from clplen.batch.jobs.items import tasks_of
from clplen.batch.jobs.task import Report
from clplen.batch.running.manifest import Manifest, state_of, status_of
from clplen.compute.device import Device
from clplen.errors import DeviceError, FormatError


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
    states = {name: state for name, state, _ in status_of(Job.read(job))}
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
    found = {name: state for name, state, _ in status_of(Job.read(job), verify=True)}
    assert found["field_003"] == "damaged"
    assert found["field_001"] == "changed"
    assert list(found.values()).count("done") == 4


def test_a_job_that_was_changed(small: tuple[Path, list[Path]], device: Device):
    job, _ = small
    run(job, device)
    out = job.parent / "out"
    text = job.read_text().replace("[all_in_focus]", "")
    job.write_text(text)
    with pytest.raises(FormatError, match=r"all_in_focus was \{\}, is missing.*or force=True to"):
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
        assert len(manifest.states()) == 6


def test_the_manifest_is_not_written_for_each_item(
    small: tuple[Path, list[Path]], device: Device, monkeypatch: pytest.MonkeyPatch
):
    """Each writing waits for the disk, which takes longer than a small item."""
    job, _ = small
    puts, put = [], Manifest.put

    def count_states(manifest: Manifest, *reports: Report) -> None:
        puts.append(len(reports))
        put(manifest, *reports)

    monkeypatch.setattr(Manifest, "put", count_states)
    monkeypatch.setattr("clplen.batch.running.runner._SAVE", 1e3)
    run(job, device)
    assert puts == [0, 6]
    with Manifest(job.parent / "out") as manifest:
        assert len(manifest.states()) == 6


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
    with pytest.raises(DeviceError, match="No OpenCL device matches 'none such'"):
        Job(output="new", inputs=[{"files": "in/*"}], stack={}).relative_to(path.parent).run(
            device="none such"
        )


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
    core = Job(output="core", light_field={}, **words).relative_to(tmp_path)
    assert run(core, device)[0].is_good
    streamed = Job(output="streamed", **words).relative_to(tmp_path)
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
    job = Job(output="o", inputs=[{"files": "in/*"}], stack={}).relative_to(tmp_path)
    (task,) = tasks_of(job)
    assert state_of(task, None) == ("missing", "not processed yet")
    with pytest.raises(FormatError, match="run the job first"):
        list(status_of(job))


@pytest.mark.parametrize("channels", [1, 2, 4])
def test_other_channels_than_colours(tmp_path: Path, device: Device, channels: int):
    values = np.random.default_rng(1).random((3, 4, 30, 22, channels), np.float32)
    (tmp_path / "in").mkdir()
    np.save(tmp_path / "in" / "a.npy", values)
    planes = {"disparities": [-1.0, 0.0, 1.0]}
    job = Job(output="o", inputs=[{"files": "in/*"}], stack=planes, all_in_focus=planes, views={})
    summary, _ = run(job.relative_to(tmp_path), device)
    assert summary.failed == {}
    lf = LightField.from_array(values, device=device)
    found = tifffile.imread(tmp_path / "o" / "a" / "all_in_focus.ome.tif")
    expected = all_in_focus(lf, disparities=[-1.0, 0.0, 1.0]).to_numpy()
    assert np.array_equal(found.reshape(expected.shape), expected)


def test_results_may_be_moved(small: tuple[Path, list[Path]], device: Device):
    job, _ = small
    run(job, device)
    (job.parent / "out").rename(job.parent / "elsewhere")
    job.write_text(job.read_text().replace('output = "out"', 'output = "elsewhere"'))
    assert run(job, device)[0].skipped == 6


def test_a_job_of_which_nothing_was_done_may_change(small: tuple[Path, list[Path]], device: Device):
    job, files = small
    whole = {file: file.read_bytes() for file in files}
    for file in files:
        file.write_bytes(b"nothing")
    assert len(run(job, device)[0].failed) == 6
    for file, content in whole.items():
        file.write_bytes(content)
    job.write_text(job.read_text().replace("[all_in_focus]", ""))
    assert run(job, device)[0].done == 6
