"""Aberrations of the thesis' camera of section 1.5, and what a correction regains.

    python benchmarks/accuracy_aberrations.py [--device pocl] [--count 101] [--pixels 30]

f = 120 mm in 2f-2f, lenslets of 150 um and f_mu = 10 mm, 532 nm. Peak and energy in 3 x 3 lenslets
are those of the picture as focused, over the whole light. "of the loss" is what the correction
regains over what the aberration took. Out of focus: a point 50 mm behind the focused plane.
"""

from __future__ import annotations

import math
from typing import Any

import click
import numpy as np

import clplen
from clplen.analysis import PSF
from clplen.cameras import Aberrations, LensletScatter, correct_aberrations

WAVE = 532e-9
NAMES = {
    4: "defocus",
    5: "oblique astigmatism",
    6: "astigmatism",
    7: "coma in y",
    8: "coma in x",
    9: "trefoil in y",
    10: "trefoil in x",
    11: "spherical",
}
FOCUSED = clplen.PointSources((0, 0, 0), diameter=10e-6)
BEHIND = clplen.PointSources((0, 0, 50e-3), diameter=10e-6)
BUILT = {
    "as designed": Aberrations(),
    "focal lengths 2 %": Aberrations(scatter=LensletScatter(focal_length=0.02)),
    "focal lengths 10 %": Aberrations(scatter=LensletScatter(focal_length=0.1)),
    "tilt 0.5 mrad": Aberrations(scatter=LensletScatter(tilt=0.5e-3)),
    "tilt 2 mrad": Aberrations(scatter=LensletScatter(tilt=2e-3)),
    "position 5 um": Aberrations(scatter=LensletScatter(position=5e-6)),
    "position 20 um": Aberrations(scatter=LensletScatter(position=20e-6)),
    "sensor 1 mm nearer": Aberrations(sensor_shift=-1e-3),
    "sensor 1 mm farther": Aberrations(sensor_shift=1e-3),
    "sensor 3 mm farther": Aberrations(sensor_shift=3e-3),
}


def light(lf: Any) -> tuple[float, float]:
    """Peak, and energy in 3 x 3 lenslets about the middle, of the picture as focused."""
    picture = lf.render(total=True).to_numpy().astype(np.float64)
    y, x = (n // 2 for n in picture.shape)
    return float(picture.max()), float(picture[y - 1 : y + 2, x - 1 : x + 2].sum())


def seen(camera: Any, point: Any) -> Any:
    """The decoded light field of a point."""
    return clplen.LightField.from_raw(camera.expose(point))


def psf(camera: Any) -> PSF:
    """The main lens' image of a point on the axis."""
    field = camera.array_field(camera.pupil(clplen.PointSources((0, 0, 0)))).to_numpy()[0]
    intensity = np.abs(field).astype(np.float64) ** 2
    return PSF(intensity / intensity.sum(), camera.pixel_pitch, camera.grid.origin)


def strehl_ratios(camera: Any) -> None:
    """Of each low term with an rms of half a radian."""
    ideal, sigma = psf(camera), 0.5
    click.echo(f"Strehl ratio, sigma = {sigma} rad; exp(-sigma^2) = {math.exp(-(sigma**2)):.4f}")
    best = light(seen(camera, FOCUSED))[0]
    click.echo(f"of the main lens' image, and the picture's peak; without: {best:.4f}")
    for j, name in NAMES.items():
        one = Aberrations(main_lens={j: sigma * WAVE / (2 * math.pi)})
        bent = camera.with_aberrations(one)
        peak = light(seen(bent, FOCUSED))[0]
        click.echo(f"{j:3d} {name:20s}{psf(bent).strehl(ideal):8.4f}{peak:8.4f}")


def corrections(camera: Any) -> None:
    """Of one wave rms of each low term, in focus."""
    best = light(seen(camera, FOCUSED))
    click.echo(f"\n1 wave rms; without: peak {best[0]:.4f}, 3 x 3 lenslets {best[1]:.4f}")
    click.echo(f"{'':24s}{'peak':>8s}{'after':>8s}{'times':>7s}{'of the loss':>12s}", nl=False)
    click.echo(f"{'3 x 3':>10s}{'after':>8s}{'times':>7s}{'of the loss':>12s}")
    for j, name in NAMES.items():
        lf = seen(camera.with_aberrations(Aberrations(main_lens={j: WAVE})), FOCUSED)
        before, after = light(lf), light(correct_aberrations(lf, {j: WAVE}))
        line = f"{j:3d} {name:20s}"
        for was, found, full, width in zip(before, after, best, (8, 10), strict=True):
            share = (found - was) / (full - was)
            line += f"{was:{width}.4f}{found:8.4f}{found / was:7.2f}{100 * share:10.0f} %"
        click.echo(line)


def as_built(camera: Any) -> None:
    """What lenslets out of place and a moved sensor do to pictures and depth."""
    alpha = camera.alpha(50e-3)
    click.echo(f"\nLenslets and sensor; a point in focus, and one at alpha = {alpha:.4f}")
    click.echo(f"{'':24s}{'energy':>8s}{'peak':>8s}{'3 x 3':>8s}{'refocused':>11s}{'alpha':>8s}")
    for name, built in BUILT.items():
        one = camera.with_aberrations(built)
        raw = one.expose(FOCUSED)
        behind = seen(one, BEHIND)
        peak, near = light(clplen.LightField.from_raw(raw))
        picture = clplen.refocus(behind, alpha=alpha).to_numpy().max() * behind.weights.sum()
        found = clplen.estimate_alpha(behind).alpha
        energy = raw.to_numpy().sum(dtype=np.float64)
        click.echo(f"{name:24s}{energy:8.4f}{peak:8.4f}{near:8.4f}{picture:11.4f}{found:8.4f}")


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--count", default=101, show_default=True, help="Lenslets a row.")
@click.option("--pixels", default=30, show_default=True, help="Of a lenslet, across.")
def main(selector: str | None, count: int, pixels: int) -> None:
    """Strehl ratios, corrections, and cameras as they are built."""
    camera = clplen.PlenopticCamera.type1(
        focal_length=0.12,
        mla=clplen.MicrolensArray(150e-6, 10e-3, count=count, fill="full"),
        wavelength=WAVE,
        pixels_per_lenslet=pixels,
        device=clplen.Device.open(selector),
    )
    strehl_ratios(camera)
    corrections(camera)
    as_built(camera)


if __name__ == "__main__":
    main()
