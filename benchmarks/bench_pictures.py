"""A self-luminous picture through the thesis' camera (section 1.5), beside its bare transforms.

    python benchmarks/bench_pictures.py [--device pocl] [--samples 64] [--width 7e-3] [--quick]

The picture is a smooth random one without symmetry. The bare transforms are those that the
exposure counted, shape by shape, timed in the same run through the device's own route; one field a
sample is timed on a few samples. Only the ratios mean something on another machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import click
import numpy as np

from clplen import Device, MicrolensArray, PicturePlane, PlenopticCamera, PointSources
from clplen.cameras import Plenoptic1
from clplen.lightfield import Exposure


def picture(samples: int, width: float, dz: float) -> PicturePlane:
    """Random samples, smoothed a little, none of them dark."""
    values = np.random.default_rng(1).random((samples, samples))
    values += np.roll(values, 1, axis=0) + np.roll(values, 1, axis=1)
    return PicturePlane(values, width, dz)


def seconds(run: Callable[[], Any], device: Device) -> float:
    """Of one run, until the device is done."""
    device.finish()
    start = time.perf_counter()
    run()
    device.finish()
    return time.perf_counter() - start


def bare(exposure: Exposure, device: Device) -> float:
    """Seconds of the transforms that an exposure counted."""
    total = 0.0
    for count, shape in exposure.transforms:
        field = device.zeros(shape, device.complex)
        device.fft.forward(field, device)
        times = [seconds(lambda f=field: device.fft.forward(f, device), device) for _ in range(5)]
        total += count * float(np.median(times))
    return total


def thesis_camera(device: Device, lenslets: int) -> Plenoptic1:
    """Section 1.5: 101 x 101 lenslets of 30 pixels, F = 240 mm, D = 3.6 mm."""
    return PlenopticCamera.type1(
        focal_length=0.12,
        mla=MicrolensArray(150e-6, 10e-3, count=lenslets, fill="full"),
        wavelength=532e-9,
        pixels_per_lenslet=30,
        device=device,
    )


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--samples", default=64, show_default=True, help="Of the picture, along each axis.")
@click.option("--width", default=7e-3, show_default=True, help="Of the picture in metres.")
@click.option("--dz", default=0.0, show_default=True, help="Of the picture in metres.")
@click.option("--quick", is_flag=True, help="31 x 31 lenslets and a picture of 1 mm.")
def main(selector: str | None, samples: int, width: float, dz: float, quick: bool) -> None:
    """Time, transforms and error of a picture by patterns, and the time of one field a sample."""
    device = Device.open(selector)
    camera = thesis_camera(device, 31 if quick else 101)
    plane = picture(samples, min(width, 1e-3) if quick else width, dz)
    few = PointSources(plane.positions()[:: max(1, samples**2 // 3)])
    camera.expose(PointSources((0, 0, 0)))  # builds kernels and tables
    raws = []
    by_points = seconds(lambda: camera.expose(few), device) / len(few)
    by_patterns = seconds(lambda: raws.append(camera.expose(plane, method="isoplanatic")), device)
    exposure = raws[0].exposure
    transforms = bare(exposure, device)
    click.echo(repr(device))
    click.echo(f"{samples} x {samples} samples on {plane.width:g} m, dz = {dz:g} m: {exposure}")
    click.echo(f"patterns         {by_patterns:9.1f} s")
    click.echo(f"bare transforms  {transforms:9.1f} s, ratio {by_patterns / transforms:.2f}")
    click.echo(
        f"one field a sample {by_points:.2f} s each, {samples**2} samples "
        f"{by_points * samples**2:.0f} s, {by_points * samples**2 / by_patterns:.1f} times as long"
    )


if __name__ == "__main__":
    main()
