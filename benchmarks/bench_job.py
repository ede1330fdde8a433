"""A batch job of focal stacks beside a loop that does the same one file after the other.

python benchmarks/bench_job.py [--device pocl] [--size 8x9x9x512x512] [--quick]
"""

from __future__ import annotations

import itertools
import math
import tempfile
from pathlib import Path

import numpy as np
from script import command

from clplen import Device, focal_stack, read_lightfield
from clplen.batch import InputTable, Job, StackTable
from clplen.bench import Benchmark, Case, Report, halved, in_turn, numbers, rate_rows
from clplen.io import write_stack

FORM = "FILESxVxUxYxX"
PLANES = 16
_RANGE = 1.0  # disparities from -1 to 1


def smaller(size: str) -> str:
    """Half the rows and columns."""
    return halved(size, (3, 4), 16)


def needs(size: str) -> int:
    """A few light fields of 8 bits with their stacks."""
    _, *shape = numbers(size, (5,), FORM)
    return 8 * math.prod(shape) + 4 * 4 * PLANES * shape[2] * shape[3]


def measure_batch(device: Device, size: str, repeats: int) -> Report:
    """Light fields a second, from files to files on the disk."""
    count, *shape = numbers(size, (5,), FORM)
    planes = np.linspace(-_RANGE, _RANGE, PLANES).tolist()
    with tempfile.TemporaryDirectory(prefix="clplen-bench-") as name:
        folder = Path(name)
        files = _write(folder / "in", count, tuple(shape))
        names = itertools.count()

        def loop() -> None:
            out = folder / f"loop{next(names)}"
            out.mkdir()
            for file in files:
                stack = focal_stack(read_lightfield(file, device=device), disparities=planes)
                write_stack(out / f"{file.stem}.ome.tif", stack, durable=True)

        def job() -> None:
            plan = Job(
                output=f"job{next(names)}",
                inputs=[InputTable(files=["in/*.npy"])],
                stack=StackTable(disparities=planes),
            )
            plan.relative_to(folder).run(device=device.place)

        cases = [
            Case("loop by hand", loop, count, "light fields"),
            Case("clplen batch, one process", job, count, "light fields"),
        ]
        times = in_turn(cases, repeats)
    return Report(
        "batch",
        size,
        "light fields a second over those of the loop",
        rate_rows(times, times[0]),
        notes=("The job also keeps digests, a record of each item and a manifest.",),
    )


def _write(folder: Path, count: int, shape: tuple[int, ...]) -> list[Path]:
    folder.mkdir()
    random = np.random.default_rng(1)
    for i in range(count):
        np.save(folder / f"{i:03d}.npy", random.integers(0, 256, shape, np.uint8))
    return sorted(folder.iterdir())


BENCHMARK = Benchmark(
    "batch",
    "a job of many files, beside a loop over read_lightfield, focal_stack and write_stack",
    sizes=("8x9x9x512x512",),
    quick="4x3x3x48x40",
    needs=needs,
    run=measure_batch,
    smaller=smaller,
)

if __name__ == "__main__":
    command(BENCHMARK, __doc__)()
