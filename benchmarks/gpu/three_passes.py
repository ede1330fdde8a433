"""A padded propagation step in three passes over memory: what a step on a GPU takes at least.

    python -m benchmarks gpu/three_passes [--device gpu] [--repeats 11] [--quick]

N x N samples padded to 2N, the transfer function there already, complex64; microseconds of the
device for each pass, rates of the bytes that a pass must move, and the rms error against complex128
on the host. The kernels (three_passes.cl beside this script) take powers of 2.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
import pyopencl as cl

from clplen import Device

SIZES, QUICK_SIZES = (512, 1024, 2048, 4096), (256,)
FORMS = ((1, 1), (1, 4), (4, 4), (8, 8))  # columns side by side, and in a work-group
BYTES = np.array([24, 40, 24, 88])  # a sample of N x N, of each pass and of all: H is a quadrant


def step(n: int, device: Device, repeats: int) -> None:
    """Measure a step of N x N samples in every form."""
    m, random = 2 * n, np.random.default_rng(0)
    u = (random.standard_normal((n, n)) + 1j * random.standard_normal((n, n))).astype(np.complex64)
    f = np.arange(n + 1) / m
    factor = np.exp(3000j * (f[:, None] ** 2 + 0.5 * f**2)) / m**2  # [fx, fy]; unlike in x and y
    roots = np.exp(-2j * np.pi * np.arange(m) / m)
    mirrored = np.minimum(np.arange(m), m - np.arange(m))
    exact = np.fft.fft2(u.astype(complex), (m, m)) * factor.T[np.ix_(mirrored, mirrored)] * m**2
    exact = np.fft.ifft2(exact)[:n, :n]

    context, flags = device.context, cl.mem_flags
    queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)

    def there(values: np.ndarray) -> cl.Buffer:
        copied = flags.READ_ONLY | flags.COPY_HOST_PTR
        return cl.Buffer(context, copied, hostbuf=values.astype(np.complex64))

    field, H, w = there(u), there(factor), there(roots)
    between, out = (cl.Buffer(context, flags.READ_WRITE, 8 * n * wide) for wide in (m, n))
    source = Path(__file__).with_suffix(".cl").read_text()
    first = (8, 2, 4)[(m.bit_length() - 1) % 3]
    for group, columns in FORMS:
        options = [f"-DM={m}", f"-DR0={first}", f"-DGROUP={group}", f"-DCOLUMNS={columns}"]
        program = cl.Program(context, source).build(options)
        kernels = [cl.Kernel(program, name) for name in ("rows", "columns", "rows_back")]
        for kernel, arguments in zip(
            kernels, [(field, between, w), (between, H, w), (between, out, w)], strict=True
        ):
            kernel.set_args(*arguments)
        lines, items = (n, m // columns, n), m // 8
        times = []
        for _ in range(repeats + 1):
            events = [
                cl.enqueue_nd_range_kernel(queue, kernel, (count * items,), (items,))
                for kernel, count in zip(kernels, lines, strict=True)
            ]
            queue.finish()
            passes = [event.profile.end - event.profile.start for event in events]
            times.append([*passes, events[-1].profile.end - events[0].profile.start])
        taken = np.median(np.array(times)[1:], axis=0) / 1e9
        got = np.empty_like(u)
        cl.enqueue_copy(queue, got, out)
        error = np.linalg.norm(got - exact) / np.linalg.norm(exact)
        click.echo(
            f"N {n}, groups of {group}, {columns} columns a work-group: rows, columns, rows, all "
            f"{', '.join(f'{t * 1e6:.0f}' for t in taken)} us, "
            f"{', '.join(f'{rate:.2f}' for rate in BYTES * n * n / taken / 1e12)} TB/s; "
            f"error {error:.1e}"
        )


@click.command()
@click.option("--device", "selector", default="gpu", show_default=True)
@click.option("--repeats", default=11, show_default=True, type=click.IntRange(1))
@click.option("--quick", is_flag=True, help="A small size.")
def main(selector: str, repeats: int, quick: bool) -> None:
    device = Device.open(selector)
    click.echo(f"{device!r}")
    for n in QUICK_SIZES if quick else SIZES:
        step(n, device, repeats)

