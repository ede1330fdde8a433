"""Where light fields of microscopes are sharpest, beside the paraxial law and beside rays.

    python benchmarks/accuracy_microscope_depth.py [--device pocl]

A line for each objective and depth: the disparity that `estimate_alpha` finds of one point over
that of the law d = -M^2 z dx/(n f_mu p), what rays say of it
(`clplen.lightfield.focus_ratio`), and the depth that is left when z is divided by
the latter, over the true one. Ends with 1 where that is off by more than 5 %. Depths are shares of
the light-field range about the native plane, lenslets matched. Half a minute.
"""

from __future__ import annotations

import sys
import warnings

import click

from clplen import (
    Device,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    SamplingWarning,
    estimate_alpha,
)
from clplen.cameras import Microscope
from clplen.lightfield import focus_ratio, focus_ratio_of_disparity

OBJECTIVES = {  # M, NA, n, wavelength, lenslets, pixels a lenslet
    "20x/0.3 air": (20, 0.3, 1.0, 525e-9, 125e-6, 27),
    "20x/0.5 air": (20, 0.5, 1.0, 525e-9, 125e-6, 25),
    "40x/0.8 water": (40, 0.8, 1.33, 610e-9, 100e-6, 15),
    "60x/1.0 water": (60, 1.0, 1.33, 593e-9, 100e-6, 15),
    "40x/0.8 air": (40, 0.8, 1.0, 610e-9, 100e-6, 15),
    "60x/1.2 water": (60, 1.2, 1.33, 593e-9, 100e-6, 15),
    "63x/1.4 oil": (63, 1.4, 1.515, 525e-9, 125e-6, 23),
}
SHARES = (-0.4, -0.25, 0.25, 0.4)
LIMIT = 0.05


def camera_of(name: str, device: Device, count: int = 31) -> Microscope:
    """One with as many lenslets a side."""
    magnification, na, n, wavelength, pitch, pixels = OBJECTIVES[name]
    mla = MicrolensArray(pitch, pitch * magnification / (2 * na), count=count, fill="full")
    return PlenopticCamera.microscope(
        magnification=magnification, na=na, medium_index=n, wavelength=wavelength,
        pixels_per_lenslet=pixels, mla=mla, device=device,
    )  # fmt: skip


def measured(camera: Microscope, z: float) -> tuple[float, float, float]:
    """(found over paraxial, rays over paraxial, depth by rays over the true one)."""
    lf = LightField.from_raw(camera.expose(PointSources([(0, 0, z)])))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        found = estimate_alpha(lf, at=(15, 15))
    by_rays = found.z / focus_ratio_of_disparity(camera, found.disparity)
    return found.disparity / camera.disparity(z), focus_ratio(camera, z), by_rays / z


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
def main(selector: str | None) -> None:
    """A table; ends with 1 where depth by rays is off by more than 5 %."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n\n{'':16}{'NA/n':>6}{'z um':>8}{'found':>8}{'rays':>8}{'z/rays':>8}")
    met = True
    for name in OBJECTIVES:
        camera = camera_of(name, device)
        for share in SHARES:
            z = share * camera.depth_range
            found, rays, left = measured(camera, z)
            ends = "" if abs(left - 1) <= LIMIT else "  NOT MET"
            met &= not ends
            sine = camera.na / camera.medium_index
            click.echo(
                f"{name:16}{sine:6.3f}{z * 1e6:8.2f}{found:8.3f}{rays:8.3f}{left:8.3f}{ends}"
            )
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
