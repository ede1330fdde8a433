"""Many small light fields by two workers, and the real captures, as one job each.

    python benchmarks/check_batch.py [--device pocl] [--items 200] [--keep FOLDER]

Every output of the small ones is compared with the result in core, bit for bit. The captured
flower and the raw microscope frame with its white and dark frames ($CLPLEN_DATA, else
../shared/data) go through stack, depth and all-in-focus; --keep leaves them to be looked at.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import batchworks

from clplen import Device
from clplen.batch import Job

PLANES = {"disparities": "-1:1:21"}


def small(device: Device, items: int) -> None:
    """How many outputs are wrong or too many."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = batchworks.write_inputs(folder / "in", items)
        job = Job.read(batchworks.write_job(folder, more=f'device = "{device.place}"'))
        begun = time.perf_counter()
        summary = job.run(workers=2)
        wrong = batchworks.wrong_outputs(folder / "out", files, device)
        strays = batchworks.strays(folder / "out")
        print(
            f"{summary.done} done, {len(summary.failed)} failed, {len(wrong)} outputs wrong, "
            f"{len(strays)} stray, {time.perf_counter() - begun:.1f} s"
        )


def real(device: Device, folder: Path) -> None:
    """The captures of one job."""
    data = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not data.is_dir():
        print(f"no real captures in {data}: set CLPLEN_DATA")
        return
    flower = {"pattern": "IMG_0001_{n}_{u}_{v}.png"}
    guv = data / "lfm_guv"
    frames = {
        "white": str(guv / "Radiometry_GUVExperim1.tif"),
        "dark": str(guv / "DarkFrame_GUVExperim1.tif"),
    }
    inputs = [
        {"files": str(data / "lytro_f01_flower"), "name": "flower", "layout": flower},
        {"files": str(guv / "Lightfield_GUVExperim1.tif"), "name": "guv", "layout": frames},
    ]
    words = {"stack": PLANES, "depth": PLANES, "all_in_focus": {}}
    job = Job(output="captures", inputs=inputs, device=device.place, **words).relative_to(folder)
    summary = job.run()
    print(f"captures: {summary.done} done, {summary.failed or 'none'} failed, in {folder}/captures")


@click.command()
@click.option("--device", "selector")
@click.option("--items", default=200)
@click.option("--keep", type=click.Path(path_type=Path))
def main(selector: str | None, items: int, keep: Path | None) -> None:
    """Both."""
    device = Device.open(selector)
    small(device, items)
    with tempfile.TemporaryDirectory() as name:
        real(device, keep or Path(name))


if __name__ == "__main__":
    main()
