"""How right a Fourier light-field microscope is, and what it sees beside a conventional one.

    python benchmarks/accuracy_fourier_microscope.py [--device pocl] [--only waves,volumes,...]

A line for each figure with its limit; without a limit where it only informs. "waves": exposures
of three systems beside an independent float64 simulation. "equations": what `describe` says beside
what point images show; two points are resolved where their sum midway is as bright as one alone
(Houston 1927). "volumes", "native" and "pairs": the same objective, 20x/0.5, the same field, number
of pixels and voxels for the Fourier microscope and for one with lenslets on the native image, and
the same light in the pupil. "error" is the energy of the difference from the true volume over its
own, square root.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.ndimage import map_coordinates

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import reference_fourier
from setups_fourier import SMALL, SYSTEMS, camera_of, twin
from setups_microscope import SIDE, beads, filaments, projector_of, wrong

from clplen import Device, MicrolensArray, PlenopticCamera, PointSources, deconvolve
from clplen.cameras import FourierMicroscope, LensletLayout
from clplen.microscopy import FourierProjector, fourier_point_images, measure_point_images

Row = tuple[str, float, str, bool]
Vector = np.ndarray[Any, Any]
THIRTEEN = np.arange(-30, 31, 5) * 1e-6
PHOTONS = (2e6, 2e4)
WITHIN = 0.15  # of an equation
PLACES = {"square": 12e-6, "hexagonal": -6e-6, "seven": 2.5e-6}
SHAPES = {"beads": beads, "filaments": filaments}
ITERATIONS = 30


def below(name: str, found: float, most: float) -> Row:
    """A figure below another one."""
    return name, found, f"below {most:.3g}", found < most


def told(name: str, found: float) -> Row:
    """A figure without a limit."""
    return name, found, "", True


def waves(device: Device, quick: bool) -> Iterator[Row]:
    """All pixels, over the largest one."""
    for name in list(SYSTEMS)[: 1 if quick else None]:
        camera = camera_of(name, device)
        for z in (0.0, PLACES[name]):
            point = (2.1e-6, -3.3e-6, z)
            frame = camera.expose(PointSources(point)).to_numpy()
            expected = reference_fourier.frame(twin(camera), point)
            off = float(np.abs(frame - expected).max() / expected.max())
            text = f"{name}, NA {camera.na:g}, z = {z * 1e6:+.0f} um: difference over the maximum"
            yield below(text, off, 1e-3)


def equations(device: Device, quick: bool) -> Iterator[Row]:
    """Two points beside and behind each other; the depth of field."""
    for name in SYSTEMS:
        camera = camera_of(name, device)
        camera = replace(camera, pixel_pitch=camera.pixel_pitch / 4)
        whole = np.flatnonzero(camera.lit >= 0.95)
        far = np.hypot(*camera.lenslets.positions[whole].T)
        inner, outer = int(whole[far.argmin()]), int(whole[far.argmax()])
        x, z = camera.lateral_resolution, camera.axial_resolution
        for what, said, found in (
            ("lateral", x, _lateral(camera, inner)),
            ("axial", z, _axial(camera, outer, z)),
        ):
            yield told(f"{name}: {what} resolution of two points, um", found * 1e6)
            text = f"    over the equation's {said * 1e6:.3g} um, off by"
            yield below(text, abs(found / said - 1), WITHIN)
        depth = _depth(camera, inner)
        yield told(f"{name}: depth in which a point keeps .8 of its peak, um", depth * 1e6)
        yield told("    over the equation's depth of field", depth / camera.depth_of_field)


def _image(camera: FourierMicroscope, lenslet: int, z: float) -> tuple[Vector, Vector]:
    """The image behind a lenslet, and (y, x) of its first pixel from the axis point's."""
    layout = camera.lenslets
    alone = LensletLayout(
        layout.positions[lenslet][None],
        camera.sensor_distance,  # in focus at z = 0
        diameter=layout.diameter,
        fill=layout.fill,
    )
    one = replace(camera, lenslets=alone, field_stop=camera.field_stop / 3)
    images = fourier_point_images(one, [z], cut=0.05)
    return images.stored[0][0, 0], images.corners[0, 0] - images.centres[0]


def _lateral(camera: FourierMicroscope, lenslet: int) -> float:
    """Distance in the specimen at which two images are as bright midway as one alone."""
    image, corner = _image(camera, lenslet, 0.0)
    t = np.arange(0, 40, 0.02)
    profile = map_coordinates(image, [0 * t - corner[0], t - corner[1]], order=3)
    return float(2 * t[np.argmax(2 * profile < profile[0])] * camera.side)


def _axial(camera: FourierMicroscope, lenslet: int, about: float) -> float:
    """The same along z, in the sub-image of a lenslet."""
    distances = about * np.linspace(0.7, 1.4, 15)
    excess = []
    for distance in distances:
        midway, alone = 0.0, 0.0
        for z in (-distance / 2, distance / 2):
            image, corner = _image(camera, lenslet, z)
            midway += float(map_coordinates(image, -corner[:, None], order=3)[0])
            alone = max(alone, float(image.max()))
        excess.append(midway / alone - 1)
    return float(np.interp(0, excess[::-1], distances[::-1]))


def _depth(camera: FourierMicroscope, lenslet: int) -> float:
    """Range of z in which the peak behind a lenslet is .8 of the one in focus."""
    z = np.linspace(0, camera.depth_of_field, 21)
    peaks = np.array([_image(camera, lenslet, float(one))[0].max() for one in z])
    return 2 * float(np.interp(-0.8 * peaks[0], -peaks, z))


def adjoint(device: Device, quick: bool) -> Iterator[Row]:
    """<H f, g> and <f, H' g>."""
    rng = np.random.default_rng(1)
    for name, voxels in (("square", 1), ("seven", 2)):
        camera = camera_of(name, device)
        images = fourier_point_images(camera, [-3e-6, 0, 4e-6], voxels_per_pixel=voxels)
        projector = FourierProjector(images, (45, 52), device=device)
        f = rng.normal(size=projector.volume_shape)
        g = rng.normal(size=projector.frame_shape)
        seen = projector.forward(f, clamp=False).astype(float)
        off = abs(np.vdot(seen, g) - np.vdot(f, projector.backward(g).astype(float)))
        off /= np.linalg.norm(seen) * np.linalg.norm(g)
        yield below(f"{name}, {voxels} x {voxels} voxels a pixel: adjoint off by", float(off), 1e-5)


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


def volumes(device: Device, quick: bool) -> Iterator[Row]:
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
                    yield told(f"{name}, {photons:.0e} photons, {what}: {kind}", of_kind[what])
            for kind, of_kind in errors.items():
                what = f"until the noise, {kind}"
                yield told(f"{name}, {photons:.0e} photons, {what}", of_kind[what])


def native(device: Device, quick: bool) -> Iterator[Row]:
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
            yield told(f"{text}share of the light at z = 0", share[kind])
            yield told(f"{text}within 6.5 um", float(found[near].sum() / found.sum()))
            wrong_there = float(np.linalg.norm(found[near]) / np.linalg.norm(true))
            yield told(f"{text}error there, over all of the truth", wrong_there)


def pairs(device: Device, quick: bool) -> Iterator[Row]:
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
                yield told(text, float(dip))


def bead_stack(device: Device, quick: bool) -> Iterator[Row]:
    """Point images measured on frames of a bead off the axis, z of all frames 1.7 um off."""
    camera = PlenopticCamera.fourier_microscope(**(SMALL | {"pixel_pitch": 5e-6}), device=device)
    z, rng = np.arange(-20, 21, 10) * 1e-6, np.random.default_rng(0)
    at = rng.normal(size=(5, 2)) * 0.3e-6 + (2.3e-6, -1.1e-6)
    beads = [PointSources((x, y, one - 1.7e-6)) for one, (y, x) in zip(z, at, strict=True)]
    clean = np.maximum([camera.expose(one).to_numpy() for one in beads], 0)
    true = fourier_point_images(camera, z - 1.7e-6, cut=1e-4)
    truth = np.array([true.image(plane, (0, 0)) for plane in range(5)], np.float64)
    for photons in (0, 1e6, 1e5):
        stack = rng.poisson(clean * photons + 5) if photons else clean
        found = measure_point_images(camera, stack, z)
        text = f"bead, {photons:.0e} photons a frame and 5 a pixel: " if photons else "bead: "
        yield below(f"{text}z off by, um", abs(found.offset * 1e6 - 1.7), 0.1)
        off = float(np.abs(found.places - at).max() / camera.side)
        yield below(f"{text}its places off by, pixels", off, 0.05)
        seen = np.array([found.images.image(plane, (0, 0)) for plane in range(5)], np.float64)
        scale = np.vdot(seen, truth) / np.vdot(truth, truth)
        yield told(f"{text}point images, error (norm)", wrong(seen, truth * scale))
        if photons:
            raw = wrong(stack - 5.0, clean * photons)
            yield told(f"{text}the frames themselves, by noise", raw)


SECTIONS: dict[str, Callable[[Device, bool], Iterator[Row]]] = {
    one.__name__: one for one in (waves, equations, adjoint, bead_stack, volumes, native, pairs)
}


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--only", default=",".join(SECTIONS), show_default=True)
@click.option("--quick", is_flag=True, help="One system's waves only.")
def main(selector: str | None, only: str, quick: bool) -> None:
    """A table of figures and limits; ends with 1 where one is not met."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    met = True
    for name in only.split(","):
        for what, found, limit, is_met in SECTIONS[name](device, quick):
            met &= is_met
            click.echo(f"{what:<88}{found:>11.4g}   {limit}{'' if is_met else '  NOT MET'}")
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
