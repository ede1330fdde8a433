"""Memory of a projector with as many voxels as pixels a lenslet, matrices kept or made anew.

    python benchmarks/projector_memory.py [--device pocl] [--memory BYTES] [--lenslets 25]

60x/1.2 water, 15 x 15 pixels and voxels a lenslet, eight planes within 10 um: one projection and
one back-projection. What the process takes at most (resident, looked at every 5 ms) is that with
Python, OpenCL's compiler and the point images, which are made by another process.
"""

from __future__ import annotations

import multiprocessing
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np

from clplen import Device, MicrolensArray, PlenopticCamera, Projector, point_images
from clplen.microscopy import read_point_images, write_point_images


def make(path: str, selector: str | None) -> None:
    """Write the point images."""
    array = MicrolensArray(100e-6, 2.5e-3, count=5, fill="full")
    camera = PlenopticCamera.microscope(
        magnification=60, na=1.2, medium_index=1.33, wavelength=593e-9, mla=array,
        pixels_per_lenslet=15, device=Device.open(selector),
    )  # fmt: skip
    planes = np.linspace(-10e-6, 10e-6, 8)
    write_point_images(path, point_images(camera, planes, voxels_per_lenslet=15))


def resident() -> float:
    """Memory of this process in MB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1.024e-3 * int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


@click.command()
@click.option("--device", "selector", default=None)
@click.option("--memory", type=int, default=None)
@click.option("--lenslets", default=25)
def main(selector: str | None, memory: int | None, lenslets: int) -> None:
    """Print the largest memory of a projection and a back-projection."""
    with TemporaryDirectory() as folder:
        path = str(Path(folder, "images.h5"))
        maker = multiprocessing.get_context("spawn").Process(target=make, args=(path, selector))
        maker.start()
        maker.join()
        images = read_point_images(path)
    device = Device.open(selector)
    before, most = resident(), [0.0]

    def watch() -> None:
        while True:
            most[0] = max(most[0], resident())
            time.sleep(0.005)

    threading.Thread(target=watch, daemon=True).start()
    projector = Projector(images, (lenslets, lenslets), device=device, memory=memory)
    projector.backward(projector.forward(np.ones(projector.volume_shape, np.float32)))
    kept = "kept" if projector.resident else "made anew"
    print(
        f"{images}\nmatrices of {projector.nbytes / 1e6:.0f} MB, {kept}: {before:.0f} MB before, "
        f"{most[0]:.0f} MB at most"
    )


if __name__ == "__main__":
    main()
