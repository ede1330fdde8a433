"""Resolution and crosstalk of simulated plenoptic cameras beside independent numbers.

    python benchmarks/accuracy_resolution.py [--device pocl] [--quick]

Crosstalk: f_mu = 10 mm, f = 120 mm in 2f and 2f, matched f-numbers, 51 x 51 lenslets. The numbers
beside are of a float64 simulation whose light on the array is Airy's closed form, on 25 lenslets.
Focused camera: f_mu = 3 mm, m = 0.2, 101 x 101 lenslets, main lens of 10 mm; its numbers beside are
of a float64 simulation blended on a grid of 3 um, and the closed forms of a square lenslet.
"""

from __future__ import annotations

import sys

import click
import numpy as np

from clplen import Device, MicrolensArray, PlenopticCamera
from clplen.analysis import OTF, TwoPoints, camera_crosstalk, camera_psf

LAM = 532e-9
WIDTHS = (50, 70, 90, 100, 113.93, 135, 150, 175, 200, 250, 300)  # um
EXPECTED = {
    "full": (0.860, 0.514, 0.186, 0.185, 0.208, 0.096, 0.107, 0.061, 0.047, 0.031, 0.025),
    "circular": (0.878, 0.632, 0.240, 0.180, 0.166, 0.088, 0.086, 0.050, 0.038, 0.024, 0.020),
}
WITHIN = 0.02


def crosstalk_of(width: float, fill: str, device: Device) -> float:
    """Share outside its cell of a point that lies before the centre of the middle lenslet."""
    pixels = 24 if width < 180e-6 else 40
    camera = PlenopticCamera.type1(
        focal_length=0.120,
        mla=MicrolensArray(width, 0.010, count=51, fill=fill),
        wavelength=LAM,
        pixels_per_lenslet=pixels,
        device=device,
    )
    return camera_crosstalk(camera)


def crosstalk_table(device: Device, widths: tuple[float, ...]) -> bool:
    """Print it; whether all is within the limit."""
    click.echo(f"{'d / um':>8s}" + "".join(f"{fill:>10s}{'beside':>8s}" for fill in EXPECTED))
    good = True
    for width in widths:
        line = f"{width:8.1f}"
        for fill, values in EXPECTED.items():
            found, expected = crosstalk_of(width / 1e6, fill, device), values[WIDTHS.index(width)]
            line += f"{found:10.3f}{expected:8.3f}"
            good &= abs(found - expected) <= WITHIN
        click.echo(line)
    click.echo(f"within {WITHIN}: {'yes' if good else 'OUT OF TOLERANCE'}\n")
    return good


def focused_table(device: Device, count: int) -> bool:
    """FWHM, MTF and two points of the focused camera; whether all is within its limit."""
    camera = PlenopticCamera.type2(
        focal_length=0.120,
        mla=MicrolensArray(150e-6, 0.003, count=count, fill="full"),
        wavelength=LAM,
        pixels_per_lenslet=30,
        m=0.2,
        match="cone",
        device=device,
    )
    psf = camera_psf(camera)
    mtf, unit = OTF.of(psf).mtf(1), LAM * camera.a / 150e-6
    two = TwoPoints.incoherent(psf, axis=1)
    ratios = np.array((0.886, 1, 1.22, 1.5))
    mid = two.contrast(ratios * unit)
    rows = [
        ("FWHM / um", psf.fwhm(1) * 1e6, 62.9, 0.886 * unit * 1e6, 0.15),
        ("MTF50 / cycles per mm", mtf.at(0.5) * 1e-3, 6.84, 0.5e-3 / unit, 0.15),
        ("MTF10 / cycles per mm", mtf.at(0.1) * 1e-3, 13.3, 0.9e-3 / unit, 0.10),
        ("cut-off / cycles per mm", mtf.cutoff() * 1e-3, 15.66, 1e-3 / unit, 0.15),
    ]
    good = True
    click.echo(f"{'':26s}{'found':>9s}{'beside':>9s}{'closed':>9s}{'limit':>7s}")
    for name, found, expected, closed, limit in rows:
        good &= abs(found / expected - 1) <= limit
        click.echo(f"{name:26s}{found:9.2f}{expected:9.2f}{closed:9.2f}{limit:7.0%}")
    for ratio, found, expected in zip(ratios, mid, (1.0, 0.953, 0.668, 0.400), strict=True):
        click.echo(f"{f'mid/peak at {ratio:g} lam a/d':26s}{found:9.3f}{expected:9.3f}")
    good &= bool((np.diff(mid) < 0).all() and mid[2] < 0.75)
    click.echo(f"within its limits: {'yes' if good else 'OUT OF TOLERANCE'}")
    return good


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--quick", is_flag=True, help="Three widths of lenslets.")
def main(selector: str | None, quick: bool) -> None:
    """Tables of crosstalk and of a focused camera's resolution."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    good = crosstalk_table(device, WIDTHS[1:7:2] if quick else WIDTHS)
    if not (focused_table(device, 101) and good):
        sys.exit(1)


if __name__ == "__main__":
    main()
