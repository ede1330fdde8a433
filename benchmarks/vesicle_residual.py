"""What the residual of the vesicle's frame is made of: one cause at a time.

    python benchmarks/vesicle_residual.py [--device pocl] [--quick] [--unrectified]

`$CLPLEN_DATA`/lfm_guv holds the frames (see examples/guv_volume.py). Ten planes from -18 to 18 um,
3 x 3 voxels a lenslet, 20 iterations, haze kept out. The pupil is fitted to the frame itself, two
steps of seven terms. A line for each change, its residual, and its share of the first one. With
--unrectified instead the frame as the camera took it beside the rectified one: residuals, what of
them is photon noise, and how alike the volumes are.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import tifffile
from scipy.ndimage import map_coordinates

from clplen import Device, MicrolensArray, PlenopticCamera, Projector, deconvolve, point_images
from clplen.cameras import Microscope, PupilAberration
from clplen.microscopy import Preparation, Prepared, fit_pupil, preparation, raw_preparation

DATA = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))
GAIN = 1 / 0.46  # counts of a photoelectron
PLANES = np.linspace(-18, 18, 10) * 1e-6
WIDER = np.linspace(-26, 26, 14) * 1e-6
FINER = np.linspace(-19.5, 19.5, 40) * 1e-6
PIXELS, RAW, SENSOR = 16, 24, 100 / 6.5  # a lenslet: rectified, point images, camera
PARTS = 2  # of a pixel along an axis
TERMS = (5, 6, 7, 8, 9, 10, 11)
Vector = np.ndarray[Any, Any]


def microscope(device: Device, *, binning: int = 1, **change: Any) -> Microscope:
    """60x/1.2 in water, lenslets of 100 um."""
    values = {"magnification": 60, "na": 1.2, "medium_index": 1.35, "wavelength": 593e-9} | change
    array = MicrolensArray(100e-6, 2.5e-3, count=27, fill="full")
    across = values.pop("pixels", PIXELS)
    return PlenopticCamera.microscope(
        mla=array, pixels_per_lenslet=across * binning, device=device, **values
    )


class Vesicle:
    """The frame, prepared, and what a model leaves of it."""

    def __init__(self, device: Device) -> None:
        self.frame, self.white, self.dark = (
            tifffile.imread(DATA / "lfm_guv" / f"{name}_GUVExperim1.tif")
            for name in ("Lightfield", "Radiometry", "DarkFrame")
        )
        self.device = device
        self.prepare = preparation(PIXELS, device=device, white=self.white, dark=self.dark)
        self.seen = self.prepare(self.frame)
        self.haze = self.prepare.haze(self.seen.counts, self.seen.white)

    def left(
        self, camera: Microscope, planes: Vector = PLANES, *, iterations: int = 20,
        seen: Prepared | None = None, haze: Any = None, voxels: int = 3, binning: int = 1,
    ) -> float:  # fmt: skip
        """The residual that the last iteration found."""
        seen = self.seen if seen is None else seen
        images = point_images(camera, planes, voxels_per_lenslet=voxels, cut=5e-3, binning=binning)
        shape = tuple(size // images.pixels for size in seen.counts.shape)
        projector = Projector(images, (shape[0], shape[1]), device=self.device)
        found = deconvolve(
            seen.counts, projector, white=seen.white, iterations=iterations,
            background=self.haze if haze is None else haze,
        )  # fmt: skip
        return float(found.residuals[-1])

    def floor(self) -> float:
        """What photon noise alone leaves: its variance over the sum of the squares."""
        counts, on = self.seen.counts.astype(float), self.seen.white > 0
        noise = self.prepare.variance * GAIN * counts[on].sum()
        return float(noise / np.square(counts[on]).sum())


def moved(prepare: Preparation, y: float, x: float) -> Preparation:
    """The lattice moved by so many pixels of the camera."""
    assert prepare.lattice is not None
    cy, cx = prepare.lattice.origin
    return replace(prepare, lattice=replace(prepare.lattice, origin=(cy + y, cx + x)))


def without_outliers(vesicle: Vesicle) -> Prepared:
    """Pixels that stand six deviations above all of their neighbours are left out."""
    from scipy.ndimage import maximum_filter

    ring = np.ones((3, 3), bool)
    ring[1, 1] = False
    values = vesicle.frame.astype(float)
    highest = maximum_filter(values, footprint=ring)
    noise = np.sqrt(GAIN * np.maximum(highest - vesicle.dark, 1) + vesicle.prepare.noise**2)
    hot = values - highest > 6 * noise
    click.echo(f"  {hot.sum()} pixels stand out, {vesicle.seen.left_out} are saturated")
    return vesicle.prepare(np.where(hot, np.nan, values))


def causes(vesicle: Vesicle, quick: bool) -> Iterator[tuple[str, float]]:
    """(what was changed, residual)."""
    device = vesicle.device
    plain = microscope(device)
    yield "as it is", vesicle.left(plain)
    yield "photon noise alone", vesicle.floor()
    for many in (40, 80):
        yield f"{many} iterations", vesicle.left(plain, iterations=many)
    for y, x in ((0.25, 0), (-0.25, 0), (0, 0.25), (0, -0.25)):
        seen = moved(vesicle.prepare, y, x)(vesicle.frame)
        yield f"lattice moved by ({y:g}, {x:g}) pixels", vesicle.left(plain, seen=seen)
    for share in (0.9, 1.1, 0.0):
        yield f"haze times {share:g}", vesicle.left(plain, haze=share * vesicle.haze)
    yield "outliers left out", vesicle.left(plain, seen=without_outliers(vesicle))
    yield "planes to 26 um", vesicle.left(plain, WIDER)
    yield "index 1.33", vesicle.left(microscope(device, medium_index=1.33))
    for e in (0.3, 0.7):
        yield f"apodisation {e:g}", vesicle.left(microscope(device, apodisation=e))
    if quick:
        return
    yield "planes 1 um apart", vesicle.left(plain, FINER)
    yield "5 x 5 voxels", vesicle.left(plain, voxels=5)
    yield "pixels of 3 x 3 parts", vesicle.left(microscope(device, binning=3), binning=3)
    found = fit_pupil(
        vesicle.seen.counts, plain, planes=PLANES, terms=TERMS, white=vesicle.seen.white,
        background=vesicle.haze, gain=GAIN, variance=vesicle.prepare.variance, steps=2,
    )  # fmt: skip
    for j, c, error in zip(found.terms, found.coefficients, found.errors, strict=True):
        click.echo(f"  term {j:2}: {c * 1e9:7.1f} +- {error * 1e9:.1f} nm")
    click.echo(f"  residuals of the fit {found.residuals.round(5).tolist()}, chi2 {found.chi2:.2f}")
    with_pupil = replace(plain, pupil=found.pupil)
    yield "pupil fitted", vesicle.left(with_pupil)
    symmetric = replace(plain, pupil=PupilAberration({11: found.coefficients[-1]}))
    yield "its spherical aberration alone", vesicle.left(symmetric)
    yield "pupil and 80 iterations", vesicle.left(with_pupil, iterations=80)


@dataclass(frozen=True)
class Found:
    """A volume, where its voxels lie on the raw frame, and how long an iteration took."""

    volume: Vector
    residual: float
    floor: float
    place: dict[str, tuple[float, float]]
    seconds: float

    def at(self, other: Found) -> Vector:
        """This volume at the voxels of another one, linearly; energy of one of the other's."""
        z, i, k = np.indices(other.volume.shape)
        first, down, right = (np.array(one) for one in other.place.values())
        here, mine_down, mine_right = (np.array(one) for one in self.place.values())
        steps = np.array([mine_down, mine_right])
        places = first + i[..., None] * down + k[..., None] * right - here
        mine = np.moveaxis(places @ np.linalg.inv(steps), -1, 0)
        scale = abs(np.linalg.det([down, right]) / np.linalg.det(steps))
        return np.asarray(scale * map_coordinates(self.volume, (z, *mine), order=1))


def found_on(prepare: Preparation, seen: Prepared, projector: Projector) -> Found:
    """A volume of a prepared frame."""
    haze = prepare.haze(seen.counts, seen.white)
    deconvolve(seen.counts, projector, white=seen.white, iterations=1, background=haze)
    start = time.perf_counter()
    made = deconvolve(seen.counts, projector, white=seen.white, iterations=20, background=haze)
    seconds = (time.perf_counter() - start) / 20
    counts = seen.counts[seen.white > 0].astype(float)
    floor = prepare.variance * GAIN * counts.sum() / np.square(counts).sum()
    return Found(made.volume, float(made.residuals[-1]), floor, prepare.place(3), seconds)


def unrectified(vesicle: Vesicle) -> None:
    """Print both ways."""
    device, kept = vesicle.device, {"voxels_per_lenslet": 3, "cut": 5e-3, "binning": PARTS}
    shape = tuple(size // PIXELS for size in vesicle.seen.counts.shape)
    images = point_images(microscope(device, binning=PARTS), PLANES, **kept)
    projector = Projector(images, (shape[0], shape[1]), device=device)
    usual = found_on(vesicle.prepare, vesicle.seen, projector)
    says(f"rectified, {PIXELS} pixels a lenslet", usual)
    inside = (slice(None), slice(12, -12), slice(12, -12))  # four lenslets
    camera = microscope(device, binning=PARTS, pixels=RAW)
    raw_images = point_images(camera, PLANES, sensor_pixels=SENSOR, **kept)
    raw = raw_preparation(raw_images, white=vesicle.white, dark=vesicle.dark, device=device)
    assert raw.projector is not None
    found = found_on(raw, raw(vesicle.frame), raw.projector)
    says(f"as it is, {RAW} pixels of the images", found)
    one, other = usual.volume[inside], found.at(usual)[inside]
    alike = float(np.corrcoef(one.ravel(), other.ravel())[0, 1])
    click.echo(f"  correlation of the volumes {alike:.4f}, light {other.sum() / one.sum():.4f}")


def says(what: str, found: Found) -> None:
    """A line."""
    click.echo(
        f"{what:36} residual {found.residual:.5f}, of it noise {found.floor:.5f}, "
        f"{found.seconds:.2f} s an iteration"
    )


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--quick", is_flag=True, help="Without fine sampling and the pupil.")
@click.option("--unrectified", "raw", is_flag=True, help="The raw frame beside the rectified one.")
def main(selector: str | None, quick: bool, raw: bool) -> None:
    """A table."""
    vesicle, first = Vesicle(Device.open(selector)), None
    if raw:
        unrectified(vesicle)
        return
    for what, residual in causes(vesicle, quick):
        first = residual if first is None else first
        click.echo(f"{what:32}{residual:9.5f}{100 * (first - residual) / first:8.1f} %")


if __name__ == "__main__":
    main()
