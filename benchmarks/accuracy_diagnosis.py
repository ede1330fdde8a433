"""Frames of a light-field microscope with a fault each: the volume before and after it is told.

    python benchmarks/accuracy_diagnosis.py [--device pocl] [--only pupil,hot,...]

Simulated frames of 13 x 13 lenslets, six planes, 3 x 3 voxels a lenslet, 20 iterations, Poisson
noise; the white frame is even light of the true optics. Systems: 20x/0.5 in air, 60x/1.2 in water,
40x/0.8 in water, 63x/1.4 in oil. Volumes: a shell, beads, and a smooth random one. "alarm" is what
the residual's verdict says. Five minutes in all.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import click
import numpy as np
import tifffile
from scipy.ndimage import gaussian_filter, map_coordinates

from clplen import Device, MicrolensArray, PlenopticCamera, Projector, point_images
from clplen.lightfield import Lattice
from clplen.microscopy import (
    DeconvolutionSettings,
    Deconvolver,
    EvenLight,
    FourierProjector,
    FrameProjector,
    PointImages,
    binning_error,
    fourier_point_images,
    preparation,
    square_lattice,
    suitable_binning,
)

Values = Any
LENSLETS = 13
PHOTONS = 200  # of a pixel, mean
WHITE = 2000


@dataclass(frozen=True)
class System:
    """Optics, and the planes about the native one."""

    magnification: float
    na: float
    index: float
    wavelength: float
    pitch: float
    focal_length: float
    pixels: int
    farthest: float

    def camera(
        self,
        device: Device,
        binning: int = 3,
        *,
        lattice: Literal["square", "hexagonal"] = "square",
        **change: Any,
    ) -> Any:
        """With pixels of the sensor in parts."""
        given: dict[str, Any] = {"na": self.na, "medium_index": self.index, **change}
        return PlenopticCamera.microscope(
            magnification=self.magnification, wavelength=self.wavelength, device=device,
            mla=MicrolensArray(
                self.pitch, self.focal_length, count=5, fill="full", lattice=lattice
            ),
            pixels_per_lenslet=self.pixels * binning, **given,
        )  # fmt: skip

    def images(self, device: Device, **change: Any) -> PointImages:
        """On six planes."""
        planes = self.farthest * np.array([-1, -0.6, -0.2, 0.2, 0.6, 1])
        camera = self.camera(device, **change)
        return point_images(camera, planes, voxels_per_lenslet=3, binning=3, cut=5e-3)


SYSTEMS = {
    "20x/0.5": System(20, 0.5, 1.0, 525e-9, 125e-6, 2.5e-3, 15, 40e-6),
    "60x/1.2": System(60, 1.2, 1.33, 593e-9, 100e-6, 2.5e-3, 15, 12e-6),
    "40x/0.8": System(40, 0.8, 1.33, 610e-9, 150e-6, 3.75e-3, 13, 25e-6),
}
OIL = System(63, 1.4, 1.518, 520e-9, 125e-6, 2.8e-3, 15, 4e-6)


def volumes(shape: tuple[int, ...]) -> Iterator[tuple[str, Values]]:
    """Three that have nothing in common."""
    rng = np.random.default_rng(4)
    z, y, x = (
        np.arange(n).reshape([-1 if k == axis else 1 for k in range(3)]) - (n - 1) / 2
        for axis, n in enumerate(shape)
    )
    away = np.sqrt((z / 2.3) ** 2 + ((y - 2) / 12) ** 2 + ((x + 1) / 13) ** 2)
    yield "shell", np.exp(-0.5 * ((away - 1) / 0.12) ** 2) + 0.02
    beads = np.zeros(shape)
    for _ in range(12):
        beads[tuple(rng.integers((0, 6, 6), np.array(shape, int) - np.array((0, 6, 6))))] += (
            rng.uniform(0.5, 1)
        )
    yield "beads", beads
    yield "smooth", gaussian_filter(rng.random(shape), (1, 3, 3)) ** 4


def frame_of(projector: Projector, volume: Values, seed: int = 1) -> tuple[Values, float]:
    """Counts, and what multiplied the volume."""
    frame = projector.forward(volume)
    scale = PHOTONS * frame.size / float(frame.sum(dtype=float))
    return np.random.default_rng(seed).poisson(frame * scale).astype(float), scale


def white_of(images: PointImages, device: Device) -> Values:
    """Even light of the true optics, in photons."""
    about, n = images.parameters, images.pixels
    lattice = square_lattice(n, (LENSLETS * n, LENSLETS * n))
    mean = EvenLight(about).frame(lattice, about["na"], about["apodisation"], 3)
    mean = np.maximum(mean, 0) * WHITE
    return np.random.default_rng(2).poisson(mean).astype(float)


def judged(series: Deconvolver, frame: Values) -> tuple[float, str, Any, Any]:
    """Residual, whether there is an alarm, the volume, and the frame as it was prepared."""
    ready = series.prepared(frame)
    found = series(ready)
    said = series.diagnose(ready, found)
    return float(found.residuals[-1]), "alarm" if said else "no alarm", found.volume, ready


def pupil(device: Device) -> Iterator[str]:
    """Right parameters, a pupil 5 % smaller, apodisation off by a half either way."""
    for name, system in SYSTEMS.items():
        model = system.images(device)
        for fault, change in (
            ("right", {}), ("pupil 5 % smaller", {"na": 0.95 * system.na}),
            ("apodisation 1", {"apodisation": 1.0}), ("apodisation 0", {"apodisation": 0.0}),
        ):  # fmt: skip
            true = system.images(device, **change)
            with tempfile.TemporaryDirectory() as folder:
                white = Path(folder, "white.tif")
                tifffile.imwrite(white, white_of(true, device).astype(np.float32))
                before, plain, better = (
                    Deconvolver(
                        model, DeconvolutionSettings(radiometric=one), device=device, white=white
                    )
                    for one in (False, False, True)
                )
            assert plain.pupil is not None
            yield f"{name}, {fault}: {plain.pupil.sentence()}"
            before.pupil = None
            behind = Projector(true, (LENSLETS, LENSLETS), device=device)
            for kind, volume in volumes(behind.volume_shape):
                frame, _ = frame_of(behind, volume)
                found = [judged(one, frame)[:2] for one in (before, plain, better)]
                noise = frame.sum() / np.square(frame).sum()
                yield (
                    f"    {kind}: residual before {found[0][0]:.4f} ({found[0][1]}), after the "
                    f"same ({found[1][1]}), radiometric {found[2][0]:.4f} ({found[2][1]}); noise "
                    f"{noise:.4f}"
                )


KNOWN = """
magnification = 20
na = 0.5
medium_index = 1
wavelength = 525
ulens_pitch = 125
ulens_focal_length = 2500
pixel_size = {}
"""


def pixels(_: Device) -> Iterator[str]:
    """Pixels a lenslet that are nearly whole: what `psf` says of a frame before it computes."""
    with tempfile.TemporaryDirectory() as folder:
        path, frame = Path(folder, "known.toml"), Path(folder, "frame.tif")
        tifffile.imwrite(frame, np.zeros((331, 331), np.uint16))
        for across in (33.038, 33.000006, 32.95, 33.4):
            path.write_text(KNOWN.format(125 / across))
            words = ("microscope", "psf", path, "-o", Path(folder, "psf.h5"), "--frame", frame)
            call = [sys.executable, "-m", "clplen", *map(str, words), "--planes-um", "1:1:1"]
            said = subprocess.run(call, capture_output=True, text=True, check=False).stderr
            before = int(np.ceil(round(across, 6)))
            chosen = said.partition("lenslets of ")[2].partition(" x")[0]
            yield f"{across:g} pixels a lenslet: {before} before, {chosen} after"


def hot(device: Device) -> Iterator[str]:
    """Thirty hot pixels in rectified frames."""
    for name, system in SYSTEMS.items():
        images = system.images(device)
        projector = Projector(images, (LENSLETS, LENSLETS), device=device)
        yield from with_hot_pixels(name, projector, both(images, device=device))


def hot_hexagonal(device: Device) -> Iterator[str]:
    """The same behind hexagonal lenslets, in frames as the camera takes them."""
    system = SYSTEMS["20x/0.5"]
    images = system.images(device, lattice="hexagonal")
    n = images.pixels - 0.3  # turned, and no whole pixels a lenslet
    row, column = (0.75**0.5 * n, -0.02 * n), (0.02 * n, n)
    size = LENSLETS * images.pixels
    there = Lattice("hexagonal", (size / 2, size / 2 + 1), row, column, shape=(size, size))
    projector = FrameProjector(images, there, device=device)
    with tempfile.TemporaryDirectory() as folder:
        white = Path(folder, "white.tif")
        even = projector.forward(np.ones(projector.volume_shape))
        tifffile.imwrite(white, (WHITE * even / even.mean()).astype(np.float32))
        series = both(images, device=device, white=white)
        yield from with_hot_pixels("20x/0.5, hexagonal", projector, series)


def hot_fourier(device: Device) -> Iterator[str]:
    """The same in frames of a Fourier microscope."""
    camera = PlenopticCamera.fourier_microscope(
        magnification=20, na=0.5, wavelength=525e-9, relay=0.1, pixel_pitch=12e-6,
        mla=MicrolensArray(1e-3, 40e-3, count=5), device=device,
    )  # fmt: skip
    images = fourier_point_images(camera, np.arange(-25, 26, 10) * 1e-6)
    projector = FourierProjector(images, images.field, device=device)
    yield from with_hot_pixels("20x/0.5, Fourier", projector, both(images, device=device))


def both(images: Any, **given: Any) -> tuple[Deconvolver, Deconvolver]:
    """With hot pixels kept, and left out."""
    plain, careful = (
        Deconvolver(images, DeconvolutionSettings(keep_hot=one), **given) for one in (True, False)
    )
    return plain, careful


def with_hot_pixels(
    name: str, projector: Any, series: tuple[Deconvolver, Deconvolver]
) -> Iterator[str]:
    """Thirty pixels of half to all of 60 000 counts; light that is wrongly taken to be hot."""
    plain, careful = series
    for kind, volume in volumes(projector.volume_shape):
        frame, scale = frame_of(projector, volume)
        rng = np.random.default_rng(3)
        places = rng.choice(frame.size, 30, replace=False)
        spoilt = frame.copy()
        spoilt.flat[places] = rng.uniform(0.5, 1, 30) * 60000
        parts = []
        for which, one in ((plain, frame), (plain, spoilt), (careful, spoilt)):
            residual, _, found, ready = judged(which, one)
            alike = np.corrcoef(found.ravel(), (scale * volume).ravel())[0, 1]
            parts.append(f"{residual:.3f} ({alike:.2f})")
        yield (
            f"{name}, {kind}: residual (correlation) without hot pixels {parts[0]}, before "
            f"{parts[1]}, after {parts[2]}; {ready.hot} found, of the clean frame "
            f"{careful.prepared(frame).hot}"
        )


def binning(device: Device) -> Iterator[str]:
    """Point images beside those of parts half as large."""
    for name, system in (SYSTEMS | {"63x/1.4": OIL}).items():
        slope = system.na / system.magnification + system.pitch / (2 * system.focal_length)
        size = system.pitch / system.pixels
        before = int(2 * slope * size / system.wavelength) + 1
        after = suitable_binning(
            system.na, system.magnification, system.wavelength, system.pitch, system.focal_length,
            size,
        )  # fmt: skip
        errors = [
            binning_error(system.camera(device, b), np.array([system.farthest / 4]), b)
            for b in (before, after)
        ]
        yield (
            f"{name}, {system.pixels} pixels a lenslet: binning {before} leaves {errors[0]:.2%} "
            f"before, {after} leaves {errors[1]:.2%} after"
        )


def pitch(device: Device) -> Iterator[str]:
    """A frame whose lenslets lie 1.9 % farther apart than the parameters say."""
    system = SYSTEMS["20x/0.5"]
    images = system.images(device)
    about, n = images.parameters, images.pixels
    for ratio in (1.0, 1.003, 1.019):
        side = round(LENSLETS * n * ratio)
        lattice = square_lattice(n * ratio, (side, side))
        white = EvenLight(about).frame(lattice, about["na"], about["apodisation"], 3)
        white = np.maximum(white, 0) * WHITE
        prepare = preparation(n, device=device, white=white)
        assert prepare.lattice is not None
        measured = prepare.lattice.pitch[0] / n
        yield f"pitch {100 * (ratio - 1):.1f} % off: measured {100 * (measured - 1):.1f} %"


def lattice(device: Device) -> Iterator[str]:
    """A frame of 15.3 pixels a lenslet without a white frame, and with its lattice."""
    system = SYSTEMS["60x/1.2"]
    images = system.images(device)
    projector = Projector(images, (LENSLETS, LENSLETS), device=device)
    _, volume = next(iter(volumes(projector.volume_shape)))
    frame, _ = frame_of(projector, volume)
    ratio = 15.3 / images.pixels
    side = int(LENSLETS * 15.3)
    places = (np.indices((side, side)) + 0.5) / ratio - 0.5
    raw = np.maximum(map_coordinates(frame, places, order=3, mode="nearest"), 0)
    whole = raw[: side // 15 * 15, : side // 15 * 15]
    told = square_lattice(15.3, raw.shape)
    for name, grid, picture in (("taken as rectified", None, whole), ("told", told, raw)):
        series = Deconvolver(images, DeconvolutionSettings(), device=device, lattice=grid)
        residual, alarm, *_ = judged(series, picture)
        yield f"15.3 pixels a lenslet, lattice {name}: residual {residual:.3f}, {alarm}"


PARTS = {
    one.__name__: one
    for one in (pupil, pixels, hot, hot_hexagonal, hot_fourier, binning, pitch, lattice)
}


@click.command()
@click.option("--device", default=None, help="Selector of an OpenCL device.")
@click.option("--only", default=",".join(PARTS), help="Parts, comma-separated.")
def main(device: str | None, only: str) -> None:
    """Print a line for each fault."""
    opened = Device.open(device)
    unknown = set(only.split(",")) - set(PARTS)
    if unknown:
        sys.exit(f"no part {', '.join(sorted(unknown))}: {', '.join(PARTS)}")
    for name in only.split(","):
        click.echo(f"{name}: {PARTS[name].__doc__}")
        for line in PARTS[name](opened):
            click.echo(f"  {line}")


if __name__ == "__main__":
    main()
