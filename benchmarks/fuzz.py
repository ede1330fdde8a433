"""Damage small files of every format and read them: no crash, no other error, little memory.

    python benchmarks/fuzz.py --seconds 60 [PARSER ...]

Each parser runs in a process of its own. What fails is kept with its seed in the folder --keep,
and ``--replay FILE_OR_FOLDER PARSER`` reads it once more. The limit of memory is 4 times the file
plus 64 MiB, measured by tracemalloc (Python and numpy) and by the growth of the process.
"""

from __future__ import annotations

import argparse
import faulthandler
import logging
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
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

LIMIT = 5  # seconds a file


class TooSlow(BaseException):
    """A file took longer than the limit."""


def stop(*_: Any) -> None:
    raise TooSlow


def grown() -> int:
    """Bytes of memory that the process has held at most."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def fuzz(name: str, seconds: float, seed: int, keep: Path) -> int:
    """Read damaged files for so long; returns how many failed."""
    warnings.simplefilter("error")
    signal.signal(signal.SIGALRM, stop)
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
            mutations.damage(path, mutations.operations(source), source)
            case = keep / f"{name}-{seed}-{sum(count.values())}"
            shutil.copytree(bad, case)  # there after a crash too
            before, start = grown(), time.monotonic()
            faulthandler.dump_traceback_later(12 * LIMIT, exit=True)
            signal.alarm(LIMIT)
            said, peak = tried(parser, path, device)
            signal.alarm(0)
            faulthandler.cancel_dump_traceback_later()
            slowest = max(slowest, time.monotonic() - start)
            allowed = 4 * fuzzing.size_of(path) + fuzzing.SLACK
            if max(peak, grown() - before) > allowed:
                said = f"MEMORY {max(peak, grown() - before):,} bytes"
            largest = max(largest, peak)
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
        f"{name}: {total} files, {dict(count)}, at most {largest / 2**20:.1f} MiB and "
        f"{slowest:.2f} s, seed {seed}",
        flush=True,
    )
    return failures


def tried(parser: fuzzing.Parser, path: Path, device: Device) -> tuple[str, int]:
    """What reading gives; the place of the error where it is none that is allowed."""
    try:
        return fuzzing.outcome(parser, path, device)
    except TooSlow:
        return f"SLOW: more than {LIMIT} s\n{traceback.format_exc()[-1500:]}", 0
    except Exception as error:
        signal.alarm(0)
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
