"""Damage small files of every format and read them: no crash, no other error, little memory.

    python benchmarks/fuzz.py --seconds 60 [PARSER ...]

One file in 20 is enlarged by a hole of 1 GiB, one in 20 is a bomb: a small file that declares much.
Each parser runs in a process of its own. What fails is kept with its seed in the folder --keep,
and ``--replay FILE_OR_FOLDER PARSER`` reads it once more. A file may take 5 s of the processor, and
300 MB of memory of its own (anonymous pages, sampled) above the arrays that reading gives.
"""

from __future__ import annotations

import argparse
import faulthandler
import logging
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1]))

import fuzzing
import mutations

from clplen import Device

LIMIT = 5  # seconds a file, of the processor, which other programs do not change
MEMORY = 300_000_000  # bytes above the arrays
RARE = 0.05  # of the files are sparse, as many are bombs
PERIOD = 0.005  # seconds between two samples of memory


class TooSlow(BaseException):
    """A file took longer than the limit."""


def stop(*_: Any) -> None:
    raise TooSlow


class Peak:
    """Most bytes of own memory that the process holds inside the block, above those before it."""

    def __enter__(self) -> Peak:
        self.first = self.most = anonymous()
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._sample)
        self.thread.start()
        return self

    def _sample(self) -> None:
        while not self.ended.wait(PERIOD):
            self.most = max(self.most, anonymous())

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        self.thread.join()
        self.nbytes = max(self.most, anonymous()) - self.first


def anonymous() -> int:
    """Bytes of memory of the process that no file holds."""
    words = Path("/proc/self/statm").read_text().split()
    return (int(words[1]) - int(words[2])) * resource.getpagesize()


def changed(path: Path, source: random.Random) -> None:
    """Damage a file, or make it sparse or a bomb."""
    kind = source.random()
    if kind < RARE:
        mutations.enlarge(path, source)
    elif kind > 2 * RARE or not mutations.bomb(path):
        mutations.damage(path, mutations.operations(source), source)


def fuzz(name: str, seconds: float, seed: int, keep: Path) -> int:
    """Read damaged files for so long; returns how many failed."""
    warnings.simplefilter("error")
    signal.signal(signal.SIGPROF, stop)
    faulthandler.enable()
    logging.disable()  # tifffile tells of every tag
    warnings.filterwarnings("ignore", message=".*does not know this CPU")
    device = Device.open("pocl")
    parser = fuzzing.PARSERS[name]
    source, count, failures = random.Random(seed), Counter(), 0
    largest = slowest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "good")
        place.mkdir()
        good = parser.make(place, device)
        fuzzing.outcome(parser, good, device)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            bad = Path(folder, "bad")
            shutil.rmtree(bad, ignore_errors=True)
            shutil.copytree(good.parent, bad)
            path = bad / good.name
            changed(path, source)
            case = keep / f"{name}-{seed}-{sum(count.values())}"
            os.rename(bad, case)  # there after a crash too
            path, start = case / good.name, time.process_time()
            faulthandler.dump_traceback_later(12 * LIMIT, exit=True)
            signal.setitimer(signal.ITIMER_PROF, LIMIT)
            with Peak() as peak:
                said, arrays = tried(parser, path, device)
            signal.setitimer(signal.ITIMER_PROF, 0)
            faulthandler.cancel_dump_traceback_later()
            slowest = max(slowest, time.process_time() - start)
            above = peak.nbytes - arrays
            if above > MEMORY:
                said = f"MEMORY {above:,} bytes above the arrays"
            largest = max(largest, above)
            count[said if said.isalpha() else "failed"] += 1
            if said.isalpha():
                shutil.rmtree(case)
            else:
                failures += 1
                print(f"{name}: {said}\n  kept in {case}", flush=True)
            if failures >= 20:
                break
    total = sum(count.values())
    print(
        f"{name}: {total} files, {dict(count)}, at most {largest / 1e6:.0f} MB above the arrays "
        f"and {slowest:.2f} s, seed {seed}",
        flush=True,
    )
    return failures


def tried(parser: fuzzing.Parser, path: Path, device: Device) -> tuple[str, int]:
    """What reading gives, and its bytes; the place of an error that is not allowed."""
    try:
        said, result = fuzzing.attempt(parser, path, device)
        return said, fuzzing.bytes_of(result)
    except TooSlow:
        return f"SLOW: more than {LIMIT} s\n{traceback.format_exc()[-1500:]}", 0
    except Exception as error:
        signal.setitimer(signal.ITIMER_PROF, 0)
        frames = traceback.extract_tb(error.__traceback__)
        ours = [f for f in frames if "/clplen/" in f.filename][-1:] or frames[-1:]
        last = frames[-1]
        return (
            f"{type(error).__name__}: {str(error)[:200]} at {ours[0].filename}:{ours[0].lineno} "
            f"({last.filename}:{last.lineno})",
            0,
        )


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("parsers", nargs="*", metavar="PARSER", default=list(fuzzing.PARSERS))
    arguments.add_argument("--seconds", type=float, default=60, help="for each parser")
    arguments.add_argument("--seed", type=int, default=None)
    arguments.add_argument("--keep", type=Path, default=Path("fuzz-failures"))
    arguments.add_argument("--replay", type=Path, help="one kept case, read once by PARSER")
    arguments.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    given = arguments.parse_args()
    seed = random.randrange(1 << 31) if given.seed is None else given.seed
    if given.replay is not None:
        parser = fuzzing.PARSERS[given.parsers[0]]
        print(parser.read(given.replay, Device.open("pocl")))
        return 0
    given.keep.mkdir(parents=True, exist_ok=True)
    if given.alone:
        return min(fuzz(given.parsers[0], given.seconds, seed, given.keep), 100)
    failed = []
    for name in given.parsers:
        words = [name, "--seconds", str(given.seconds), "--seed", str(seed), "--alone"]
        command = [sys.executable, __file__, *words, "--keep", str(given.keep)]
        status = subprocess.run(command, check=False).returncode
        if status:
            failed.append(name)
        if status < 0:
            print(f"{name}: the process ended by signal {-status}; see {given.keep}", flush=True)
    print(f"failed: {', '.join(failed) or 'none'}")
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
