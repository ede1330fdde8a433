"""Focal stacks and depth maps of a light field larger than a budget of memory, beside in core.

    python -m benchmarks speed/streaming [--device pocl] [--mib 2048] [--memory 512] [--quick]

Every row is a process of its own, `clplen stack` or `clplen depth` with `--memory` and without. The
peak is the largest resident memory of the process, less that of the same command on a small light
field; the ratio is the peak over the budget. The files must be the same. They lie in $TMPDIR.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path

import click
import numpy as np
import tifffile

from clplen import Device

VIEWS, COLOURS, WIDTH = 9, 3, 2048
PLANES = "-1.5:1.5:21"
WORKS = ("stack", "energy", "correspondence", "structure-tensor", "combined")


def generate(path: Path, mib: int, width: int) -> None:
    """Write views of a scene whose upper half has disparity -1 and whose lower half has 1."""
    rows = max((mib << 20) // (VIEWS**2 * width * COLOURS), 64)
    rng = np.random.default_rng(1)
    texture = rng.integers(0, 256, (rows + 64, width + 64, COLOURS), np.uint8)
    texture = texture // 2 + np.roll(texture, 1, 1) // 4 + np.roll(texture, 1, 0) // 4
    shape = (VIEWS, VIEWS, rows, width, COLOURS)
    views = np.lib.format.open_memmap(path, "w+", np.uint8, shape)
    for v, u in np.ndindex(VIEWS, VIEWS):
        for half, sign in ((slice(0, rows // 2), -1), (slice(rows // 2, rows), 1)):
            y, x = (32 + sign * (n - VIEWS // 2) for n in (v, u))
            views[v, u, half] = texture[y : y + rows, x : x + width][half]
    views.flush()


def run(work: str, path: Path, device: Device, memory: str) -> tuple[float, float, str]:
    """Return seconds and peak MiB of a command, and the digest of its samples."""
    stack = work == "stack"
    output = path.with_name("out.tif" if stack else "out.pfm")
    words = ["stack"] if stack else ["depth", "--cue", work]
    words += [str(path), "-o", str(output), f"--disparities={PLANES}", "--device", device.place]
    words += ["--force", *(["--memory", memory] if memory else [])]
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "clplen", *words], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise click.ClickException(f"clplen {' '.join(words)} failed.")
    bits = hashlib.sha256()  # of the samples; the words beside them name the budget
    with tifffile.TiffFile(output) if stack else nullcontext() as file:
        for page in file.pages if stack else (output,):
            bits.update(page.asarray().tobytes() if stack else page.read_bytes())
    output.unlink()
    return seconds, usage.ru_maxrss / 1024, bits.hexdigest()


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--mib", default=2048, show_default=True, help="Size of the light field.")
@click.option("--memory", "budget", default=512, show_default=True, help="Budget in MiB.")
@click.option("--work", "works", multiple=True, type=click.Choice(WORKS), default=WORKS)
@click.option("--quick", is_flag=True, help="64 MiB with a budget of 48.")
def main(
    selector: str | None, mib: int, budget: int, works: tuple[str, ...], quick: bool
) -> None:
    device = Device.open(selector)
    mib, budget, width = (64, 48, 256) if quick else (mib, budget, WIDTH)
    with tempfile.TemporaryDirectory(prefix="clplen-bench-") as name:
        large, small = Path(name, "large.npy"), Path(name, "small.npy")
        generate(large, mib, width)
        generate(small, 0, 64)
        click.echo(f"{mib} MiB, budget {budget} MiB, planes {PLANES}")
        for work in works:
            _, base, _ = run(work, small, device, "")
            seconds, peak, streamed = run(work, large, device, f"{budget}MiB")
            core, _, whole = run(work, large, device, "")
            click.echo(
                f"{work:18s} {seconds:6.1f} s, in core {core:6.1f} s, peak over budget "
                f"{(peak - base) / budget:.2f}, {'same' if streamed == whole else 'OTHER'} bytes"
            )
