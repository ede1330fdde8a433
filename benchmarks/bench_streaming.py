"""Focal stacks and depth maps of a light field larger than a budget of memory, beside in core.

    python benchmarks/bench_streaming.py [--device pocl] [--mib 2048] [--memory 512]

Every row is a process of its own. ``peak`` is its largest resident memory as the system counts it
(VmHWM) above what it held after its first kernel on a stack of one plane; ``ratio`` is that over
the budget. ``differ`` counts the bytes of the results that are not those of in core. The light
field and the results lie in $TMPDIR.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import numpy as np

VIEWS, COLOURS = 9, 3
WIDTH = 2048
PLANES = np.linspace(-1.5, 1.5, 21)
WORKS = ("stack", "energy", "correspondence", "structure-tensor", "combined")
_BLOCK = 1 << 24


def status(name: str) -> int:
    """Bytes of one line of /proc/self/status."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    raise OSError(f"/proc/self/status has no {name}.")


def generate(folder: Path, mib: int) -> tuple[int, ...]:
    """A scene of two slopes as .npy, .h5 and .zarr; its shape."""
    import h5py
    import zarr

    rows = (mib << 20) // (VIEWS**2 * WIDTH * COLOURS)
    shape = (VIEWS, VIEWS, rows, WIDTH, COLOURS)
    rng = np.random.default_rng(1)
    texture = rng.integers(0, 256, (rows + 64, WIDTH + 64, COLOURS), np.uint8)
    texture = (texture // 2 + np.roll(texture, 1, 1) // 4 + np.roll(texture, 1, 0) // 4).astype(
        "u1"
    )
    npy = np.lib.format.open_memmap(folder / "lf.npy", "w+", np.uint8, shape)
    form = {} if zarr.__version__.startswith("2.") else {"zarr_format": 2}
    chunks = (1, 1, *shape[2:])
    lazy = zarr.create(shape, chunks=chunks, dtype=np.uint8, store=str(folder / "lf.zarr"), **form)
    with h5py.File(folder / "lf.h5", "w") as file:
        dataset = file.create_dataset("lightfield", shape, np.uint8)
        for v, u in np.ndindex(VIEWS, VIEWS):
            y, x = 32 - (v - VIEWS // 2), 32 - (u - VIEWS // 2)  # of disparity -1
            view = texture[y : y + rows, x : x + WIDTH].copy()
            half = rows // 2  # and 1 below
            y, x = 32 + (v - VIEWS // 2), 32 + (u - VIEWS // 2)
            view[half:] = texture[y : y + rows, x : x + WIDTH][half:]
            npy[v, u] = lazy[v, u] = dataset[v, u] = view
    npy.flush()
    return shape


def child(path: str, work: str, memory: int, selector: str | None, output: str) -> dict[str, Any]:
    """One row: memory 0 is in core."""
    import clplen

    device = clplen.Device.open(selector)
    small = clplen.LightField.from_array(np.ones((3, 3, 64, 64), np.uint8), device=device)
    clplen.focal_stack(small, disparities=[0.5]).to_numpy()
    Path("/proc/self/clear_refs").write_text("5")  # VmHWM begins anew
    before, start = status("VmRSS"), time.perf_counter()
    with clplen.open_lightfield(path, device=device) as stored, open(output, "wb") as file:
        plan = save(stored, work, memory, device, file)
    seconds = time.perf_counter() - start
    return {"seconds": seconds, "peak": status("VmHWM") - before, "plan": plan}


def save(stored: Any, work: str, memory: int, device: Any, file: Any) -> str:
    """Compute, and write what was found as plain samples; the plan in words."""
    import clplen

    if memory == 0:
        lf = stored.load(device)
        if work == "stack":
            clplen.focal_stack(lf, disparities=PLANES).to_numpy().tofile(file)
        else:
            found = clplen.depth_map(lf, disparities=PLANES, cue=work)
            np.stack([found.disparity, found.confidence]).tofile(file)
        return "in core"
    if work != "stack":
        found = clplen.depth_map(
            stored, disparities=PLANES, cue=work, memory=memory, device=device
        )
        for values in (found.disparity, found.confidence):
            values.tofile(file)
        return ""
    made = clplen.lightfield.stack_tiles(stored, disparities=PLANES, memory=memory, device=device)
    ny, nx, channels = made.shape[1:]
    for planes, rows, columns, pictures in made:
        for plane, picture in zip(range(planes.start, planes.stop), pictures, strict=True):
            for y, row in zip(range(rows.start, rows.stop), picture, strict=True):
                file.seek(4 * channels * ((plane * ny + y) * nx + columns.start))
                file.write(row.data)
    return str(made.plan)


def differing(a: Path, b: Path) -> int:
    """Bytes in which two files differ."""
    if a.stat().st_size != b.stat().st_size:
        return max(a.stat().st_size, b.stat().st_size)
    count = 0
    with a.open("rb") as first, b.open("rb") as second:
        while block := first.read(_BLOCK):
            other = np.frombuffer(second.read(_BLOCK), np.uint8)
            count += int(np.count_nonzero(np.frombuffer(block, np.uint8) != other))
    return count


def run(*args: Any) -> dict[str, Any]:
    """A row in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "--child", json.dumps(args)],
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return dict(json.loads(done.stdout.splitlines()[-1]))


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--mib", default=2048, show_default=True, help="Size of the light field.")
@click.option("--memory", "budget", default=512, show_default=True, help="MiB.")
@click.option("--work", "works", multiple=True, type=click.Choice(WORKS), default=WORKS)
@click.option("--quick", is_flag=True, help="64 MiB with a budget of 48.")
@click.option("--child", "row", hidden=True)
def main(
    selector: str | None, mib: int, budget: int, works: tuple[str, ...], quick: bool, row: str
) -> None:
    """Memory and time of what is streamed, over what is in core."""
    if row:
        click.echo(json.dumps(child(*json.loads(row))))
        return
    mib, budget = (64, 48) if quick else (mib, budget)
    folder = Path(tempfile.mkdtemp(prefix="clplen-bench-"))
    try:
        shape = generate(folder, mib)
        click.echo(f"{shape} uint8, {mib} MiB, budget {budget} MiB, {PLANES.size} planes\n")
        click.echo(f"{'':28s}{'seconds':>9s}{'in core':>9s}{'peak MiB':>10s}{'ratio':>7s}  differ")
        for work in works:
            whole, part = folder / "whole", folder / "part"
            reference = run(str(folder / "lf.npy"), work, 0, selector, str(whole))
            for suffix in ("npy", "h5", "zarr") if work == "stack" else ("npy",):
                path = str(folder / f"lf.{suffix}")
                found = run(path, work, budget << 20, selector, str(part))
                peak = found["peak"] / 2**20
                click.echo(
                    f"{work + ' of .' + suffix:28s}{found['seconds']:9.1f}"
                    f"{reference['seconds']:9.1f}{peak:10.0f}{peak / budget:7.2f}  "
                    f"{differing(whole, part)}"
                )
                if found["plan"]:
                    click.echo("    " + found["plan"].replace("\n", "\n    "))
                part.unlink()
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
