"""A zoomed focus beside a plain matrix Fourier transform: two matrix products in NumPy.

python benchmarks/bench_zoom.py [--device pocl] [--size 1024x512] [--repeats 9]
"""

from __future__ import annotations

import numpy as np
from script import command

from clplen import Device, Field, Grid, Propagator
from clplen.bench import Benchmark, Case, Report, finished, in_turn, numbers, time_rows

FORM = "INxOUT samples a side"
PITCH, FOCAL_LENGTH, WAVELENGTH = 5e-6, 0.2, 633e-9
_SPOT = 0.4  # of lam f/D, the pitch of the output


def smaller(size: str) -> str:
    """Half as many samples of both."""
    n, m = numbers(size, (2,), FORM)
    return f"{n // 2}x{m // 2}" if m > 32 else ""


def needs(size: str) -> int:
    """Field, lens, the matrices, and the transfer function over four times the samples."""
    n, m = numbers(size, (2,), FORM)
    return 16 * (12 * n * n + 2 * n * m + m * m)


def measure_zoom(device: Device, size: str, repeats: int) -> Report:
    """The field of a lens in its focus: exact by auto, paraxial by fresnel-1fft, by products."""
    n, m = numbers(size, (2,), FORM)
    grid = Grid((n, n), PITCH)
    out = Grid((m, m), _SPOT * WAVELENGTH * FOCAL_LENGTH / (n * PITCH))
    r2 = grid.y[:, None] ** 2 + grid.x**2
    u = np.exp(-r2 / (n * PITCH / 4) ** 2).astype(np.complex64)
    lens = np.exp(-1j * np.pi * r2 / (WAVELENGTH * FOCAL_LENGTH)).astype(np.complex64)
    turns = np.multiply.outer(out.x, grid.x) / (WAVELENGTH * FOCAL_LENGTH)
    there = np.exp(-2j * np.pi * turns).astype(np.complex64)
    back = np.ascontiguousarray(there.T)

    def case(name: str, values: np.ndarray, **options: object) -> Case:
        field = Field.from_array(values, grid, wavelength=WAVELENGTH, device=device)
        made = Propagator(
            grid, FOCAL_LENGTH, wavelength=WAVELENGTH, device=device, out_grid=out, **options
        )
        return Case(f"{name}: {made.description.route}", finished(lambda: made(field), device))

    cases = [
        Case("two matrix products (NumPy)", lambda: there @ u @ back),
        case("auto, exact", u * lens),
        case("fresnel-1fft, paraxial", u, method="fresnel-1fft", lens=FOCAL_LENGTH),
    ]
    times = in_turn(cases, repeats)
    return Report("zoom", size, "time over the products", time_rows(times, times[0]), ())


BENCHMARK = Benchmark(
    "zoom",
    "a zoomed focus against two matrix products",
    sizes=("1024x512", "2048x256", "512x64"),
    quick="64x32",
    needs=needs,
    run=measure_zoom,
    smaller=smaller,
)

if __name__ == "__main__":
    command(BENCHMARK, __doc__)()
