"""Public operations within limits of memory, and again and again: nothing dies, nothing grows.

    python benchmarks/limits.py ulimit [--steps 10] [--demo] [--device pocl]
    python benchmarks/limits.py flat [--calls 300] [--device pocl]

``ulimit`` runs every operation in processes whose address space is limited, from what the import
takes to 4 GB. Each ends right (as without a limit), or in one sentence; never by a signal, never
without an end. ``--demo`` adds `clplen demo` and the code blocks of the README within 4 GB.
``flat`` calls operations many times, with equal and with ever other shapes, and compares resident
memory and open files after a third of the calls and at the end. The exit status says whether all
is well.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np

import clplen

MOST = 4_000_000_000  # bytes of address space of the last step
SECONDS = 240  # of a process
GROWTH = 2**26  # bytes that the later two thirds of the calls may add
ROOT = Path(__file__).parents[1]
Operation = Callable[["Inputs", int], Any]


class Inputs:
    """What operations work on, made once at a scale: 1 for a limit, less for many calls."""

    def __init__(self, device: clplen.Device, folder: Path, scale: float) -> None:
        self.device, self.folder = device, folder
        self.random = np.random.default_rng(1)
        self.side = int(1400 * scale)
        self.planes = int(500 * scale) + 3

    def light_field(self, more: int = 0) -> clplen.LightField:
        shape = (5, 4, self.side // 6 + more, self.side // 5)
        return clplen.LightField.from_array(
            self.random.random(shape, np.float32), device=self.device
        )

    def field(self, more: int = 0) -> clplen.Field:
        grid = clplen.Grid((self.side + more, self.side - 30), 5e-6)
        u = self.random.random(grid.shape, np.float32).astype(np.complex64)
        return clplen.Field.from_array(u, grid, wavelength=5e-7, device=self.device)

    def camera(self) -> Any:
        mla = clplen.MicrolensArray(150e-6, 10e-3, count=max(5, self.side // 60), fill="full")
        return clplen.PlenopticCamera.type1(
            focal_length=0.120, mla=mla, wavelength=532e-9, pixels_per_lenslet=30,
            device=self.device,
        )  # fmt: skip

    def path(self, name: str) -> Path:
        return self.folder / name


def expose(inputs: Inputs, _: int) -> Any:
    return inputs.camera().expose(clplen.PointSources([(0, 0, -0.05)], diameter=1e-5)).to_numpy()


def decode(inputs: Inputs, _: int) -> Any:
    raw = inputs.camera().expose(clplen.PointSources([(0, 0, 0.02)], diameter=1e-5))
    return clplen.LightField.from_raw(raw).to_numpy()


def deconvolve(inputs: Inputs, _: int) -> Any:
    if not hasattr(inputs, "projector"):
        camera = clplen.PlenopticCamera.microscope(
            magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
            mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"), device=inputs.device,
        )  # fmt: skip
        images = clplen.point_images(camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
        inputs.projector = clplen.Projector(images, (31, 30), device=inputs.device)
    volume = np.zeros(inputs.projector.volume_shape, np.float32)
    volume[1, 7, 7] = 1
    frame = inputs.projector.forward(volume)
    return clplen.deconvolve(frame, inputs.projector, iterations=2).volume


def write_and_read(name: str) -> Operation:
    def act(inputs: Inputs, _: int) -> Any:
        path = inputs.path(name)
        shutil.rmtree(path, ignore_errors=True)  # a folder has to be new
        clplen.write_lightfield(path, inputs.light_field())
        return clplen.read_lightfield(path, device=inputs.device).to_numpy()

    return act


def stack_file(inputs: Inputs, _: int) -> Any:
    stack = stack_of(inputs, 0)
    clplen.io.write_stack(inputs.path("stack.tif"), stack)
    return clplen.io.read_stack(inputs.path("stack.tif"), device=inputs.device).to_numpy()


def picture_file(inputs: Inputs, _: int) -> Any:
    picture = (255 * inputs.random.random((inputs.side, inputs.side, 3))).astype(np.uint8)
    clplen.io.write_picture(inputs.path("picture.png"), picture)
    return clplen.io.read_picture(inputs.path("picture.png"))


def volume_file(inputs: Inputs, _: int) -> Any:
    volume = inputs.random.random((9, inputs.side // 2, inputs.side // 2), np.float32)
    path = inputs.path("volume.ome.tif")
    clplen.io.write_volume(path, volume, planes=np.arange(9) * 1e-6, voxel=(1e-6, 1e-6))
    return clplen.io.read_volume(path)[0]


def stack_of(inputs: Inputs, more: int) -> Any:
    planes = np.linspace(-1, 1, inputs.planes)
    return clplen.focal_stack(inputs.light_field(more), disparities=planes)


def depth_of(inputs: Inputs, more: int) -> Any:
    return clplen.depth_map(inputs.light_field(more), disparities=np.linspace(-1, 1, 9))


OPERATIONS: dict[str, Operation] = {
    "propagate": lambda i, n: clplen.propagate(i.field(n), 5e-3).to_numpy(),
    "propagate to a grid": lambda i, n: clplen.propagate(
        i.field(n), 0.05, out_grid=clplen.Grid((400, 401), 7e-6), method="cblas"
    ).to_numpy(),
    "thin_lens": lambda i, n: clplen.thin_lens(i.field(n), 0.5, aliasing="allow").to_numpy(),
    "expose": expose,
    "decode": decode,
    "refocus": lambda i, n: clplen.refocus(i.light_field(n), disparity=0.5).to_numpy(),
    "focal_stack": lambda i, n: stack_of(i, n).to_numpy(),
    "all_in_focus": lambda i, n: clplen.all_in_focus(stack_of(i, n)).to_numpy(),
    "depth_map": lambda i, n: depth_of(i, n).disparity,
    "deconvolve": deconvolve,
    "HDF5": write_and_read("lf.h5"),
    "Zarr": write_and_read("lf.zarr"),
    "folder of views": write_and_read("views"),
    "stack": stack_file,
    "picture": picture_file,
    "volume": volume_file,
}
FLAT = (
    "depth_map",
    "expose",
    "deconvolve",
    "HDF5",
    "folder of views",
    "stack",
    "picture",
    "volume",
)
SHAPES = ("propagate", "focal_stack")


@click.group(help=__doc__.split("\n\n", maxsplit=1)[0])
def main() -> None:
    """Choose what is done."""


def run_all(device: str | None, names: list[str], scale: float) -> None:
    """In a child: a line of JSON for each operation that ended."""
    warnings.simplefilter("ignore")
    inputs: Inputs | None = None
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            print(json.dumps({"begun": name}), flush=True)
            try:
                if inputs is None:
                    inputs = Inputs(clplen.Device.open(device), Path(folder), scale)
                inputs.random = np.random.default_rng(1)
                values = np.asarray(OPERATIONS[name](inputs, 0))
                sums = np.abs(values).sum(dtype=np.float64)
                said = {"shape": values.shape, "sum": float(sums)}
                del values
            except (clplen.ClplenError, ValueError, OSError, MemoryError) as error:
                said = {"error": type(error).__name__, "words": str(error)}
            except Exception as error:
                said = {"foreign": type(error).__name__, "words": str(error)}
            print(json.dumps({"name": name, **said}), flush=True)


def within(limit: int | None, device: str | None, names: list[str]) -> dict[str, dict[str, Any]]:
    """What each operation ended in, within a limit of address space in bytes."""
    found: dict[str, dict[str, Any]] = {}
    while left := [name for name in names if name not in found]:
        words = [
            sys.executable,
            __file__,
            "child",
            *(["--device", device] if device else []),
            *left,
        ]
        prefix = (
            [] if limit is None else ["bash", "-c", f'ulimit -v {limit // 1024}; exec "$@"', "-"]
        )
        try:
            done = subprocess.run(
                [*prefix, *words], capture_output=True, text=True, timeout=SECONDS
            )
            status, output, errors = str(done.returncode), done.stdout, done.stderr
        except subprocess.TimeoutExpired as error:
            status, output, errors = "no end", (error.stdout or b"").decode(), ""
        begun = left[0]
        for line in output.splitlines():
            said = json.loads(line)
            begun = said.get("begun", begun)
            if "name" in said:
                found[said.pop("name")] = said
        if begun not in found:
            found[begun] = {"died": status, "words": errors.strip()[-200:]}
    return found


@main.command("child", hidden=True)
@click.option("--device")
@click.argument("names", nargs=-1)
def child(device: str | None, names: tuple[str, ...]) -> None:
    """Run operations in this process."""
    run_all(device, list(names), 1.0)


@main.command()
@click.option("--steps", default=10, show_default=True, type=click.IntRange(2))
@click.option("--only", multiple=True, help="One operation; repeatable.")
@click.option("--demo", is_flag=True, help="The demo and the README within 4 GB, too.")
@click.option("--device", help="As Device.open takes it.")
def ulimit(steps: int, only: tuple[str, ...], demo: bool, device: str | None) -> None:
    """Run every operation within limits of address space."""
    names = list(only or OPERATIONS)
    right = within(None, device, names)
    bad = sum("sum" not in said for said in right.values())
    for name, said in right.items():
        if "sum" not in said:
            click.echo(f"without a limit: {name}: {said}")
    code = "import clplen; clplen.Device; print(open('/proc/self/statm').read().split()[0])"
    pages = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    least = int(pages.stdout) * os.sysconf("SC_PAGE_SIZE")
    for limit in np.geomspace(1.02 * least, MOST, steps).astype(int):
        counts = {"right": 0, "refused": 0, "bad": 0}
        for name, said in within(int(limit), device, names).items():
            kind = verdict(said, right[name])
            counts[kind] += 1
            if kind == "bad":
                click.echo(f"  {limit / 1e6:.0f} MB: {name}: {said}")
        bad += counts["bad"]
        click.echo(f"{limit / 1e6:6.0f} MB: {counts}")
    if demo:
        bad += demo_and_readme()
    sys.exit(int(bad > 0))


def verdict(said: dict[str, Any], right: dict[str, Any]) -> str:
    """Whether an operation ended right, in a sentence, or otherwise."""
    if "sum" in said and "sum" in right:
        near = np.isclose(said["sum"], right["sum"], rtol=1e-5)
        return "right" if near and said["shape"] == right["shape"] else "bad"
    words = said.get("words", "")
    return "refused" if "error" in said and words and "\n" not in words.strip() else "bad"


_README = """\
import docpages, test_docs
names = {"__name__": "reader"} | test_docs.SAMPLES.get("README.md", dict)()
blocks = [block for block in docpages.blocks("README.md") if block.mark != "not run"]
assert blocks
for block in blocks: docpages.run_block(block, names)
print(len(blocks), "blocks of README.md")"""


def demo_and_readme() -> int:
    """Run the demo and the blocks of the README within 4 GB; returns how many failed."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, words in {
            "clplen demo": ["-m", "clplen", "demo", "-o", str(Path(folder, "demo"))],
            "README": ["-c", _README],
        }.items():
            command = ["bash", "-c", f'ulimit -v {MOST // 1024}; exec "$@"', "-", sys.executable]
            paths = os.pathsep.join((str(ROOT), str(ROOT / "tests")))
            done = subprocess.run(
                [*command, *words], capture_output=True, text=True, cwd=folder,
                env=os.environ | {"PYTHONPATH": paths},
            )  # fmt: skip
            last = (done.stdout.strip() or done.stderr.strip()).splitlines()[-1:]
            click.echo(f"{name}: status {done.returncode}, {last}")
            failed += done.returncode != 0
    return failed


@main.command()
@click.option("--calls", default=300, show_default=True, type=click.IntRange(30))
@click.option("--only", multiple=True, help="One operation; repeatable.")
@click.option("--device", help="As Device.open takes it.")
def flat(calls: int, only: tuple[str, ...], device: str | None) -> None:
    """Call operations many times, with one shape and with others."""
    warnings.simplefilter("ignore")
    opened, bad = clplen.Device.open(device), 0
    rows = [(name, False) for name in FLAT] + [(name, True) for name in SHAPES]
    for name, other in [row for row in rows if not only or row[0] in only]:
        with tempfile.TemporaryDirectory() as folder:
            inputs = Inputs(opened, Path(folder), 0.15)
            readings = []
            for n in range(calls):
                OPERATIONS[name](inputs, n if other else 0)
                if n + 1 in (calls // 3, calls):
                    opened.free_spare()
                    gc.collect()
                    readings.append(held())
        (before, files), (after, still) = readings
        is_bad = after - before > GROWTH or still > files
        bad += is_bad
        click.echo(
            f"{name:20s} {calls} {'shapes' if other else 'calls'}: {before >> 20} MiB, {files} "
            f"files after a third; {after >> 20} MiB, {still} files at the end"
            f"{'  GROWS' if is_bad else ''}"
        )
    sys.exit(int(bad > 0))


def held() -> tuple[int, int]:
    """Bytes of resident memory, and open files."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE"), len(os.listdir("/proc/self/fd"))


if __name__ == "__main__":
    main()
