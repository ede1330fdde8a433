"""Kills the worker, the scheduler, the main process or all of a batch job at random moments.

    python benchmarks/kill_batch.py [--rounds 30] [--seed 0] [--items 24] [--device pocl]

Each round starts a job of small light fields with two workers (in turn: in one process, two worker
processes of its own, an external scheduler with two workers), waits a random time, kills one
process or the whole group by SIGKILL, looks at every output while and after, and runs the job again
until it is done. Then every output must be there, right, once and with the bytes of a run that
nobody disturbed (less the UUID of each OME-TIFF), no temporary file left, and the manifest whole.
The seed of a round that fails is printed; the exit status says whether one did.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
import numpy as np
import tifffile

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import batchworks

from clplen import Device

KINDS = ("alone", "main", "worker", "scheduler", "worker outside", "main outside", "group")


def start(arguments: list[str], log: Path) -> subprocess.Popen[bytes]:
    """A process in a session of its own."""
    with log.open("ab") as file:
        return subprocess.Popen(
            [sys.executable, *arguments], stdout=file, stderr=file, start_new_session=True
        )


def children(pid: int) -> list[int]:
    """All processes below one."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            found += [int(child), *children(int(child))]
    return found


def workers_of(pid: int) -> list[int]:
    """Worker processes of a job or of a `clplen worker`."""
    return [child for child in children(pid) if _runs(child, ("spawn_main", "dask"))]


def _runs(pid: int, words: tuple[str, ...]) -> bool:
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")
    except OSError:
        return False
    return any(word in command for word in words) and "resource_tracker" not in command


def half_written(out: Path, right: dict[str, np.ndarray]) -> list[str]:
    """Outputs that are there under their names and are not what they have to be."""
    wrong = []
    for name, values in right.items():
        path = out / name
        try:
            found = tifffile.imread(path)
        except FileNotFoundError:
            continue
        except Exception as error:
            wrong.append(f"{name}: {error}")
            continue
        if not np.array_equal(found, values):
            wrong.append(f"{name} differs")
    return wrong


def same_bytes(one: Path, other: Path) -> bool:
    """Whether two OME-TIFF are the same but for their UUID."""
    first, second = (
        re.sub(rb"urn:uuid:[0-9a-f-]{36}", b"", path.read_bytes()) for path in (one, other)
    )
    return first == second


def finish(job: Path, log: Path, extra: list[str]) -> int:
    """Run the job until it ends by itself; its status."""
    return subprocess.run(
        [sys.executable, "-m", "clplen", "batch", str(job), *extra],
        stdout=log.open("ab"),
        stderr=subprocess.STDOUT,
        timeout=300,
        check=False,
    ).returncode


def round_of(seed: int, folder: Path, items: int, device: Device) -> list[str]:
    """One round; what is wrong, in words."""
    chance = random.Random(seed)
    kind = KINDS[seed % len(KINDS)]
    files = batchworks.write_inputs(folder / "in", items, seed=seed)
    right = {
        f"{file.stem}/{name}": values
        for file in files
        for name, values in batchworks.expected(file, device).items()
    }
    log, out = folder / "log.txt", folder / "out"
    calm = batchworks.write_job(folder, output="calm", more=f'device = "{device.place}"')
    if finish(calm, log, []) != 0:
        return ["the undisturbed run failed"]
    job = batchworks.write_job(folder, more=f'device = "{device.place}"')
    outside: list[subprocess.Popen[bytes]] = []
    extra: list[str] = [] if kind == "alone" else ["--workers", "2"]
    if kind.startswith("scheduler") or kind.endswith("outside"):
        port = 20000 + os.getpid() % 20000 + seed
        address = f"tcp://127.0.0.1:{port}"
        scheduler = ["-m", "distributed.cli.dask_scheduler", "--port", str(port), "--no-dashboard"]
        scheduler += ["--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0"]
        outside.append(start(scheduler, log))
        worker = ["-m", "clplen", "worker", address, "--device", device.place]
        outside += [start(worker, log) for _ in range(2)]
        extra = ["--scheduler", address]
    main = start(["-m", "clplen", "batch", str(job), *extra], log)
    wrong: list[str] = []
    begun = time.monotonic()
    while not list(out.glob("*/item.json")) and time.monotonic() - begun < 240:
        if main.poll() is not None:
            break
        time.sleep(0.02)
    time.sleep(chance.uniform(0, 0.04 * items))
    victim = main.pid
    if kind == "scheduler":
        victim = outside[0].pid
    elif kind.startswith("worker"):
        above = chance.choice([one.pid for one in outside[1:]]) if outside else main.pid
        victim = chance.choice(workers_of(above) or [above])
    done = len(list(out.glob("*/item.json")))
    try:
        (os.killpg if kind == "group" else os.kill)(victim, signal.SIGKILL)
    except ProcessLookupError:
        print(f"  round {seed}: the {kind} had ended")
    wrong += [f"at the kill: {text}" for text in half_written(out, right)]
    try:
        status = main.wait(timeout=240)
    except subprocess.TimeoutExpired:
        wrong.append("the job did not end after the kill")
        status = None
    wrong += [f"after the kill: {text}" for text in half_written(out, right)]
    for one in outside:
        for pid in [*children(one.pid), one.pid]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        one.wait()
    again = finish(job, log, [] if seed % 2 else ["--workers", "2"])
    if again != 0:
        wrong.append(f"the run after it ended with {again}")
    wrong += [f"in the end: {text}" for text in half_written(out, right)]
    wrong += [f"missing: {name}" for name in right if not (out / name).exists()]
    other = [name for name in right if not same_bytes(out / name, folder / "calm" / name)]
    wrong += [f"other bytes: {name}" for name in other]
    wrong += [f"stray: {path}" for path in batchworks.strays(out)]
    with sqlite3.connect(out / "manifest.sqlite") as manifest:
        states = manifest.execute("SELECT state FROM items").fetchall()
        if len(states) != items or {state for (state,) in states} != {"done"}:
            wrong.append(f"the manifest has {len(states)} items, {set(states)}")
        if manifest.execute("PRAGMA integrity_check").fetchone() != ("ok",):
            wrong.append("the manifest is damaged")
    records = [json.loads(path.read_text()) for path in out.glob("*/item.json")]
    if len(records) != items:
        wrong.append(f"{len(records)} records for {items} items")
    print(f"  round {seed}: {kind} killed after {done} items, status {status}, wrong: {wrong or 0}")
    return wrong


def rounds_of(rounds: int, seed: int, items: int, device: Device) -> list[int]:
    """Seeds of the rounds in which something was wrong."""
    bad = []
    for number in range(seed, seed + rounds):
        with tempfile.TemporaryDirectory() as folder:
            if round_of(number, Path(folder), items, device):
                bad.append(number)
                print(Path(folder, "log.txt").read_text()[-3000:])
    print(f"{rounds - len(bad)} of {rounds} rounds right; wrong seeds: {bad or 'none'}")
    return bad


@click.command()
@click.option("--rounds", default=30)
@click.option("--seed", default=0)
@click.option("--items", default=24)
@click.option("--device", "selector", default="pocl")
def main(rounds: int, seed: int, items: int, selector: str) -> None:
    """Count the rounds in which something was wrong."""
    sys.exit(bool(rounds_of(rounds, seed, items, Device.open(selector))))


if __name__ == "__main__":
    main()
