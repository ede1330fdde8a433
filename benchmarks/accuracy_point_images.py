"""How right point images of light-field microscopes are, and what their choices change.

    python benchmarks/accuracy_point_images.py [--device pocl] [--only field,window,pixels,...]

A line for each figure of docs/microscope_theory.md with its limit: the field beside the Debye
integral of tests/reference_microscope.py; point images beside those of wider windows and of finer
pixels, of another apodisation, and of frames that were rectified; and the residual of a real frame,
where $CLPLEN_DATA has it. Where not said otherwise: 60x/1.2 in water, 593 nm, lenslets of 100 um
and 2.5 mm with 15 pixels, 3 x 3 voxels. A minute in all.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import tifffile

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from reference_microscope import Setup, debye

from clplen import (
    Device,
    Grid,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    Projector,
    deconvolve,
    point_images,
)
from clplen.cameras import Microscope, Objective
from clplen.lightfield import Lattice
from clplen.microscopy import preparation, rectify

Row = tuple[str, float, float]
DEPTHS = (0.0, 3e-6, 10e-6)
PHASE = (0, 1)


def camera_of(device: Device, pixels: float = 15, count: int = 5, **change: Any) -> Microscope:
    """The 60x/1.2 microscope."""
    rotation = change.pop("rotation", 0.0)
    values = {"magnification": 60, "na": 1.2, "medium_index": 1.33, "wavelength": 593e-9}
    mla = MicrolensArray(100e-6, 2.5e-3, count=count, fill="full", rotation=rotation)
    values |= {"mla": mla, "pixels_per_lenslet": pixels, "device": device} | change
    return PlenopticCamera.microscope(**values)


def difference(found: Any, true: Any) -> float:
    """Norm of the difference of two pictures about one centre, over that of the second."""
    n = min(len(found), len(true))
    one, other = (
        a[(len(a) - n) // 2 : (len(a) + n) // 2, (len(a) - n) // 2 : (len(a) + n) // 2]
        for a in (found.astype(float), true.astype(float))
    )
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def image(camera: Microscope, z: float, **options: Any) -> Any:
    """One point image."""
    return point_images(camera, [z], voxels_per_lenslet=3, **options).image(0, PHASE)


def field(device: Device) -> Iterator[Row]:
    """Along x of the native plane, 20x/0.5 in air, pixels of 5 um."""
    precise = Device.open(device.place, precision="double")
    limits = {375: (1e-3, 8e-3, 0.0235), 1525: (1e-4, 8e-4, 2.5e-3)}
    for count, z in ((count, z) for count in limits for z in (0, 10e-6, -25e-6)):
        grid = Grid((count, count), 5e-6)
        made = Objective(20, 0.5, 1, 525e-9).fields(PointSources([(0, 0, z)]), grid, precise)
        line = made.to_numpy()[0, count // 2]
        inner = np.abs(grid.x) < 900e-6
        expected = debye(Setup(), np.abs(grid.x), z, nodes=400)
        line, expected = ((u / u[count // 2])[inner] for u in (line, expected))
        limit = limits[count][(0, 10e-6, -25e-6).index(z)]
        found = float(np.abs(line - expected).max() / np.abs(expected).max())
        yield f"field beside the Debye integral, {count} samples, z = {z * 1e6:g} um", found, limit


def window(device: Device) -> Iterator[Row]:
    """The simulated window beside one three times as wide."""
    psf: Any = inspect.getmodule(point_images)  # its margins are no option
    margin, least = psf.MARGIN, psf.LEAST
    for power, limit in ((0.5, 3e-3), (-0.5, 6e-3)):
        camera = camera_of(device, apodisation=power)
        for z in DEPTHS:
            found = image(camera, z)
            psf.MARGIN, psf.LEAST = 40, 99
            wide = image(camera, z)
            psf.MARGIN, psf.LEAST = margin, least
            what = f"window beside a wider one, apodisation {power:g}, z = {z * 1e6:g} um"
            yield what, difference(found, wide), limit


def pixels(device: Device) -> Iterator[Row]:
    """The intensity at the centre of a pixel, or 3 x 3 of them, beside 5 x 5."""
    for z in DEPTHS:
        fine = image(camera_of(device, 75), z, binning=5)
        for binning, limit in ((1, 0.1), (3, 6e-3)):
            found = image(camera_of(device, 15 * binning), z, binning=binning)
            what = f"binning {binning} beside 5, z = {z * 1e6:g} um"
            yield what, difference(found, fine), limit


def apodisation(device: Device) -> Iterator[Row]:
    """Raw images of a point for cos^(1/2) and cos^(-1/2) over the pupil."""
    fine = MicrolensArray(125e-6, 2.5e-3, count=35, fill="full")
    air = {"magnification": 20, "na": 0.5, "medium_index": 1.0, "wavelength": 525e-9, "mla": fine}
    for name, pitch, change, limit in (("20x/0.5", 25, air, 0.09), ("60x/1.2", 15, {}, 0.4)):
        camera = camera_of(device, pitch, 35, **change)
        for z in (0, 10e-6):
            point = PointSources([(0.3e-6, 0.2e-6, z)])
            one, other = (
                replace(camera, apodisation=e).expose(point).to_numpy() for e in (-0.5, 0.5)
            )
            yield (
                f"apodisation -1/2 beside 1/2, {name}, z = {z * 1e6:g} um",
                difference(one, other),
                limit,
            )


def rectified(device: Device) -> Iterator[Row]:
    """A turned array of a fractional pitch, rectified, beside one of whole pixels."""
    for fractional, limits in ((15.4, (0.02, 0.12, 2e-3)), (24.4, (0.012, 0.03, 2e-3))):
        whole = int(np.ceil(fractional))
        for x, y in ((0.7e-6, -0.3e-6), (0.0, 0.0)):
            seen = []
            for count, turn in ((fractional, -0.002), (whole, 0.0)):
                cos, sin = np.cos(turn), np.sin(turn)
                place = (x * cos - y * sin, x * sin + y * cos, 1.5e-6)
                camera = camera_of(device, count, 21, rotation=turn)
                seen.append(camera.expose(PointSources([place])))
            raw, true = seen[0], seen[1].to_numpy().astype(float)
            grid = raw.sub_images
            lattice = Lattice("square", grid.first, grid.row_step, grid.column_step, raw.shape)
            found = rectify(raw.to_numpy(), lattice, device=device, complete=False).astype(float)
            cells = [a.reshape(21, whole, 21, whole).sum(axis=(1, 3)) for a in (found, true)]
            what = f"{fractional} to {whole} pixels, point at ({x * 1e6:g}, {y * 1e6:g}) um: "
            yield what + "lenslets", difference(*cells), limits[0]
            yield what + "pixels", difference(found, true), limits[1]
            yield what + "sum", abs(found.sum() / true.sum() - 1), limits[2]


def vesicle(device: Device) -> Iterator[Row]:
    """Residual of a real frame after eight iterations, for three apodisations."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CLPLEN_DATA", beside), "lfm_guv")
    if not folder.is_dir():
        click.echo(f"no frames in {folder}: set CLPLEN_DATA")
        return
    raw, white, dark = (
        tifffile.imread(folder / f"{name}_GUVExperim1.tif")
        for name in ("Lightfield", "Radiometry", "DarkFrame")
    )
    frame = preparation(16, device=device, white=white, dark=dark)(raw)
    shape = (frame.counts.shape[0] // 16, frame.counts.shape[1] // 16)
    for power, limit in ((0.5, 0.05), (-0.5, 0.15), (1.0, 0.065)):
        camera = camera_of(device, 16, medium_index=1.35, apodisation=power)
        images = point_images(camera, np.linspace(-15e-6, 15e-6, 11), voxels_per_lenslet=3)
        projector = Projector(images, shape, device=device)
        found = deconvolve(frame.counts, projector, iterations=8, white=frame.white, background=5)
        yield f"residual of the vesicle, apodisation {power:g}", found.residuals[-1], limit


SECTIONS: dict[str, Callable[[Device], Iterator[Row]]] = {
    one.__name__: one for one in (field, window, pixels, apodisation, rectified, vesicle)
}


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--only", default=",".join(SECTIONS), show_default=True)
def main(selector: str | None, only: str) -> None:
    """A table of figures and limits; ends with 1 where one is not met."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    met = True
    for name in only.split(","):
        for what, found, limit in SECTIONS[name](device):
            met &= found <= limit
            says = "" if found <= limit else "  NOT MET"
            click.echo(f"{what:<72}{found:>11.2g}   at most {limit:g}{says}")
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
