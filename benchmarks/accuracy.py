"""How right each part is, as numbers: against float64 twins, closed forms and double precision.

    python benchmarks/accuracy.py [--device pocl]

The tests hold the limits; this prints what is reached (docs/accuracy.md keeps a run).
"""

from __future__ import annotations

import itertools
import sys
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import reference
from reference_camera import simulate_raw
from tolerance import err_db

from clplen import (
    Device,
    Field,
    Grid,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    Propagator,
    estimate_alpha,
    focal_stack,
    propagate,
    refocus,
)
from clplen.cameras import scene_energy
from clplen.demo import POINTS, SOURCE_DIAMETER, camera, scene


def say(what: str, value: str, limit: str = "") -> None:
    click.echo(f"  {what:<58} {value:<34} {limit}")


def transforms(device: Device) -> None:
    """Every FFT route that is installed, in place, against complex128."""
    rng = np.random.default_rng(4)
    for name, module in (
        ("ducc0", "ducc0"),
        ("scipy", "scipy"),
        ("numpy", "numpy"),
        ("vkfft", "pyvkfft"),
    ):
        if find_spec(module) is None or (name == "vkfft" and "Intel" in device.platform):
            say(f"FFT by {name}", "not here")
            continue
        worst = 0.0
        for shape in ((64, 64), (3, 509, 64), (1010, 1010), (3030, 30)):
            u = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
            data = device.upload(u)
            type(device.fft)(name, 2).forward(data, device)
            exact = np.fft.fft2(u.astype(np.complex128))
            error = np.abs(device.download(data) - exact).max() / np.abs(exact).max()
            worst = max(worst, float(error))
        say(f"FFT by {name}, 64 to 3030: error/maximum", f"{worst:.1e}", "3.8e-6")


def microlenses(device: Device) -> None:
    """Phase and edges of arrays of 9.37 px pitch, offset .4 px."""
    dx, p, f, lam = 5e-6, 9.37 * 5e-6, 2.5e-3, 532e-9
    grid = Grid((203, 256), dx, origin=(0, dx / 2))
    ones = Field.from_array(np.ones(grid.shape), grid, wavelength=lam, device=device)
    phase, edge = 0.0, 0.0
    for lattice, fill, degrees in itertools.product(
        ("square", "hexagonal"), ("circular", "full"), (0, 7, -30)
    ):
        layout = {
            "count": (17, 23),
            "lattice": lattice,
            "fill": fill,
            "offset": (0.4 * dx, -1.3 * dx),
            "rotation": np.deg2rad(degrees),
        }
        got = MicrolensArray(p, f, **layout).apply(ones).to_numpy()
        twin = reference.microlens_array(
            grid.shape, dx, pitch=p, f=f, wavelength=lam, origin=grid.origin, **layout
        )
        lit = np.abs(twin) > 1e-2
        phase = max(phase, float(np.abs(np.angle(got[lit] * twin[lit].conj())).max()))
        edge = max(edge, float(np.abs(np.abs(got) - np.abs(twin)).max()))
    say("lenslets, 12 layouts: largest phase error", f"{phase:.1e} rad", "1e-5")
    say("lenslets, 12 layouts: largest error of coverage", f"{edge:.1e}", "1e-3")


def fields(device: Device) -> None:
    """complex64 against complex128 at camera distances, and H where tables serve."""
    grid = Grid((1010, 1010), 6.6e-6)
    r2 = grid.y[:, None] ** 2 + grid.x[None, :] ** 2
    inside = np.multiply.outer(*(np.abs(c) < grid.extent[0] / 4 for c in (grid.y, grid.x)))
    turns = np.random.default_rng(2).random(grid.shape)
    starts = {
        "gaussian": np.exp(-r2 / (grid.extent[0] / 16) ** 2),
        "random square": np.fft.ifft2(np.fft.fft2(inside * np.exp(2j * np.pi * turns))),
    }
    for method, z in itertools.product(("as", "blas"), (0.010, 0.240)):
        decibels = []
        for u in starts.values():
            expected = reference.propagate(u, grid.pitch, z, 550e-9, method=method, pad=2)
            start = Field.from_array(u, grid, wavelength=550e-9, device=device)
            decibels.append(err_db(expected, propagate(start, z, method=method).to_numpy()))
        text = " / ".join(f"{d:.1f}" for d in decibels)
        say(f"{method}, 1010 x 6.6 um, z = {z:g} m: gaussian / square", f"{text} dB", "120")
    worst = 0.0
    for n, dx, z in ((1010, 6.6e-6, 0.24), (1010, 5e-6, 0.24), (1010, 6.6e-6, 1.0)):
        shape = (2 * n, 2 * n)
        whole = Propagator(
            Grid(shape, dx), z, wavelength=550e-9, method="blas", pad=1, device=device
        )
        plan = whole.description.factor
        twin = reference.transfer_function(shape, dx, z, 550e-9, band="blas")
        got = device.download(plan.on_device(device, "tables").values)
        assert plan.residual_turns() <= 1
        worst = max(worst, float(np.abs(got - twin[: n + 1, : n + 1]).max()))
    say("transfer function by tables, Rt <= 1: largest error", f"{worst:.1e}", "1e-5")


def light_fields(device: Device) -> None:
    """Refocus and focal stack against the float64 sum."""
    worst = 0.0
    rng = np.random.default_rng(1)
    for shape, dtype in itertools.product(
        ((4, 5, 31, 43), (6, 3, 29, 37, 3)), (np.uint8, np.uint16, np.float32)
    ):
        values = (rng.random(shape) * 250).astype(dtype)
        lf = LightField.from_array(values, device=device)
        planes = [-2, -1.37, -1, 0, 0.5, 1, 1.9, 2]
        stack = focal_stack(lf, disparities=planes).to_numpy()
        for d, picture in zip(planes, stack, strict=True):
            twin = reference.refocus(values.astype(np.float64), d)
            one = refocus(lf, disparity=d).to_numpy()
            for got in (picture, one):
                worst = max(worst, float(np.abs(got - twin).max() / twin.max()))
    say("refocus and stack, 3 dtypes, 1 and 3 channels: error/maximum", f"{worst:.1e}", "1e-5")


def cameras(device: Device) -> None:
    """The section 1.5 camera against the independent simulation and the printed numbers."""
    cam = camera(device)
    for name, point in POINTS.items():
        got = cam.expose(PointSources(point, diameter=SOURCE_DIAMETER)).to_numpy().astype(float)
        twin = simulate_raw(*point)
        cosine = float((got * twin).sum() / np.sqrt((got**2).sum() * (twin**2).sum()))
        error = float(np.abs(got - twin).max() / twin.max())
        say(
            f"raw image of {name}: 1 - correlation, error/maximum", f"{1 - cosine:.1e}, {error:.1e}"
        )
    energies = scene_energy(cam, PointSources(list(POINTS.values()), diameter=SOURCE_DIAMETER))
    text = " ".join(f"{at_array:.5f}" for _, at_array, _ in energies)
    say("energy at the array, A B C", text, ".99931 .99974 .99953")
    lost = max(abs(a - s) for _, a, s in energies)
    say("energy from array to sensor, largest change", f"{lost:.1e}", "1e-6")
    lf = LightField.from_raw(scene(cam))
    full = lf.render(total=True).to_numpy().sum(dtype=float)
    totals = [
        lf.render(aperture=n, total=True).to_numpy().sum(dtype=float) / full
        for n in (24, 18, 12, 6, 2)
    ]
    say(
        "totals for 24, 18, 12, 6, 2 views",
        " ".join(f"{t:.4g}" for t in totals),
        ".791 .493 .214 .0463 .00466",
    )
    say("calibrated decode keeps", f"{lf.to_numpy().sum(dtype=float) / 3:.4f}", ".964")
    share = {d: crosstalk(device, d) for d in (70e-6, 150e-6)}
    say("crosstalk at 70 and 150 um", f"{share[70e-6]:.3f} {share[150e-6]:.4f}", "> .45, .107")


def crosstalk(device: Device, d: float) -> float:
    """Energy of a centred in-focus point outside its own cell, 51 lenslets of 24 px."""
    array = MicrolensArray(d, 10e-3, count=51, fill="full")
    cam = PlenopticCamera.type1(
        focal_length=0.12, mla=array, wavelength=532e-9, pixels_per_lenslet=24, device=device
    )
    raw = cam.expose(PointSources((0, 0, 0))).to_numpy().astype(float)
    own = slice(25 * 24, 26 * 24)
    return float(1 - raw[own, own].sum() / raw.sum())


def depths(device: Device) -> None:
    """Errors of alpha on the axis and at (3, 3) mm."""
    cam = camera(device)
    steps = (-0.05, -0.025, 0.025, 0.05)
    errors: dict[str, list[float]] = {"compensated": [], "energy": [], "off axis": []}
    thesis, ratio = [], []
    for dz, x in itertools.product(steps, (0.0, 3e-3)):
        lf = LightField.from_raw(cam.expose(PointSources((x, x, dz), diameter=SOURCE_DIAMETER)))
        best = estimate_alpha(lf).alpha - cam.alpha(dz)
        errors["off axis" if x else "compensated"].append(best)
        if not x:
            found = estimate_alpha(lf, method="energy").alpha
            errors["energy"].append(found - cam.alpha(dz))
            ratio.append(((found - 1), (cam.alpha(dz) - 1)))
            thesis.append(estimate_alpha(lf, method="thesis").alpha)
    for name, values in errors.items():
        rms = np.sqrt(np.mean(np.square(values)))
        say(f"alpha error, {name}", " ".join(f"{v:+.4f}" for v in values), f"rms {rms:.4f}")
    a, b = np.array(ratio).T
    say("energy, pooled kappa", f"{(a @ b) / (b @ b):.3f}", ".86-.91")
    say("method thesis", " ".join(f"{t:.3f}" for t in thesis), ".82 .92 1.08 1.12")


PARTS: tuple[Callable[[Device], None], ...] = (
    transforms,
    microlenses,
    fields,
    light_fields,
    cameras,
    depths,
)


@click.command()
@click.option("--device", "selector", default=None, help="As for Device.open.")
def main(selector: str | None) -> None:
    """Print the accuracy of every part on a device."""
    warnings.simplefilter("ignore")
    device = Device.open(selector)
    click.echo(str(device))
    for part in PARTS:
        part(device)


if __name__ == "__main__":
    main()
