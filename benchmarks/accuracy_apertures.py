"""How right fields behind apertures are, in dB, by the edges of their masks, against closed forms.

    python benchmarks/accuracy_apertures.py [--device pocl]

z_c = N dx^2/lam. Slit and square: Fresnel integrals, over the whole window. Random pixels: the sum
of the Fresnel integrals of all. Circle: the Rayleigh-Sommerfeld I field on the axis (Osterberg and
Smith 1961), the error of that one value over the amplitude of the light. "Finer pixels" are an
area-weighted mask with a quarter of the pitch, taken by `transparency` with edges="pixels".
docs/accuracy.md keeps a run, tests/wave/test_edges.py holds the limits.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from reference_closed import circle_on_axis, fresnel_slit
from tolerance import err_db

from clplen import Device, Field, Grid, aperture, propagate
from clplen.wave import plane_wave, rectangular_aperture, transparency

LAM, N, DX = 550e-9, 512, 6.6e-6
EDGES = ("samples", "area", "pixels", "finer pixels")
FINER = 4
UNITS = (0.1, 0.2, 0.5, 1, 2, 5)
Array = np.ndarray[Any, Any]
Row = Callable[[float, str, Device], float]


def behind(field: Field, z: float) -> Array:
    """The paraxial field z behind, by the method that samples it."""
    n = max(field.grid.shape)
    method = "fresnel-tf" if z <= 4 * n * DX**2 / LAM else "fresnel-ir"
    return propagate(field, z, method=method, pad=4).to_numpy().astype(complex)


def cut_by(light: Field, edges: str, cut: Callable[..., Field], *args: Any, **more: Any) -> Field:
    """Light behind an aperture, its mask drawn on the samples of the light or on finer ones."""
    if edges != "finer pixels":
        return cut(light, *args, edges=edges, **more)
    (ny, nx), fine = light.grid.shape, DX / FINER
    shape = (1 if ny == 1 else FINER * ny, FINER * nx)
    finer = plane_wave(Grid(shape, fine), wavelength=LAM, device=light.device)
    mask = cut(finer, *args, **more).to_numpy().real
    return transparency(light, mask, pitch=fine, edges="pixels")


def slit(width: float, centre: float) -> Row:
    """A slit, width and centre in samples."""

    def error(z: float, edges: str, device: Device) -> float:
        light = plane_wave(Grid((1, N), DX), wavelength=LAM, device=device)
        middle = (0, centre * DX)
        cut = cut_by(light, edges, rectangular_aperture, width * DX, centre=middle)
        exact = fresnel_slit(light.grid.x - centre * DX, z, width=width * DX, wavelength=LAM)
        return err_db(exact[None].astype(complex), behind(cut, z))

    return error


def square(width: float, centre: tuple[float, float]) -> Row:
    """A square, width and centre in samples."""

    def error(z: float, edges: str, device: Device) -> float:
        light = plane_wave(Grid((N, N), DX), wavelength=LAM, device=device)
        middle = (centre[0] * DX, centre[1] * DX)
        cut = cut_by(light, edges, aperture, width * DX, shape="square", centre=middle)
        y, x = (
            fresnel_slit(t - m, z, width=width * DX, wavelength=LAM)
            for t, m in zip((light.grid.y, light.grid.x), middle, strict=True)
        )
        return err_db(np.outer(y, x), behind(cut, z))

    return error


def pixels(count: int) -> Row:
    """A mask of count x count random pixels, one a sample, in the middle of the window."""
    n = 2 * count
    mask = np.zeros((n, n))
    lit = slice(n // 4, n // 4 + count)
    mask[lit, lit] = np.random.default_rng(3).random((count, count)) > 0.5

    def error(z: float, edges: str, device: Device) -> float:
        light = plane_wave(Grid((n, n), DX), wavelength=LAM, device=device)
        z = z * n / N  # in z_c of this window
        apart = light.grid.x[:, None] - light.grid.x
        one = fresnel_slit(apart, z, width=DX, wavelength=LAM)
        return err_db(one @ mask @ one.T, behind(transparency(light, mask, edges=edges), z))

    return error


def circle(diameter: float) -> Row:
    """A circle about the axis, diameter in samples: the value on the axis."""

    def error(z: float, edges: str, device: Device) -> float:
        light = plane_wave(Grid((N, N), DX), wavelength=LAM, device=device)
        got = propagate(cut_by(light, edges, aperture, diameter * DX), z)
        value = got.to_numpy()[N // 2, N // 2]
        exact = circle_on_axis(z, radius=diameter * DX / 2, wavelength=LAM)
        return float(-20 * np.log10(abs(value - exact)))

    return error


ROWS: dict[str, tuple[Row, Sequence[str]]] = {
    "slit of 255 samples, edges on borders of cells": (slit(255, 0), EDGES),
    "slit of 187.37 samples, 11.3 off the middle": (slit(187.37, 11.3), EDGES),
    "square of 201 samples, edges on borders of cells": (square(201, (-7, 12)), EDGES),
    "square of 187.37 samples, off the middle": (square(187.37, (-7.1, 11.3)), EDGES),
    "128 x 128 random pixels": (pixels(128), EDGES[:3]),
    "circle of 200.4 samples, on the axis": (circle(200.4), EDGES),
}


@click.command(help=__doc__)
@click.option("--device", "selector", default=None, help="As for Device.open.")
def main(selector: str | None) -> None:
    warnings.simplefilter("ignore")
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    click.echo(f"| mask | edges | {' | '.join(f'{q:g} z_c' for q in UNITS)} |")
    click.echo("| --- " * (2 + len(UNITS)) + "|")
    for name, (error, all_edges) in ROWS.items():
        for edges in all_edges:
            cells = [f"{error(q * N * DX**2 / LAM, edges, device):.1f}" for q in UNITS]
            click.echo(f"| {name} | {edges} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
