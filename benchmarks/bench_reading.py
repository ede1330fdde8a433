"""Reading a folder of views, beside decoding its pictures and nothing else.

    python benchmarks/bench_reading.py [--device pocl] [--views 9] [--side 512] [--repeats 5]

The views are smooth random RGB pictures of 8 bits with a little noise, as PNG. The bare decoding
is imageio's (by Pillow) of the same files in as many threads as there are cores; each time is the
shortest of several. Only the ratio means something on another machine.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import click
import imageio.v3 as imageio
import numpy as np

from clplen import Device, read_lightfield


def write_folder(folder: Path, views: int, side: int) -> None:
    """views x views pictures, as the HCI 4D benchmark names them."""
    random = np.random.default_rng(1)
    coarse = random.random((side // 16 + 1, side // 16 + 1, 3))
    smooth = 200 * np.kron(coarse, np.ones((16, 16, 1)))[:side, :side]
    for i in range(views**2):
        noisy = smooth + random.normal(20, 2, smooth.shape)
        imageio.imwrite(folder / f"input_Cam{i:03d}.png", np.clip(noisy, 0, 255).astype(np.uint8))


def decode_all(files: list[Path]) -> None:
    """Every picture once, let go at once."""

    def decode(file: Path) -> None:
        imageio.imread(file, plugin="pillow")

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        list(pool.map(decode, files))


def shortest(runs: list[Callable[[], Any]], repeats: int) -> list[float]:
    """Seconds of each, in turns, so that other programs disturb all of them."""
    best = [np.inf] * len(runs)
    for _ in range(repeats):
        for index, run in enumerate(runs):
            start = time.perf_counter()
            run()
            best[index] = min(best[index], time.perf_counter() - start)
    return best


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--views", default=9, show_default=True, help="Along each axis.")
@click.option("--side", default=512, show_default=True, help="Of a picture in pixels.")
@click.option("--repeats", default=5, show_default=True)
def main(selector: str | None, views: int, side: int, repeats: int) -> None:
    """Time of reading, of bare decoding, and their ratio."""
    device = Device.open(selector)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_folder(folder, views, side)
        files = sorted(folder.iterdir())
        read_lightfield(folder, device=device)  # builds kernels, fills the disk's cache
        reading, bare = shortest(
            [lambda: read_lightfield(folder, device=device), lambda: decode_all(files)], repeats
        )
    click.echo(repr(device))
    click.echo(f"{views**2} PNG of {side} x {side} RGB, {os.cpu_count()} cores")
    click.echo(f"read_lightfield  {1e3 * reading:9.1f} ms")
    click.echo(f"bare decoding    {1e3 * bare:9.1f} ms, ratio {reading / bare:.2f}")


if __name__ == "__main__":
    main()
