"""From the raw picture of an Illum to a stack, beside the same stages by hand with NumPy and
SciPy.

    python -m benchmarks peers/raw_to_stack [--quick] [--folder DIR] [--repeats 3]

A picture of 5368 x 7728 pixels of 10 bits (GRBG) behind hexagonal lenslets 14.29 pixels apart is
drawn with its white image and written as Lytro files. A process each reads it, divides by the
white image, interpolates the colours, decodes all views onto a rectangular lattice, applies the
colour matrix and writes 11 refocused pictures as a TIFF of float32; its seconds, those of all
processors together and its largest memory are printed. Both are told the lattice; clplen compares
it with that of the white image, which its first run finds and keeps, as it builds its kernels. By
hand means what one writes after LFToolbox: whole-array NumPy, bilinear demosaicing by
`scipy.ndimage.convolve`, `map_coordinates` for views and rows, and `scipy.ndimage.shift` for each
view and plane.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from lytro_files import a_container, described
from reference_lattice import lattice as drawn_lattice

from clplen.lightfield import Lattice

Array = np.ndarray[Any, Any]

SIZES = {"whole": (5368, 7728), "quick": (1072, 1288)}
PITCH, DEGREES, BAYER = 14.29, 0.05, "GRBG"
BLACK, TOP = 64, 1023
MATRIX = np.array([[1.6, -0.5, -0.1], [-0.2, 1.5, -0.3], [0.0, -0.5, 1.5]])
GAINS = (1.6, 1.0, 1.4)
SENSITIVITY = np.array([1 / 1.6, 1.0, 1 / 1.4])
PLANES = np.linspace(-0.8, 0.8, 11)
STRIP = 134  # rows of the sensor that are drawn together


def lattice_of(shape: tuple[int, int]) -> Lattice:
    """The lenslets of the picture."""
    true = drawn_lattice(
        "hexagonal", PITCH, degrees=DEGREES, origin=(shape[0] / 2 + 0.3, shape[1] / 2)
    )
    row = true.second - true.first / 2
    return Lattice(
        "hexagonal",
        (float(true.origin[0]), float(true.origin[1])),
        (float(row[0]), float(row[1])),
        (float(true.first[0]), float(true.first[1])),
        shape,
    )


def draw(shape: tuple[int, int]) -> tuple[Array, Array]:
    """A scene of waves in colour at d = .4, and its white image, digital numbers, uint16."""
    true = drawn_lattice(
        "hexagonal", PITCH, degrees=DEGREES, origin=(shape[0] / 2 + 0.3, shape[1] / 2)
    )
    random = np.random.default_rng(4)
    pictures = np.zeros((2, *shape), np.uint16)
    slope = 0.4 * np.sqrt(0.75) * 14
    channel = np.array([["RGB".index(BAYER[2 * a + b]) for b in (0, 1)] for a in (0, 1)])
    for top in range(0, shape[0], STRIP):
        y, x = np.mgrid[top : min(top + STRIP, shape[0]), : shape[1]].astype(np.float64)
        _, _, dy, dx = true.nearest(y, x)
        colour = channel[y.astype(int) % 2, x.astype(int) % 2]
        at_y, at_x = y - dy + slope * dy, x - dx + slope * dx
        waves = 0.45 + 0.2 * np.sin(0.03 * at_y + 2 * colour) + 0.2 * np.cos(0.041 * at_x - colour)
        r = np.hypot(dy, dx) / PITCH
        even = (1 - 1.6 * r**2) * np.clip((0.485 - r) / 0.09 + 0.5, 0.02, 1) * SENSITIVITY[colour]
        for picture, light in zip(pictures, (waves * even, 0.9 * even), strict=True):
            electrons = light * 5000 + random.normal(0, 1, y.shape) * np.sqrt(light * 5000 + 9)
            numbers = BLACK + electrons / 5000 * (TOP - BLACK)
            picture[top : top + STRIP] = np.clip(np.rint(numbers), 0, TOP)
    return pictures[0], pictures[1]


def packed(frame: Array) -> bytes:
    """Four upper bytes, then the lower two bits of the four, the first pixel's lowest."""
    four = frame.reshape(-1, 4)
    low = sum((four[:, n] & 3) << (2 * n) for n in range(4))
    return bytes(np.concatenate([four >> 2, low[:, None]], axis=1).astype(np.uint8).tobytes())


def write_pictures(folder: Path, shape: tuple[int, int]) -> None:
    """picture.LFR, white.LFR and grid.json."""
    for name, frame in zip(("picture", "white"), draw(shape), strict=True):
        image = {
            "width": shape[1],
            "height": shape[0],
            "pixelPacking": {"endianness": "little", "bitsPerPixel": 10},
            "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": "gr"},
        }
        text = described(
            {"camera": {"model": "ILLUM"}, "image": image},
            black=BLACK, white=TOP, gains=GAINS, matrix=MATRIX.ravel().tolist(),
        )  # fmt: skip
        a_container(folder / f"{name}.LFR", packed(frame), text, newer=True)
    lattice_of(shape).save(folder / "grid.json")


class Stages:
    """Seconds of the stages of a run."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def done(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self._last = now


def by_clplen(folder: Path, stages: Stages) -> Array:
    """The stack by clplen."""
    from clplen import Device, focal_stack, read_lightfield

    device = Device.open()
    stages.done("device")
    lf = read_lightfield(
        folder / "picture.LFR", white=folder / "white.LFR", grid=folder / "grid.json",
        device=device, force=True,
    )  # fmt: skip
    device.finish()
    stages.done("read and decode")
    stack = focal_stack(lf, disparities=PLANES)
    device.finish()
    stages.done("stack")
    stack.save(folder / "clplen.tif")
    stages.done("write")
    return stack.to_numpy()


def unpacked(path: Path, shape: tuple[int, int]) -> Array:
    """The raw pixels of a file that `write_pictures` wrote: the largest section."""
    data = np.fromfile(path, np.uint8)
    count = shape[0] * shape[1]
    start = bytes(data[:4096]).index(b"\x89LFC") + 16 + 80
    groups = data[start : start + count * 5 // 4].reshape(-1, 5).astype(np.uint16)
    out = np.empty((count // 4, 4), np.uint16)
    for n in range(4):
        out[:, n] = (groups[:, n] << 2) | ((groups[:, 4] >> (2 * n)) & 3)
    return out.reshape(shape)


def by_hand(folder: Path, stages: Stages) -> Array:
    """The stack by NumPy and SciPy."""
    import tifffile
    from scipy.ndimage import convolve, map_coordinates, shift

    lattice = Lattice.load(folder / "grid.json")
    assert lattice.shape is not None
    raw, white = (
        unpacked(folder / f"{name}.LFR", lattice.shape).astype(np.float32) - BLACK
        for name in ("picture", "white")
    )
    stages.done("unpack")
    for n in range(4):
        place = (slice(n // 2, None, 2), slice(n % 2, None, 2))
        white[place] /= np.quantile(white[place][::5], 0.995)
        raw[place] *= GAINS["RGB".index(BAYER[n])] / (TOP - BLACK)
    raw /= np.maximum(white, 0.05)
    stages.done("divide by white")
    kernel = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4
    colours = []
    for name in "RGB":
        alone = np.zeros_like(raw)
        for n in (n for n in range(4) if BAYER[n] == name):
            place = (slice(n // 2, None, 2), slice(n % 2, None, 2))
            alone[place] = raw[place]
        colours.append(convolve(alone, kernel / (2 if name == "G" else 1), mode="mirror"))
    stages.done("demosaic")
    grid = lattice.grid(lattice.views(), square=True)
    (V, U), (rows, lenslets) = grid.views, grid.count
    assert grid.columns is not None
    i, k = np.indices((rows, lenslets)).astype(np.float64)
    k += np.where(i % 2, grid.odd_row_shift, 0)
    centre = [grid.first[n] + i * grid.row_step[n] + k * grid.column_step[n] for n in (0, 1)]
    columns = np.arange(grid.columns[0]) * grid.columns[1]
    i, k = np.broadcast_arrays(np.arange(rows)[:, None], columns)
    places = [i, k - np.where(i % 2, grid.odd_row_shift, 0)]
    views = np.empty((V, U, *grid.shape[2:], 3), np.float32)
    for v in range(V):
        for u in range(U):
            at = [
                c + (v - (V - 1) / 2) * down + (u - (U - 1) / 2) * right
                for c, down, right in zip(
                    centre, grid.row_view_step, grid.column_view_step, strict=True
                )
            ]
            for c in range(3):
                hexagonal = map_coordinates(colours[c], at, order=1)
                views[v, u, ..., c] = map_coordinates(hexagonal, places, order=1, mode="nearest")
    stages.done("views")
    views = views @ MATRIX.T.astype(np.float32)
    stages.done("colour matrix")
    stack = np.zeros((len(PLANES), *views.shape[2:]), np.float32)
    for plane, d in zip(stack, PLANES, strict=True):
        for v in range(V):
            for u in range(U):
                moved = ((v - (V - 1) / 2) * d, (u - (U - 1) / 2) * d, 0)
                plane += shift(views[v, u], moved, order=1, mode="nearest")
        plane /= V * U
    stages.done("stack")
    tifffile.imwrite(folder / "hand.tif", stack)
    stages.done("write")
    return stack


WAYS: dict[str, Callable[[Path, Stages], Array]] = {"clplen": by_clplen, "by hand": by_hand}


def run(way: str, folder: Path) -> dict[str, Any]:
    """What a process of its own tells of a way."""
    text = subprocess.run(
        [sys.executable, "-m", "benchmarks", "peers/raw_to_stack", "--only", way,
         "--folder", str(folder)],
        capture_output=True, text=True, check=True,
        env=os.environ | {"XDG_CACHE_HOME": str(folder / "cache")},
    ).stdout  # fmt: skip
    found: dict[str, Any] = json.loads(text.splitlines()[-1])
    return found


def told(way: str, folder: Path) -> None:
    """Run a way here and print its seconds and memory as JSON."""
    stages = Stages()
    WAYS[way](folder, stages)
    used = resource.getrusage(resource.RUSAGE_SELF)
    found = {"stages": stages.seconds, "peak": used.ru_maxrss / 2**20}
    click.echo(json.dumps(found | {"cpu": used.ru_utime + used.ru_stime}))


@click.command()
@click.option("--quick", is_flag=True, help="A picture of 1072 x 1288 pixels.")
@click.option("--folder", type=click.Path(path_type=Path), help="Where files are kept.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1))
@click.option("--only", type=click.Choice(sorted(WAYS)), help="One way, in this process.")
def main(quick: bool, folder: Path | None, repeats: int, only: str | None) -> None:
    """Both ways, each in processes of its own."""
    if only is not None:
        assert folder is not None
        told(only, folder)
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if folder is None else folder
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "picture.LFR").is_file():
            write_pictures(folder, SIZES["quick" if quick else "whole"])
        shutil.rmtree(folder / "cache", ignore_errors=True)
        totals: dict[str, float] = {}
        for way, times in (("clplen", repeats + 1), ("by hand", 1)):
            for number in range(times):
                found = run(way, folder)
                total = sum(found["stages"].values())
                first = number == 0 and way == "clplen"
                if not first:
                    totals[way] = min(total, totals.get(way, np.inf))
                text = ", ".join(f"{name} {s:.2f}" for name, s in found["stages"].items())
                cost = f"{total:.1f} s, CPU {found['cpu']:.1f} s, {found['peak']:.2f} GiB"
                click.echo(f"{way}{' (first)' * first}: {cost}: {text}")
        click.echo(f"by hand over clplen: {totals['by hand'] / totals['clplen']:.1f}")

