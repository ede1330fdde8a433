"""How right every propagation is, in dB, against closed forms and quadrature in float64.

    python -m benchmarks accuracy/propagation [--device pocl]

Every number is that of complex64, then of complex128 where the device has it; docs/accuracy.md
keeps a run, the tests hold the limits.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import click
import numpy as np
import setups
from setups import LAM
from tolerance import err_db, snr_db

from clplen import Device, Field, Grid, propagate, thin_lens

Array = np.ndarray[Any, Any]
EXACT: tuple[dict[str, Any], ...] = (
    {"method": "as", "pad": 1},
    {"method": "as"},
    {"method": "blas"},
    {"method": "cblas"},
    {"method": "rs"},
    {"method": "auto"},
)
STEPS: tuple[dict[str, Any], ...] = (
    {"method": "fresnel-multistep", "pad": 1, "border": 0},
    {"method": "fresnel-multistep", "border": 0},
    {"method": "fresnel-multistep"},
    {"method": "fresnel-tf"},
    {"method": "fresnel-ir"},
)


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table in Markdown."""
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in rows)]
    click.echo(f"\n{title}\n\n" + "\n".join(f"| {line} |" for line in lines))


def name(way: dict[str, Any]) -> str:
    """A method with its options in words."""
    words = [f"{key} {value:g}" for key, value in way.items() if key != "method"]
    return ", ".join([way["method"], *words])


def moved(
    u: Array, pitch: tuple[float, float], z: float, device: Device, way: dict[str, Any]
) -> Array:
    """A field one distance on, complex128."""
    grid = Grid((u.shape[0], u.shape[1]), pitch)
    field = Field.from_array(u, grid, wavelength=LAM, device=device)
    return propagate(field, z, **way).to_numpy().astype(complex)


def compared(
    make: Callable[[float], setups.SetUp],
    distances: Sequence[float],
    ways: Sequence[dict[str, Any]],
    devices: Sequence[Device],
    measure: Callable[[Array, Array], float],
) -> list[list[str]]:
    """A row a distance, a cell a method: dB on each device."""
    rows = []
    for distance in distances:
        case = make(distance)
        cells = [
            " / ".join(
                f"{measure(case.exact, moved(case.u, case.pitch, case.z, device, way)):.2f}"
                for device in devices
            )
            for way in ways
        ]
        rows.append([f"{distance:g}", *cells])
    return rows


def exact_methods(devices: Sequence[Device]) -> None:
    """Set-up A and the Gaussian on its grid."""
    head = ["z/S", *(name(way) for way in EXACT)]
    distances = (0.1, 1, 2, 4, 8, 16, 32, 64, 256, 1024)
    table(
        "Slit of half the window, 1024 samples of two wavelengths: SNR",
        head,
        compared(setups.set_up_a, distances, EXACT, devices, snr_db),
    )
    table(
        "Gaussian beam, w0 = S/16, same grid: error, nothing fitted",
        head,
        compared(setups.gaussian_a, distances, EXACT, devices, err_db),
    )


def fresnel_methods(devices: Sequence[Device]) -> None:
    """Slit of a quarter of the window against Fresnel integrals."""
    table(
        "Slit of a quarter of the window, 1024 samples, z in N dx^2/lam: error, nothing fitted",
        ["z", *(name(way) for way in STEPS)],
        compared(setups.slit_fresnel, (1, 4, 8, 16, 64), STEPS, devices, err_db),
    )


def point_image(devices: Sequence[Device]) -> None:
    """Image of a point, 2f to 2f."""
    case = setups.two_f()
    grid = Grid((case.u.shape[0], case.u.shape[1]), case.pitch)
    core = np.hypot(grid.y[:, None], grid.x) < 0.5e-3
    rows = []
    for way in ({"method": "as", "pad": 1}, {"method": "blas", "pad": 1}, *EXACT[1:], *STEPS):
        cells = []
        for device in devices:
            at_lens = moved(case.u, case.pitch, case.z1, device, way)
            field = Field.from_array(at_lens, grid, wavelength=LAM, device=device)
            behind = thin_lens(field, case.f, diameter=case.diameter).to_numpy().astype(complex)
            u = moved(behind, case.pitch, case.z2, device, way)
            peak = abs(u[grid.shape[0] // 2, grid.shape[1] // 2] / np.abs(case.image).max()) ** 2
            cells.append(
                f"{snr_db(case.image, u):.1f}, {snr_db(case.image[core], u[core]):.1f}, {peak:.5f}"
            )
        rows.append([name(way), *cells])
    table(
        "Image of a point, f = 120 mm, D = 3.6 mm, 1010 x 6.6 um: SNR in the window, within 0.5 mm "
        "of the axis, peak over Airy's",
        ["method", *(device.precision for device in devices)],
        rows,
    )


SHARES = (1e-2, 1e-4, 1e-6, 1e-10, 1e-14)  # of the light that arrives in the output


def dark_outputs(devices: Sequence[Device]) -> None:
    """complex64 against complex128 by how much of the light arrives: random set-ups of auto."""
    if len(devices) < 2:
        return
    rng = np.random.default_rng(7)
    found: dict[tuple[str, float], list[tuple[float, float]]] = {}
    for _ in range(SET_UPS):
        kind, share, of_window, of_light = _random_set_up(rng, devices)
        bound = max((one for one in SHARES if share >= one), default=None)
        if bound is not None:
            found.setdefault((kind, bound), []).append((of_window, of_light))
    rows = []
    for (kind, bound), pairs in sorted(found.items(), key=lambda one: (one[0][0], -one[0][1])):
        window, light = np.array(pairs).T
        cells = [f"{np.min(window):.0f}, {np.median(window):.0f}", f"{np.min(light):.0f}"]
        rows.append([kind, f"from {bound:.0e} on", str(len(pairs)), *cells])
    table(
        "Random grids, distances and output windows, complex64 against complex128: error of auto",
        [
            "light",
            "share in the output",
            "set-ups",
            "of what is there: lowest, median",
            "of all",
        ],
        rows,
    )


SET_UPS = 600


def _random_set_up(
    rng: np.random.Generator, devices: Sequence[Device]
) -> tuple[str, float, float, float]:
    """Kind of light, its share in the output, error in dB of what is there and of all the light."""
    shape = tuple(int(n) for n in rng.choice([31, 47, 64, 90, 127, 160], 2))
    pitch = tuple(LAM * rng.uniform(0.6, 12, 2))
    grid = Grid((shape[0], shape[1]), (pitch[0], pitch[1]))
    width = min(grid.extent)
    z = float(width * 10 ** rng.uniform(-1, 4))
    speckle, beside = rng.random(2) < 0.5
    waist = width / rng.uniform(6, 14)
    beam = np.exp(-((grid.y[:, None] / waist) ** 2) - (grid.x / waist) ** 2)
    u = np.exp(2j * np.pi * rng.random(shape)) if speckle else beam + 0j
    out = grid
    if beside:
        spread = width + z * LAM / max(pitch) / 4
        sizes = rng.choice([30, 47, 64], 2)
        dy, dx = spread / 64 * rng.uniform(0.5, 1.5, 2)
        oy, ox = spread * rng.uniform(-0.8, 0.8, 2)
        out = Grid((int(sizes[0]), int(sizes[1])), (dy, dx), origin=(oy, ox))
    single, double = (
        moved(u, grid.pitch, z, one, {"out_grid": out} if beside else {}) for one in devices
    )
    areas = [one.pitch[0] * one.pitch[1] for one in (out, grid)]
    whole = float(np.linalg.norm(u)) * np.sqrt(areas[1] / areas[0])
    there, error = float(np.linalg.norm(double)), float(np.linalg.norm(single - double))
    of_window = -20 * np.log10(error / there) if there else -np.inf
    return (
        "random phases" if speckle else "beam",
        (there / whole) ** 2,
        float(of_window),
        float(-20 * np.log10(error / whole)),
    )


@click.command()
@click.option("--device", "selector", default=None, help="As for Device.open.")
def main(selector: str | None) -> None:
    warnings.simplefilter("ignore")
    device = Device.open(selector)
    devices = [device]
    if device.has_fp64:
        devices.append(Device.open(device.place, precision="double"))
    click.echo(f"{device!r}")
    for part in (exact_methods, fresnel_methods, point_image, dark_outputs):
        part(devices)

