"""A long series of frames of a microscope from a TIFF to an OME-Zarr, and what a kill costs it.

    python benchmarks/long_series.py FOLDER [--frames 1000] [--planes 51] [--lenslets 67]
                                     [--kill] [--keep] [--device pocl]

Sixty beads that drift by a tenth of a voxel a frame, on an even background, with Poisson noise;
60x/1.2 water, 15 x 15 pixels and 5 x 5 voxels a lenslet. `clplen microscope deconvolve` finds the
volumes, 8 iterations each from the volume before. The time is that of the whole command: start,
matrices, iterations, writing. With ``--kill`` the command is killed by SIGKILL three times on its
way and run again, and every volume is compared bit by bit with that of a run that nobody killed.
FOLDER keeps point images and frames; the volumes are deleted but for ``--keep``. A thousand frames
of 1005 x 1005 pixels need 2 GB, their volumes 27 GB.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import numpy as np
import tifffile

from clplen import ClplenError, Device, MicrolensArray, PlenopticCamera, Projector, point_images
from clplen.io import read_volume_series, series_in
from clplen.microscopy import read_point_images, write_point_images

BEADS, DRIFT, ITERATIONS, KILLS = 60, 0.1, 8, 3


def make_images(path: Path, planes: int, device: Device) -> None:
    """Point images of planes within 10 um."""
    if path.exists():
        return
    camera = PlenopticCamera.microscope(
        magnification=60,
        na=1.2,
        medium_index=1.33,
        wavelength=593e-9,
        mla=MicrolensArray(100e-6, 2.5e-3, count=5, fill="full"),
        pixels_per_lenslet=15,
        device=device,
    )
    depths = np.linspace(-10e-6, 10e-6, planes)
    write_point_images(path, point_images(camera, depths, voxels_per_lenslet=5))


def make_frames(path: Path, images: Path, lenslets: int, frames: int, device: Device) -> None:
    """Frames of beads that drift; a bead between two voxels is shared by them."""
    if path.exists():
        return
    projector = Projector(read_point_images(images), (lenslets, lenslets), device=device)
    random = np.random.default_rng(3)
    depth, height, width = projector.volume_shape
    z = random.integers(0, depth, BEADS)
    y = random.integers(4, height - 4, BEADS)
    x = random.uniform(4, width - 4, BEADS)
    with tifffile.TiffWriter(path, bigtiff=True) as file:
        for frame in range(frames):
            place = 4 + (x - 4 + DRIFT * frame) % (width - 8)
            left, share = np.floor(place).astype(int), (place % 1).astype(np.float32)
            volume = np.zeros(projector.volume_shape, np.float32)
            np.add.at(volume, (z, y, left), 2e5 * (1 - share))
            np.add.at(volume, (z, y, left + 1), 2e5 * share)
            counts = random.poisson(projector.forward(volume) + 5)
            file.write(counts.astype(np.uint16), photometric="minisblack", contiguous=True)


def deconvolve(frames: Path, images: Path, out: Path, place: str) -> list[str]:
    """Run the command; its peak of memory and what it printed last."""
    with started(frames, images, out, place) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    said = out.with_suffix(".log").read_text().splitlines()
    if process.returncode:
        raise click.ClickException("\n".join(said[-3:]))
    return [f"peak {used.ru_maxrss / 2**20:.2f} GiB", *said[-1:]]


def kill_after(frames: Path, images: Path, out: Path, place: str, count: int) -> int:
    """Kill the command when so many volumes are there; how many are."""
    with started(frames, images, out, place) as process:
        while (made := volumes_in(out)) < count:
            if process.poll() is not None:
                raise click.ClickException(f"It ended with {made} volumes, before it was killed.")
            time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
        if process.wait() != -signal.SIGKILL:
            raise click.ClickException("It ended before it was killed.")
    return volumes_in(out)


def started(frames: Path, images: Path, out: Path, place: str) -> subprocess.Popen[bytes]:
    """The command, which prints to a file beside its output."""
    words = ["microscope", "deconvolve", str(frames), "-c", str(images), "-o", str(out)]
    words += ["--iterations", str(ITERATIONS), "--warm-start", "--device", place]
    with out.with_suffix(".log").open("w") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "clplen", *words], stdout=log, stderr=subprocess.STDOUT
        )


def volumes_in(out: Path) -> int:
    """How many volumes a file of a series holds."""
    try:
        return len(series_in(out)[1])
    except (OSError, ClplenError):  # it is not there yet
        return 0


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--frames", default=1000, type=click.IntRange(1))
@click.option("--planes", default=51, type=click.IntRange(1))
@click.option("--lenslets", default=67, type=click.IntRange(5))
@click.option("--kill", is_flag=True, help="Kill three times, and compare with a whole run.")
@click.option("--keep", is_flag=True, help="Keep the volumes.")
@click.option("--device", "selector", help="As Device.open takes it.")
def main(
    folder: Path,
    frames: int,
    planes: int,
    lenslets: int,
    kill: bool,
    keep: bool,
    selector: str | None,
) -> None:
    device = Device.open(selector)
    folder.mkdir(parents=True, exist_ok=True)
    images = folder / f"images_{planes}.h5"
    tiff = folder / f"frames_{frames}_{planes}_{lenslets}.tif"
    out = folder / "volumes.ome.zarr"
    make_images(images, planes, device)
    make_frames(tiff, images, lenslets, frames, device)
    if out.exists():
        shutil.rmtree(out)
    start = time.perf_counter()
    said = deconvolve(tiff, images, out, device.place)
    took = time.perf_counter() - start
    nbytes = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    click.echo(
        f"{device.name}: {frames} frames of {15 * lenslets} x {15 * lenslets} pixels, {planes} "
        f"planes, {ITERATIONS} iterations: {took:.0f} s, {frames / took:.3g} frames a second; "
        f"{nbytes / 1e9:.2f} GB"
    )
    click.echo("\n".join(said))
    if kill:
        whole = out.rename(folder / "whole.ome.zarr")
        at = [
            kill_after(tiff, images, out, device.place, part * frames // (KILLS + 1))
            for part in range(1, KILLS + 1)
        ]
        deconvolve(tiff, images, out, device.place)
        same = [
            np.array_equal(read_volume_series(out, t), read_volume_series(whole, t))
            for t in range(frames)
        ]
        click.echo(
            f"killed with {', '.join(map(str, at))} volumes and resumed: {sum(same)} of {frames} "
            "volumes the same"
        )
        keep or shutil.rmtree(whole)
    keep or shutil.rmtree(out)


if __name__ == "__main__":
    main()
