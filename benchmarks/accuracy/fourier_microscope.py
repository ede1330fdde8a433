"""Volumes of a Fourier light-field microscope beside those of a conventional one.

    python -m benchmarks accuracy/fourier_microscope [--device pocl] [--only volumes,native,pairs]

The same objective, 20x/0.5, the same field, number of pixels and voxels, and the same light in the
pupil for the Fourier microscope and for the one with lenslets on the native image. "error" is the
norm of the difference from the true volume over its own norm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import click
import numpy as np
from setups_microscope import SIDE, beads, filaments, projector_of, wrong

from clplen import Device, MicrolensArray, PlenopticCamera, deconvolve
from clplen.microscopy import FourierProjector, fourier_point_images

Row = tuple[str, float]
Vector = np.ndarray[Any, Any]
THIRTEEN = np.arange(-30, 31, 5) * 1e-6
PHOTONS = (2e6, 2e4)
SHAPES = {"beads": beads, "filaments": filaments}
ITERATIONS = 30


def pair(device: Device, planes: Vector) -> dict[str, Any]:
    """Projectors of both microscopes: 20x/0.5 in air, 69 um, 55 x 55 voxels, 275^2 pixels."""
    fourier = PlenopticCamera.fourier_microscope(
        magnification=20, na=0.5, wavelength=525e-9, relay=0.1, pixel_pitch=18e-6,
        mla=MicrolensArray(1e-3, 72e-3, count=5, fill="full"), shape=(275, 275), device=device,
    )  # fmt: skip
    images = fourier_point_images(fourier, planes)
    assert abs(images.side / SIDE - 1) < 1e-9
    return {
        "conventional": projector_of(device, planes, 11),
        "Fourier": FourierProjector(images, (55, 55), device=device),
    }


def counted(projector: Any, volume: Vector, photons: float) -> tuple[Vector, Vector]:
    """A frame in photons of so many in the pupil, and the volume in those of each voxel."""
    scale = photons / volume.sum()
    frame = projector.forward(volume * scale).astype(np.float64)
    return np.random.default_rng(0).poisson(frame), volume * scale


def volumes(device: Device) -> Iterator[Row]:
    """Errors by Richardson and Lucy's iteration, of all planes, near the native one and far."""
    both = pair(device, THIRTEEN)
    parts = {"all planes": np.full(13, True), "z = 0": THIRTEEN == 0,
             "5 to 15 um": (abs(THIRTEEN) > 1e-6) & (abs(THIRTEEN) < 16e-6),
             "20 to 30 um": abs(THIRTEEN) > 16e-6}  # fmt: skip
    for name, shape in SHAPES.items():
        for photons in PHOTONS:
            errors: dict[str, dict[str, float]] = {}
            for kind, projector in both.items():
                frame, true = counted(projector, shape(projector), photons)
                found = deconvolve(frame, projector, iterations=ITERATIONS).volume
                errors[kind] = {
                    what: wrong(found[some], true[some])
                    for what, some in parts.items()
                    if true[some].any()
                }
                noise = deconvolve(frame, projector, iterations=60, residual="noise")
                text = f"until the noise, {kind}"
                errors[kind][text] = wrong(noise.volume, true)
            for what in (one for one in parts if one in errors["Fourier"]):
                for kind, of_kind in errors.items():
                    yield (f"{name}, {photons:.0e} photons, {what}: {kind}", of_kind[what])
            for kind, of_kind in errors.items():
                what = f"until the noise, {kind}"
                yield (f"{name}, {photons:.0e} photons, {what}", of_kind[what])


def native(device: Device) -> Iterator[Row]:
    """Filaments that leave out the native plane: what is found there."""
    both = pair(device, THIRTEEN)
    near = np.abs(THIRTEEN) < 6.5e-6
    for photons in PHOTONS:
        share: dict[str, float] = {}
        for kind, projector in both.items():
            volume = filaments(projector)
            volume[near] = 0
            frame, true = counted(projector, volume, photons)
            found = deconvolve(frame, projector, iterations=ITERATIONS).volume
            text = f"nothing within 6.5 um, {photons:.0e} photons, {kind}: "
            share[kind] = float(found[6].sum() / found.sum())
            yield (f"{text}share of the light at z = 0", share[kind])
            yield (f"{text}within 6.5 um", float(found[near].sum() / found.sum()))
            wrong_there = float(np.linalg.norm(found[near]) / np.linalg.norm(true))
            yield (f"{text}error there, over all of the truth", wrong_there)


def pairs(device: Device) -> Iterator[Row]:
    """Two points in one known plane, 1e6 photons, 60 iterations: least between over the lower."""
    for z in (0.0, 10e-6, 25e-6):
        both = pair(device, np.array([z]))
        for apart in (2, 3, 4):
            for kind, projector in both.items():
                volume = np.zeros(projector.volume_shape)
                first, second = 27 - apart // 2, 27 - apart // 2 + apart
                volume[0, 27, [first, second]] = 1
                frame, _ = counted(projector, volume, 1e6)
                row = deconvolve(frame, projector, iterations=60).volume[0, 27]
                dip = row[first : second + 1].min() / min(row[first], row[second])
                text = f"z = {z * 1e6:.0f} um, {apart * SIDE * 1e6:g} um apart: middle/peak, {kind}"
                yield (text, float(dip))


SECTIONS: dict[str, Callable[[Device], Iterator[Row]]] = {
    one.__name__: one for one in (volumes, native, pairs)
}


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--only", default=",".join(SECTIONS), show_default=True)
def main(selector: str | None, only: str) -> None:
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    for name in only.split(","):
        for what, value in SECTIONS[name](device):
            click.echo(f"{what:<88}{value:>11.4g}")
