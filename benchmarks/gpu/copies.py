"""Rates of copies between host and device, by the kind of memory on the host.

    python -m benchmarks gpu/copies [--device gpu] [--mib 512] [--repeats 5] [--quick]

Up from and down to: a fresh array, an array whose pages were touched, pinned memory
(`ALLOC_HOST_PTR`, mapped), pinned memory in pieces of 16 MiB on two queues. Beside them what
`Device.upload` and `Device.download` reach, a copy within the device, and one within the host. The
extensions by which a device takes memory of other programs are listed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import click
import numpy as np
import pyopencl as cl

from clplen import Device

PIECE = 16 << 20


def rate(name: str, run: Callable[[], Any], moved: int, repeats: int) -> None:
    """Print the median rate of `run`, which moves a number of bytes and waits for them."""
    run()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    click.echo(f"{name:38s} {moved / np.median(seconds) / 1e9:8.2f} GB/s")


@click.command()
@click.option("--device", "selector", default="gpu", show_default=True)
@click.option("--mib", default=512, show_default=True, type=click.IntRange(16))
@click.option("--repeats", default=5, show_default=True, type=click.IntRange(1))
@click.option("--quick", is_flag=True, help="A small size.")
def main(selector: str, mib: int, repeats: int, quick: bool) -> None:
    device = Device.open(selector)
    context, queue = device.context, device.queue
    queues = [cl.CommandQueue(context) for _ in range(2)]
    size = (32 if quick else mib) << 20
    here = np.random.default_rng(0).integers(0, 255, size, dtype=np.uint8)
    touched = here.copy()
    flags = cl.mem_flags.READ_WRITE
    there, twin = cl.Buffer(context, flags, size), cl.Buffer(context, flags, size)
    held = cl.Buffer(context, flags | cl.mem_flags.ALLOC_HOST_PTR, size)
    both = cl.map_flags.READ | cl.map_flags.WRITE
    pinned, _ = cl.enqueue_map_buffer(queue, held, both, 0, (size,), np.uint8)
    pinned[:] = here

    def pieces(up: bool) -> None:
        for at, begin in enumerate(range(0, size, PIECE)):
            part = pinned[begin : begin + PIECE]
            if up:
                cl.enqueue_copy(queues[at % 2], there, part, dst_offset=begin, is_blocking=False)
            else:
                cl.enqueue_copy(queues[at % 2], part, there, src_offset=begin, is_blocking=False)
        for each in queues:
            each.finish()

    def uploaded() -> None:
        device.upload(here)
        device.finish()

    def copied() -> None:
        cl.enqueue_copy(queue, twin, there)
        queue.finish()

    array = device.upload(here)
    click.echo(f"{device!r}; {size >> 20} MiB")
    cases: dict[str, Callable[[], Any]] = {
        "copy within the host": lambda: np.copyto(touched, here),
        "up, pageable": lambda: cl.enqueue_copy(queue, there, here),
        "up, pinned": lambda: cl.enqueue_copy(queue, there, pinned),
        "up, pinned, pieces on two queues": lambda: pieces(True),
        "up, copied to pinned memory first": lambda: (
            np.copyto(pinned, here),
            cl.enqueue_copy(queue, there, pinned),
        ),
        "up, Device.upload": uploaded,
        "down, pageable, fresh": lambda: cl.enqueue_copy(queue, np.empty_like(here), there),
        "down, pageable, touched": lambda: cl.enqueue_copy(queue, touched, there),
        "down, pinned": lambda: cl.enqueue_copy(queue, pinned, there),
        "down, pinned, pieces on two queues": lambda: pieces(False),
        "down, pinned, then to a fresh array": lambda: (
            cl.enqueue_copy(queue, pinned, there),
            pinned.copy(),
        ),
        "down, Device.download": lambda: device.download(array),
    }
    for name, run in cases.items():
        rate(name, run, size, repeats)
    rate("copy within the device, both ways", copied, 2 * size, repeats)
    known = queue.device.extensions.split()
    click.echo(f"extensions: {[one for one in known if 'external' in one or 'import' in one]}")

