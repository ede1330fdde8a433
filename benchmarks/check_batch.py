"""Many small light fields by two workers, the real captures, and jobs that are disturbed.

    python benchmarks/check_batch.py [--device pocl] [--items 200] [--keep FOLDER]
        [--rounds 10] [--seed 0] [--tiny 3000]

Every output of the small ones is compared with the result in core, bit for bit. The captured
flower and the raw microscope frame with its white and dark frames ($CLPLEN_DATA, else
../shared/data) go through stack, depth and all-in-focus; --keep leaves them to be looked at.

Disturbed jobs: --rounds of kill_batch.py; a full disk (a tmpfs of 2 MB, which root alone can
mount), folders that are read-only, inputs that are removed, truncated and changed while it runs,
two runs on one output, and --tiny light fields, with the seconds an item and the memory. What
fails must say so in one sentence, what does not must be right, and the next run must do the rest
and leave nothing else. The exit status says whether something was wrong.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import batchworks
import kill_batch

from clplen import Device
from clplen.batch import Job

PLANES = {"disparities": "-1:1:21"}


def small(device: Device, items: int) -> None:
    """How many outputs are wrong or too many."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = batchworks.write_inputs(folder / "in", items)
        job = Job.read(batchworks.write_job(folder, more=f'device = "{device.place}"'))
        begun = time.perf_counter()
        summary = job.run(workers=2)
        wrong = batchworks.wrong_outputs(folder / "out", files, device)
        strays = batchworks.strays(folder / "out")
        print(
            f"{summary.done} done, {len(summary.failed)} failed, {len(wrong)} outputs wrong, "
            f"{len(strays)} stray, {time.perf_counter() - begun:.1f} s"
        )


def real(device: Device, folder: Path) -> None:
    """The captures of one job."""
    data = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not data.is_dir():
        print(f"no real captures in {data}: set CLPLEN_DATA")
        return
    flower = {"pattern": "IMG_0001_{n}_{u}_{v}.png"}
    guv = data / "lfm_guv"
    frames = {
        "white": str(guv / "Radiometry_GUVExperim1.tif"),
        "dark": str(guv / "DarkFrame_GUVExperim1.tif"),
    }
    inputs = [
        {"files": str(data / "lytro_f01_flower"), "name": "flower", "layout": flower},
        {"files": str(guv / "Lightfield_GUVExperim1.tif"), "name": "guv", "layout": frames},
    ]
    words = {"stack": PLANES, "depth": PLANES, "all_in_focus": {}}
    job = Job(output="captures", inputs=inputs, device=device.place, **words).relative_to(folder)
    summary = job.run()
    print(f"captures: {summary.done} done, {summary.failed or 'none'} failed, in {folder}/captures")


def done_again(job: Path, files: list[Path], device: Device) -> list[str]:
    """What is wrong when nothing disturbs the job any more and it has run again."""
    log, out = job.parent / "again.txt", job.parent / "out"
    status = kill_batch.finish(job, log, [])
    wrong = [] if status == 0 else [f"the next run ended with {status}: {log.read_text()}"]
    wrong += batchworks.wrong_outputs(out, files, device)
    return wrong + [f"stray: {path}" for path in batchworks.strays(out)]


def failures(log: Path, allowed: set[str]) -> list[str]:
    """What is wrong with the words of a run: more than a sentence, or of other items."""
    text = log.read_text()
    failed = re.findall(r"^(\S+) failed: .*$", text, re.MULTILINE)
    wrong = ["a traceback" for _ in re.findall("Traceback", text)]
    return wrong + [f"{name} failed" for name in failed if name not in allowed]


def full_disk(device: Device, folder: Path) -> list[str]:
    """Room for a part of the outputs, then for all."""
    files = batchworks.write_inputs(folder / "in", 8)
    large = np.random.default_rng(1).random((2, 2, 150, 155), np.float32)
    for number in range(4):
        files.append(folder / "in" / f"large_{number}.npy")
        np.save(files[-1], large)
    job, disk = batchworks.write_job(folder), folder / "out"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        print("full disk: skipped, only root mounts a tmpfs")
        return []
    try:
        log = folder / "log.txt"
        status = kill_batch.finish(job, log, [])
        wrong = [] if status == 1 else [f"the run ended with {status}"]
        wrong += failures(log, {path.stem for path in files})
        wrong += [f"stray: {path}" for path in batchworks.strays(disk)]
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        return wrong + done_again(job, files, device)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def read_only(device: Device, folder: Path) -> list[str]:
    """The folder of an item, the output and what it lies in take no files."""
    files = batchworks.write_inputs(folder / "in", 4)
    job, wrong = batchworks.write_job(folder), []
    obeying = []
    if os.getuid() == 0:  # root ignores modes unless it gives that up
        caps = "-dac_override,-dac_read_search"
        obeying = ["setpriv", "--bounding-set", caps, "--inh-caps", caps]
        if shutil.which(obeying[0]) is None:
            print("read-only folders: skipped, root ignores modes and there is no setpriv")
            return []
    item = folder / "out" / files[1].stem
    item.mkdir(parents=True)
    for closed, allowed in ((item, {item.name}), (folder / "out", set()), (folder, set())):
        log = folder.with_name(f"{closed.name}.txt")
        if closed == folder:
            shutil.rmtree(folder / "out")
        closed.chmod(0o555)
        command = [*obeying, sys.executable, "-m", "clplen", "batch", str(job)]
        with log.open("wb") as file:
            status = subprocess.call(command, stdout=file, stderr=file)
        closed.chmod(0o755)
        wrong += [] if status == 1 else [f"the run with {closed.name} ended with {status}"]
        wrong += failures(log, allowed)
    return wrong + done_again(job, files, device)


def changed_inputs(device: Device, folder: Path) -> list[str]:
    """Inputs go, are cut and change while others are computed."""
    files = batchworks.write_inputs(folder / "in", 40)
    job, log = batchworks.write_job(folder), folder / "log.txt"
    run = kill_batch.start(["-m", "clplen", "batch", str(job)], log)
    while not list(folder.glob("out/*/item.json")) and run.poll() is None:
        time.sleep(0.01)
    gone, cut, *others = files[-1:-12:-2]  # arrays of NumPy
    before = gone.read_bytes()
    gone.unlink()
    os.truncate(cut, cut.stat().st_size // 2)
    for path in others:
        np.save(path, np.load(path)[::-1])
    status = run.wait()
    touched = {path.stem for path in (gone, cut, *others)}
    wrong = [] if status == 1 else [f"the run ended with {status}"]
    wrong += failures(log, touched)
    untouched = [path for path in files if path.stem not in touched]
    wrong += batchworks.wrong_outputs(folder / "out", untouched, device)
    for path in (gone, cut):
        path.write_bytes(before)
    return wrong + done_again(job, files, device)


def two_runs(device: Device, folder: Path) -> list[str]:
    """One does the job, the other is refused; later the other way round, with two workers."""
    files, wrong = batchworks.write_inputs(folder / "in", 12), []
    job = batchworks.write_job(folder)
    for extra in ([], ["--workers", "2"]):
        shutil.rmtree(folder / "out", ignore_errors=True)
        logs = [folder / f"log_{i}.txt" for i in range(2)]
        command = ["-m", "clplen", "batch", str(job), *extra]
        runs = [kill_batch.start(command, log) for log in logs]
        found = sorted(run.wait() for run in runs)
        text = "".join(log.read_text() for log in logs)
        if found != [0, 1] or "is using" not in text or "Traceback" in text:
            wrong.append(f"the runs ended with {found}: {text}")
        wrong += done_again(job, files, device)
        for log in logs:
            log.unlink()
    return wrong


def tiny(device: Device, folder: Path, items: int) -> list[str]:
    """Seconds an item, and the memory after a tenth of them and at the end."""
    (folder / "in").mkdir()
    random = np.random.default_rng(1)
    for i in range(items):
        np.save(folder / "in" / f"field_{i:05d}.npy", random.random((3, 3, 16, 18), np.float32))
    job = Job.read(batchworks.write_job(folder, more=f'device = "{device.place}"'))
    sizes: list[float] = []

    class Sizes(batchworks.Watcher):
        def report(self, report: object) -> None:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            sizes.append(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)

    begun = time.perf_counter()
    summary = job.run(watcher=Sizes())
    each = (time.perf_counter() - begun) / items
    begun = time.perf_counter()
    skipped = job.run().skipped
    again = time.perf_counter() - begun
    first, last = sizes[items // 10], sizes[-1]
    print(
        f"{items} tiny items: {each:.3f} s an item, {first:.0f} MB after a tenth, {last:.0f} MB at "
        f"the end; {again:.1f} s to find that all are done"
    )
    wrong = [f"{len(summary.failed)} failed"] * bool(summary.failed)
    wrong += [f"{skipped} of {items} found again"] * (skipped != items)
    wrong += [f"stray: {path}" for path in batchworks.strays(folder / "out")]
    return wrong + [f"memory grew by {last - first:.0f} MB"] * (last - first > 20)


def disturbed(device: Device, rounds: int, seed: int, items: int) -> bool:
    """Whether something was wrong with a job that was disturbed."""
    bad = bool(kill_batch.rounds_of(rounds, seed, 24, device))
    jobs = {
        "full disk": full_disk,
        "read-only folders": read_only,
        "inputs removed, truncated and changed": changed_inputs,
        "two runs on one output": two_runs,
        "tiny items": partial(tiny, items=items),
    }
    for words, job in jobs.items():
        with tempfile.TemporaryDirectory() as name:
            inside = Path(name, "job")
            inside.mkdir()
            wrong = job(device, inside)
        print(f"{words}: wrong: {wrong or 0}", flush=True)
        bad |= bool(wrong)
    return bad


@click.command()
@click.option("--device", "selector")
@click.option("--items", default=200)
@click.option("--keep", type=click.Path(path_type=Path))
@click.option("--rounds", default=10)
@click.option("--seed", default=0)
@click.option("--tiny", "many", default=3000)
def main(
    selector: str | None, items: int, keep: Path | None, rounds: int, seed: int, many: int
) -> None:
    """All of it."""
    device = Device.open(selector)
    os.environ["CLPLEN_DEVICE"] = device.place  # of jobs that name none
    small(device, items)
    with tempfile.TemporaryDirectory() as name:
        real(device, keep or Path(name))
    sys.exit(disturbed(device, rounds, seed, many))


if __name__ == "__main__":
    main()
