"""Kernels that multiply fields, beside a complex multiplication of as many samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from clplen.bench import ceilings
from clplen.bench.measure import Case, Times, finished, in_turn
from clplen.bench.report import Goal, Report, time_rows
from clplen.bench.sizes import halved, numbers
from clplen.compute.blocks import Spectrum, multiplied
from clplen.wave.elements.lens import thin_lens
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.transfer_function import Transfer

if TYPE_CHECKING:
    from clplen.compute.device import Device

SUMMARY = "lenses and transfer functions of N x N samples, beside a complex multiplication"
SIZES = ("4096",)
QUICK = "128"
PITCH, WAVELENGTH, DISTANCE, FOCAL = 6.6e-6, 550e-9, 0.1, 5.0
_LEAST = 1024  # samples a side from which the goals hold: below, starting a kernel counts
_MADE = {"Intel": 1.6, "": 3.5}  # over a multiplication, by the beginning of the platform's name
_LENS, _APPLIED = 2.0, 1.5


def smaller(size: str) -> str:
    """Half the samples a side."""
    return halved(size, (0,), 16)


def needs(size: str) -> int:
    """Eight arrays of complex samples."""
    (n,) = numbers(size, (1,), "N")
    return 8 * 8 * n * n


def run(device: Device, size: str, repeats: int) -> Report:
    """Each kernel over whole arrays that are there; results of a lens are new arrays."""
    (n,) = numbers(size, (1,), "N")
    rng = np.random.default_rng(3)
    u = rng.random((n, n), dtype=np.float32) + np.complex64(1j)
    field = Field.from_array(u, Grid((n, n), PITCH), wavelength=WAVELENGTH, device=device)
    work, phases = (device.upload(np.exp(1j * u.real).astype(device.complex)) for _ in range(2))
    whole = Spectrum(phases, (n, n))
    part = np.exp(1j * u.real[: n // 2 + 1, : n // 2 + 1]).astype(device.complex)
    quadrant = Spectrum(device.upload(part), (n, n))
    H, diameter = _transfer(n), n * PITCH / 2

    def case(name: str, do: Callable[[], object]) -> Case:
        return Case(name, finished(do, device), float(n * n), "samples")

    cases = [
        case("complex multiplication", lambda: multiplied(work, whole, device, copy=False)),
        case("transfer function, whole", lambda: H.on_device(device, "tables")),
        case("quadrant applied", lambda: multiplied(work, quadrant, device, copy=False)),
        case("thin lens", lambda: thin_lens(field, FOCAL)),
        case("thin lens with its disc", lambda: thin_lens(field, FOCAL, diameter=diameter)),
        case("stigmatic lens", lambda: thin_lens(field, FOCAL, form="stigmatic")),
        ceilings.copy(device, n * n * device.complex.itemsize),
    ]
    times = in_turn(cases, repeats)
    goals = tuple(_goals(device, times)) if n >= _LEAST else ()
    rows = time_rows(times, times[0])
    return Report("fields", size, "time over a complex multiplication", rows, goals)


def _transfer(n: int) -> Transfer:
    """H at n x n frequencies of an FFT of as many samples, none of them mirrored."""
    f = np.fft.fftfreq(n, PITCH)
    return Transfer((n, n), (f, f), (np.ones(n), np.ones(n)), DISTANCE, WAVELENGTH)


def _goals(device: Device, times: list[Times]) -> list[Goal]:
    _, made, quadrant, lens, *_ = (t.over(times[0]) for t in times)
    limit = next(m for name, m in _MADE.items() if device.platform.startswith(name))
    return [
        Goal("transfer function, whole", made, limit, "at most"),
        Goal("quadrant applied", quadrant, _APPLIED, "at most"),
        Goal("thin lens", lens, _LENS, "at most"),
    ]
