"""What partially coherent light reaches, beside the limit that the tests hold.

    python benchmarks/accuracy_coherence.py [--device NAME]

Prints measured figures in a minute or two: degrees of coherence, speckle contrasts, convergence to
the exact sum, the predicted signal-to-noise ratio, edges, spectra, reported errors.
"""

from __future__ import annotations

import math
import warnings

import click
import numpy as np
from scipy.special import j1

from clplen import Coherence, Device, Field, Grid, OpticalSystem, SamplingWarning, Spectrum
from clplen.wave import ExtendedSource, Pupil, RandomPhaseMask, measured_degree, usaf1951

LAM, FC = 550e-9, 13636.0  # m; 1/m: D/(2 lam z2) of D = 3.6 mm at 240 mm


def say(what: str, value: str, limit: str) -> None:
    """One line of the table."""
    print(f"  {what:<66} {value:<26} {limit}")


def ones(grid: Grid, device: Device) -> Field:
    return Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)


def fields(model: object, grid: Grid, device: Device, count: int, seed: int = 3) -> list[Field]:
    return [
        model.field(grid, wavelength=LAM, device=device, seed=seed, index=index)  # type: ignore
        for index in range(count)
    ]


def masks(device: Device) -> None:
    """Degrees of coherence and contrasts, N = 256, dx = 2 um, 32 cells, 40 masks."""
    grid, p = Grid((256, 256), 2e-6), 16e-6
    lags = np.arange(33)
    for kernel in ("square", "gaussian"):
        found = []
        for factor in (0, 0.25, 4):
            mask = RandomPhaseMask(p, kernel=kernel, distance=factor * p**2 / LAM)
            made = fields(mask, grid, device, 40)
            error = [
                measured_degree(made, lags, axis=axis, periodic=True).real
                - mask.degree(*((lags * 2e-6, 0) if axis == "y" else (0, lags * 2e-6)))
                for axis in ("y", "x")
            ]
            found.append(math.sqrt(np.mean(np.square(error))))
        text = " ".join(f"{value:.4f}" for value in found)
        say(f"{kernel} cells, rms of mu at d_c = 0, .25, 4 p^2/lam", text, "<= .01")
    for factor in (2, 4):
        mask = RandomPhaseMask(p, kind="phase", distance=factor * p**2 / LAM)
        mu = measured_degree(fields(mask, grid, device, 60), lags, axis="x", periodic=True).real
        rms = math.sqrt(np.mean((mu - mask.degree(0, lags * 2e-6)) ** 2))
        say(f"phase alone, rms of mu at {factor} p^2/lam", f"{rms:.4f}", "<= .01")
    row = []
    for factor in (0, 0.1, 0.25, 0.5, 1, 2, 4, 8):
        mask = RandomPhaseMask(p, distance=factor * p**2 / LAM)
        images = [np.abs(one.to_numpy()) ** 2 for one in fields(mask, grid, device, 12)]
        row.append(f"{np.mean([i.std() / i.mean() for i in images]):.3f}")
    say(
        "contrast at 0 .1 .25 .5 1 2 4 8 p^2/lam",
        " ".join(row),
        "0 .62 .81 1.03 .79 .944 .985 .998",
    )
    small = Grid((64, 64), 4e-6)
    for jitter in (True, False):
        mask = RandomPhaseMask(32e-6, distance=0.5 * 32e-6**2 / LAM, jitter=jitter)
        mean = sum(np.abs(one.to_numpy()) ** 2 for one in fields(mask, small, device, 400)) / 400
        limit = "<= 1.2 (times sqrt M)" if jitter else "the lattice stays"
        say(f"residual contrast times sqrt M, jitter {jitter}", f"{mean.std() * 20:.2f}", limit)


def source(device: Device) -> None:
    """van Cittert-Zernike: 400 snapshots, N = 96, dx = 4 um, D_s = 2 mm, d_c = .1 m."""
    grid = Grid((96, 96), 4e-6)
    light = ExtendedSource(2e-3, 0.1, points=200)
    made, lags = fields(light, grid, device, 400, seed=1), np.arange(48)
    v = np.pi * 2e-3 * lags * 4e-6 / (LAM * 0.1)
    law = np.divide(2 * j1(v), v, out=np.ones(48), where=v > 0)
    for axis in ("y", "x"):
        error = np.abs(measured_degree(made, lags, axis=axis) - law)
        text = f"{math.sqrt(np.mean(error**2)):.4f}, {error.max():.4f}"
        say(f"extended source, 48 lags along {axis}: rms, largest", text, "<= .01, <= .02")
    mean = sum(np.abs(one.to_numpy()) ** 2 for one in made) / 400
    say("its ensemble contrast times sqrt M", f"{mean.std() / mean.mean() * 20:.3f}", ".85 to 1.15")


def imaging(device: Device) -> None:
    """Snapshots against the exact sum and the plan, through a pupil."""
    grid, system = Grid((256, 256), 10e-6), OpticalSystem([Pupil.of_cutoff(FC, LAM)])
    target = usaf1951(grid, groups=[3, 4])
    thing = Field.from_array(target, grid, wavelength=LAM, device=device)
    for iota, cells in ((0.56, 32), (1.12, 64), (2.24, 128)):
        light = Coherence(RandomPhaseMask(256 * 10e-6 / cells), seed=5)
        exact = system(thing, coherence=light, method="abbe").to_numpy().astype(float)
        row = []
        for snapshots in (100, 400):
            found = system(thing, coherence=light, snapshots=snapshots, method="monte-carlo")
            error = np.linalg.norm(found.to_numpy() - exact) / np.linalg.norm(exact)
            row.append(f"{error * math.sqrt(snapshots):.2f}")
        say(f"iota {iota}: error times sqrt M, M = 100, 400", " ".join(row), "<= 1.5")
    clear = ones(grid, device)
    for kind in ("field", "phase"):
        row = []
        for iota in (0.14, 0.56, 2.24):
            plan = Coherence.plan(system, snr=10, grid=grid, wavelength=LAM, iota=iota, kind=kind)
            light, values = plan.coherence.spatial, []
            for seed in range(3):
                image = system(
                    clear, coherence=Coherence(light, seed=seed), snapshots=plan.snapshots,
                    method="monte-carlo",
                ).to_numpy()  # fmt: skip
                values.append((image.std() / image.mean()) ** 2)
            row.append(f"{1 / math.sqrt(np.mean(values)) / plan.snr:.2f}")
        say(f"{kind} masks, SNR over the plan's, iota .14 .56 2.24", " ".join(row), ".85 to 1.15")
    runs = [
        system(clear, coherence=Coherence(light, seed=seed), snapshots=40, method="monte-carlo")
        for seed in range(20)
    ]
    scatter = np.std([run.to_numpy() for run in runs], axis=0, ddof=1)
    reported = np.array([run.standard_error.to_numpy() for run in runs])
    ratio = math.sqrt(np.mean(reported**2) / np.mean(scatter**2))
    say("reported error over the scatter of 20 runs", f"{ratio:.3f}", ".8 to 1.25")


def spectra(device: Device) -> None:
    """Temporal coherence, and a white LED as it is sampled more finely."""
    led = Spectrum.gaussian(550e-9, 30e-9)
    lengths = [led.coherence_length(name) * 1e6 for name in ("goodman", "fwhm", "oct")]
    text = " ".join(f"{length:.3f}" for length in lengths)
    say("550/30 nm: coherence lengths / um", text, "6.698 8.899 4.449")
    for n, limit in ((9, ".2 (over 1.5 FWHM)"), (15, "<= 3.5e-4"), (21, "<= 1.5e-6")):
        error = led.error(n, 3 * lengths[0] * 1e-6, span=1.5 if n == 9 else 2.0)
        say(f"largest error of |gamma| within 3 l_c, n = {n}", f"{error:.3g}", limit)
    grid, system = Grid((192, 192), 8e-6), OpticalSystem([Pupil(3.6e-3, 0.24)])
    thing = Field.from_array(usaf1951(grid, groups=[3, 4]), grid, wavelength=LAM, device=device)
    images = [
        system(thing, coherence=Coherence(None, Spectrum.white_led(), wavelengths=n)).to_numpy()
        for n in (41, 82)
    ]
    change = np.linalg.norm(images[1] - images[0]) / np.linalg.norm(images[1])
    say("white LED, coherent image of a target, n = 41 to 82", f"{change:.2g}", "< 1e-3")


@click.command()
@click.option("--device", "selector", help="as for Device.open")
def main(selector: str | None) -> None:
    """Print what is reached."""
    device = Device.open(selector)
    print(f"{device!r}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)  # short distances are measured on purpose
        for part in (masks, source, imaging, spectra):
            part(device)


if __name__ == "__main__":
    main()
