"""The microscope's commands on each OpenCL device, compared.

    python benchmarks/check_devices.py [--device pocl --device intel ...] [--keep FOLDER]

A small microscope with square and with hexagonal lenslets, and a Fourier microscope: point images,
frames, volumes of single frames and of a series, point images measured from beads, and the
pupil found from a frame of beads. Every device does all of it with the command line; the
figure is the largest difference from the first device over the largest value, of the pupil in nm.
Without --device: all that `clplen devices` lists. Mesa's CPU driver for trials is shown by
RUSTICL_ENABLE=llvmpipe.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import h5py
import numpy as np
import tifffile

from clplen import Device, MicrolensArray, PlenopticCamera, PointSources
from clplen.io import read_volume, write_volume

Values = np.ndarray[Any, Any]

SCOPE = """
magnification = 10
na = 0.2
medium_index = 1.0
wavelength = 525
ulens_pitch = 60
ulens_focal_length = 1500
pixel_size = 5.454545454
tubelens_focal_length = 200
"""
FOURIER = """
[camera]
kind = "fourier_microscope"
magnification = 20
na = 0.3
wavelength_nm = 525
relay_mm = 50
pixel_um = 8
[camera.microlenses]
pitch_um = 500
focal_length_mm = 12
count = 3
"""
SQUARE_PLANES, FOURIER_PLANES = (20e-6, 50e-6), (-15e-6, 0.0, 15e-6)
PUPIL = {6: 35e-9, 8: -30e-9}
SEED = 5


def run(*words: object) -> None:
    """One command, which has to succeed."""
    done = subprocess.run(
        [sys.executable, "-m", "clplen", *(str(word) for word in words)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise click.ClickException(f"{' '.join(map(str, words))}:\n{done.stdout}{done.stderr}")


def volume(shape: tuple[int, int, int]) -> Values:
    """Few bright voxels on a dim ground."""
    rng = np.random.default_rng(SEED)
    values = rng.random(shape, np.float32) * 5
    values.ravel()[rng.choice(values.size, 12, replace=False)] = 2e4
    return values


def write_inputs(folder: Path, device: Device) -> None:
    """Parameters, truths, and frames of beads, alike for all devices."""
    (folder / "square.toml").write_text(SCOPE)
    (folder / "hexagonal.toml").write_text(SCOPE + 'ulens_lattice = "hexagonal"\n')
    (folder / "fourier.toml").write_text(FOURIER)
    write_volume(
        folder / "truth.ome.tif", volume((2, 21, 27)), planes=SQUARE_PLANES, voxel=(2e-6, 2e-6)
    )
    write_volume(
        folder / "fourier.ome.tif", volume((3, 31, 29)), planes=FOURIER_PLANES, voxel=(1e-6, 1e-6)
    )
    lenslets = MicrolensArray(60e-6, 1.5e-3, count=9, fill="full")
    camera = PlenopticCamera.microscope(
        magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11, mla=lenslets,
        pupil=PUPIL, device=device,
    )  # fmt: skip
    beads = PointSources([(7e-6, -5e-6, 50e-6), (-9e-6, 3e-6, -45e-6)], power=[6e4, 4e4])
    rng = np.random.default_rng(SEED)
    frame = rng.poisson(camera.expose(beads).to_numpy() + 0.25)
    tifffile.imwrite(folder / "beads.tif", frame.astype(np.uint16))
    of_pupil = PlenopticCamera.fourier_microscope(
        magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
        mla=MicrolensArray(500e-6, 12e-3, count=3), device=device,
    )  # fmt: skip
    stack = [
        of_pupil.expose(PointSources([(1.3e-6, -0.7e-6, z)], power=[1e6])).to_numpy()
        for z in FOURIER_PLANES
    ]
    tifffile.imwrite(
        folder / "stack.tif",
        rng.poisson(np.maximum(stack, 0) + 1).astype(np.uint16),
        photometric="minisblack",
    )


def commands(inputs: Path, out: Path, place: str, frames: Path) -> dict[str, list[object]]:
    """Words of each step by the name of what it writes; frames are those of the first device."""
    on = ["--device", place]
    psf: list[object] = ["--planes-um", "20:50:2", "--voxels", 3, "--cut", 0.02]
    find: list[object] = ["--iterations", 4, "--keep-hot", *on]
    fourier = ["--planes-um", "-15:15:3", *on]
    return {
        "square.h5": ["psf", inputs / "square.toml", *psf, *on],
        "hexagonal.h5": ["psf", inputs / "hexagonal.toml", "--unrectified", *psf, *on],
        "fourier.h5": ["psf", inputs / "fourier.toml", *fourier],
        "measured.h5": ["psf", inputs / "fourier.toml", "--beads", inputs / "stack.tif", *fourier],
        "square.tif": ["project", inputs / "truth.ome.tif", "-c", out / "square.h5", *on],
        "fourier.tif": ["project", inputs / "fourier.ome.tif", "-c", out / "fourier.h5", *on],
        "square.ome.tif": ["deconvolve", frames / "square.tif", "-c", out / "square.h5", *find],
        "series.ome.tif": ["deconvolve", frames / "series.tif", "-c", out / "square.h5",
                           "--batch", 2, *find],
        "fourier.ome.tif": ["deconvolve", frames / "fourier.tif", "-c", out / "fourier.h5", *find],
        "pupil.toml": ["pupil", inputs / "beads.tif", "-c", inputs / "square.toml",
                       "--planes-um", "-75:75:11", "--beads", "--terms", "6,8", *on],
    }  # fmt: skip


def values_of(path: Path) -> Values:
    """All numbers of an output as one vector; of a pupil in nm."""
    if path.suffix == ".h5":
        with h5py.File(path, "r") as file:
            stored = [file["planes"][name][()].ravel() for name in sorted(file["planes"])]
        return np.concatenate(stored).astype(np.float64)
    if path.suffix == ".toml":
        (line,) = re.findall(r"^pupil_nm = {(.*)}", path.read_text(), re.MULTILINE)
        return np.array([float(term.split("=")[1]) for term in line.split(",")])
    if path.name.endswith(".ome.tif"):
        return read_volume(path)[0].astype(np.float64)
    return tifffile.imread(path).astype(np.float64)


def series_of(frame: Path) -> None:
    """Three frames of different exposure beside a frame, as one file."""
    values = tifffile.imread(frame)
    rng = np.random.default_rng(SEED)
    frames = [rng.poisson(values * one + 2) for one in (1.0, 0.7, 0.4)]
    tifffile.imwrite(
        frame.with_name("series.tif"), np.array(frames, np.uint16), photometric="minisblack"
    )


def difference(path: Path, first: Path) -> str:
    """Of an output from that of the first device."""
    found, wanted = values_of(path), values_of(first)
    if found.shape != wanted.shape:
        return f"shape {found.shape}, not {wanted.shape}"
    largest = float(np.abs(found - wanted).max())
    if path.suffix == ".toml":
        return f"{largest:.3f} nm of {np.round(wanted, 1)}"
    return f"{largest / float(np.abs(wanted).max()):.1e}"


def work(folder: Path, device: Device, first: Path | None, say: Callable[[str], None]) -> Path:
    """All commands on one device."""
    out = folder / device.place.replace(":", "_")
    out.mkdir()
    say(f"{device.place} {device.name}")
    for name, words in commands(folder, out, device.place, first or out).items():
        run("microscope", *words, "-o", out / name)
        if name == "square.tif" and first is None:
            series_of(out / name)
        if first is not None:
            say(f"  {name:16} {difference(out / name, first / name)}")
    return out


@click.command(help=__doc__)
@click.option("--device", "selectors", multiple=True, help="As Device.open takes it; repeatable.")
@click.option("--keep", type=click.Path(path_type=Path), help="Leave all files there.")
def main(selectors: tuple[str, ...], keep: Path | None) -> None:
    chosen = [Device.open(one) for one in selectors] or Device.all()
    devices = list({one.place: one for one in chosen}.values())
    if len(devices) < 2:
        raise click.UsageError(f"{devices[0].name} is the only device: name another to compare.")
    with tempfile.TemporaryDirectory() as temporary:
        folder = keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        write_inputs(folder, devices[0])
        first = work(folder, devices[0], None, click.echo)
        for device in devices[1:]:
            work(folder, device, first, click.echo)


if __name__ == "__main__":
    main()
