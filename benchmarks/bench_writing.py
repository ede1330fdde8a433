"""Writing a focal stack that comes in bands of rows: memory held, and speed with fsync.

    python benchmarks/bench_writing.py [--planes 101] [--side 2048] [--rows 128] [--folder DIR]

Each way runs in a process of its own. "Memory" is how much its peak of resident memory (VmHWM of
Linux) grew after the first band was there: what a writer holds besides the band. "Plain" is the
bytes of the stack by one `write` after the other into one file, and fsync. Only the ratio of the
times means something on another machine.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

WAYS = ("plain", "stack.tif", "stack.ome.zarr")


@dataclass(frozen=True)
class Bands:
    """A stack whose bands all hold the same samples."""

    band: np.ndarray
    shape: tuple[int, int, int]
    spacing: Any = (-1e-3, -1e-3, 2e-6, 2e-6)
    camera: Any = None

    @property
    def disparities(self) -> np.ndarray:
        """Of the planes."""
        return np.linspace(-2, 2, self.shape[0])

    @property
    def alphas(self) -> np.ndarray:
        """Of the planes."""
        return 1 - self.disparities / 8

    def __iter__(self) -> Iterator[tuple[slice, slice, slice, np.ndarray]]:
        rows = self.band.shape[1]
        for top in range(0, self.shape[1], rows):
            part = slice(top, min(top + rows, self.shape[1]))
            columns = slice(0, self.shape[2])
            yield slice(0, self.shape[0]), part, columns, self.band[:, : part.stop - part.start]


def peak() -> int:
    """Bytes of memory that this process has held at most."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return 1024 * int(line.split()[1])
    raise click.ClickException("This system does not tell the peak of memory (VmHWM).")


def write_plain(path: Path, stack: Bands) -> None:
    """Nothing but the bytes."""
    with path.open("wb") as file:
        for *_, values in stack:
            for plane in values:
                file.write(plane.data)
        os.fsync(file.fileno())


def measure(way: str, folder: str, shape: tuple[int, int, int], rows: int) -> tuple[int, float]:
    """Bytes held and seconds of one way."""
    from clplen.io import write_stack

    band = np.random.default_rng(1).random((shape[0], rows, shape[2]), dtype=np.float32)
    stack, path = Bands(band, shape), Path(folder) / way
    before, start = peak(), time.perf_counter()
    if way == "plain":
        write_plain(path, stack)
    else:
        write_stack(path, stack, durable=True)
    return peak() - before, time.perf_counter() - start


@click.command()
@click.option("--planes", default=101, show_default=True)
@click.option("--side", default=2048, show_default=True, help="Of a plane in pixels.")
@click.option("--rows", default=128, show_default=True, help="Of a band.")
@click.option("--folder", help="Where to write; default $TMPDIR.")
def main(planes: int, side: int, rows: int, folder: str | None) -> None:
    """Memory and speed of OME-TIFF and OME-Zarr beside a plain file."""
    shape = (planes, side, side)
    megabytes = 4 * planes * side**2 / 1e6
    click.echo(f"{planes} x {side} x {side} float32, {megabytes:.0f} MB, bands of {rows} rows")
    for way in WAYS:
        with (
            tempfile.TemporaryDirectory(dir=folder) as name,
            multiprocessing.get_context("spawn").Pool(1) as pool,
        ):
            held, seconds = pool.apply(measure, (way, name, shape, rows))
        speed = megabytes / seconds
        click.echo(f"{way:15} {held / 1e6:7.1f} MB held {seconds:7.2f} s {speed:7.0f} MB/s")


if __name__ == "__main__":
    main()
