"""A light-field microscope's frame deconvolved by clplen and by other programs, in one run.

    python -m benchmarks peers/microscope [--device pocl] [--pixels 15] [--iterations 8]
        [--python PYTHON --path FOLDER ...] [--only clplen,pyolaf] [--quick]

20x/0.5, 520 nm, lenslets of 125 um at f/20, 15 x 15 pixels and as many voxels (one of them has no
other way) for each of 21 x 21 lenslets, five planes within 24 um. The frame is that of 40 beads
between the voxels of four planes, each simulated by itself, without point images, and has photon
noise. Everybody has a process of its own and the same iteration (Richardson and Lucy, from an even
volume, in NumPy about forward and backward projections); iterations are timed in turn, the medians
stand in the table, with seconds of CPUs in brackets. A residual is sum (I - a H x)^2 / sum I^2 with
each program's own H and the best a. Volumes are compared after a blur of 1.5 voxels, turned over in
z and moved by a voxel where that fits the beads better.

The other programs have an interpreter of their own, --python, and folders, --path, from which they
are imported: pyolaf; src/napari_lf/lfa of napari-LF; fast-light-field with its two extensions built
in place. None of their code is here; those that are not there are left out, with a line.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

from benchmarks.peers.microscope_child import PROGRAMS
from clplen import Device, MicrolensArray, PlenopticCamera, PointSources
from clplen.bench import describe_environment, device_text, quiet_enough

Array = np.ndarray[Any, Any]
FINE = 3  # samples of a pixel along an axis
BEADS, PHOTONS = 40, 1000.0  # photons of the brightest pixel
BLUR = 1.5  # voxels
LARGE = {"lenslets": 21, "planes": [-24e-6, -12e-6, 0.0, 12e-6, 24e-6]}
QUICK = {"pixels": 9, "lenslets": 11, "planes": [-12e-6, 0.0, 12e-6]}


@dataclass
class Peer:
    """A program in its process, and what it answered."""

    name: str
    process: subprocess.Popen[str]
    answers: dict[str, dict[str, Any]] = field(default_factory=dict)
    steps: list[dict[str, Any]] = field(default_factory=list)
    error: str = ""

    def median(self, what: str) -> float:
        """Of the iterations' "seconds" or "cpu"."""
        return statistics.median(step[what] for step in self.steps)

    def ask(self, order: str) -> dict[str, Any]:
        """The answer to an order; without one, or with an error, the program is left out."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(order + "\n")
            self.process.stdin.flush()
            answer = json.loads(self.process.stdout.readline() or '{"error": "it ended"}')
        except (BrokenPipeError, ValueError) as error:
            answer = {"error": str(error)}
        self.error = answer.get("error", "")
        self.answers[order] = answer
        return dict(answer)

    def end(self) -> None:
        """Let the process end."""
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.process.wait()


def camera_of(setup: dict[str, Any], device: Device) -> Any:
    """The microscope, with the pixels that sample the light."""
    array = MicrolensArray(setup["pitch"], setup["focal"], count=setup["lenslets"], fill="full")
    return PlenopticCamera.microscope(
        magnification=setup["magnification"], na=setup["na"], medium_index=setup["index"],
        wavelength=setup["wavelength"], pixels_per_lenslet=setup["pixels"] * FINE, mla=array,
        device=device,
    )  # fmt: skip


def made(setup: dict[str, Any], device: Device) -> tuple[Array, Array]:
    """The frame of beads, and the volume with their energy on the voxels about them."""
    rng, n, count = np.random.default_rng(3), setup["pixels"], setup["lenslets"]
    planes, side = setup["planes"], setup["pitch"] / setup["magnification"] / n
    lit = [z for z in range(len(planes)) if planes[z] != 0]  # in the native plane none is resolved
    extent = 0.3 * count * n * side
    number = rng.choice(lit, BEADS)
    y, x = rng.uniform(-extent, extent, (2, BEADS))
    light = rng.uniform(0.5, 1, BEADS)
    camera, size = camera_of(setup, device), count * n
    frame, truth = np.zeros((size, size)), np.zeros((len(planes), size, size))
    for z, there, beside, energy in zip(number, y, x, light, strict=True):
        source = PointSources([(beside, there, planes[z])])
        seen = camera.sensor_fields(source, camera.grid).intensity().to_numpy()[0]
        pixels = seen.reshape(size, FINE, size, FINE).sum(axis=(1, 3), dtype=np.float64)
        frame += energy * pixels / pixels.sum()
        for at, share in around((there / side + size / 2 - 0.5, beside / side + size / 2 - 0.5)):
            truth[z, at[0], at[1]] += energy * share
    counts = rng.poisson(PHOTONS * frame / frame.max()).astype(np.float32)
    return counts, truth


def around(at: tuple[float, float]) -> list[tuple[tuple[int, int], float]]:
    """The four voxels about a place, and their shares of what is there."""
    (i, fy), (k, fx) = ((int(np.floor(one)), one % 1) for one in at)
    return [
        ((i + dy, k + dx), (fy if dy else 1 - fy) * (fx if dx else 1 - fx))
        for dy in (0, 1)
        for dx in (0, 1)
    ]


def blurred(volume: Array) -> Array:
    """Planes, blurred by a Gaussian."""
    fy, fx = (np.fft.fftfreq(n) for n in volume.shape[1:])
    factor = np.exp(-2 * (np.pi * BLUR) ** 2 * (fy[:, None] ** 2 + fx[None] ** 2))
    return np.asarray(np.fft.ifft2(np.fft.fft2(volume) * factor).real)


def alike(a: Array, b: Array) -> float:
    """Correlation of two volumes."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def laid_over(volume: Array, truth: Array) -> tuple[Array, str]:
    """A volume, turned over in z and moved by a voxel where that fits better, and what was done."""
    ways = [(turn, dy, dx) for turn in (1, -1) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    moved = {way: np.roll(volume[:: way[0]], way[1:], axis=(1, 2)) for way in ways}
    best = max(ways, key=lambda way: alike(moved[way], truth))
    told = (["z turned over"] if best[0] < 0 else []) + (
        [f"moved by ({best[1]}, {best[2]})"] if best[1:] != (0, 0) else []
    )
    return moved[best], ", ".join(told)


def started(name: str, path: str, python: str | None, folders: tuple[str, ...]) -> Peer:
    """The process of a program: clplen in this interpreter, others in theirs."""
    own = name == "clplen"
    root = str(Path(__file__).parents[2])
    where = [root] if own else list(folders)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(where), "MPLBACKEND": "agg"}
    worker = str(Path(__file__).with_name("microscope_child.py"))
    call = [sys.executable if own or python is None else python, worker, name, path]
    log = Path(path).with_name(f"{name}.log").open("w")
    process = subprocess.Popen(
        call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, env=environment
    )
    return Peer(name, process)


def measured(peers: list[Peer], iterations: int) -> list[Peer]:
    """Those that could do everything, their iterations timed in turn."""
    for peer in peers:
        for order in ("version", "images", "weights"):
            if "error" in peer.ask(order):
                break
            if order != "version":
                click.echo(f"{peer.name}: {order} in {peer.answers[order]['seconds']:.1f} s")
    for _ in range(iterations):
        for peer in peers:
            if not peer.error:
                peer.steps.append(peer.ask("step"))
    for peer in peers:
        for order in ("residual", "write"):
            if not peer.error:
                peer.ask(order)
        if peer.error:
            click.echo(f"{peer.name} is left out: {peer.error}")
    return [peer for peer in peers if not peer.error]


def told(peers: list[Peer], truth: Array) -> None:
    """Print the table."""
    beads, found = blurred(truth), {}
    for peer in peers:
        volume = blurred(np.load(peer.answers["write"]["value"]))
        found[peer.name], how = laid_over(volume, beads)
        if how:
            click.echo(f"the volume of {peer.name}: {how}")
    own = found.get("clplen")
    click.echo(
        "| | point images | H'w and the first matrices | an iteration | residual "
        "| correlation with the beads | with clplen | MB at most, images | iterating |\n"
        "|---|---|---|---|---|---|---|---|---|"
    )
    for peer in peers:
        images, weights = (peer.answers[order] for order in ("images", "weights"))
        volume = found[peer.name]
        cells = [
            f"{peer.name} {peer.answers['version']['version']}",
            f"{images['seconds']:.3g} s ({images['cpu']:.3g})",
            f"{weights['seconds']:.3g} s ({weights['cpu']:.3g})",
            f"{peer.median('seconds'):.3g} s ({peer.median('cpu'):.3g})",
            f"{peer.answers['residual']['value']:.4f}",
            f"{alike(volume, beads):.3f}",
            "" if own is None else f"{alike(volume, own):.3f}",
            f"{images['peak']:.0f}",
            f"{peer.answers['write']['peak']:.0f}",
        ]
        click.echo("| " + " | ".join(cells) + " |")


@click.command()
@click.option("--device", "selector", default=None, help="Of clplen, as Device.open takes it.")
@click.option("--pixels", default=15, show_default=True, help="Of a lenslet, odd.")
@click.option("--iterations", default=8, show_default=True, type=click.IntRange(1))
@click.option("--memory", default=-1, help="Bytes for matrices of clplen's projector.")
@click.option("--python", default=None, help="Interpreter of the other programs.")
@click.option("--path", "folders", multiple=True, help="Folder of one of them; repeatable.")
@click.option("--only", default=",".join(PROGRAMS), help="Names, with commas between.")
@click.option("--quick", is_flag=True, help="A small size, to see that it works.")
def main(
    selector: str | None,
    pixels: int,
    iterations: int,
    memory: int,
    python: str | None,
    folders: tuple[str, ...],
    only: str,
    quick: bool,
) -> None:
    """Run everybody."""
    names = only.split(",")
    if unknown := set(names) - set(PROGRAMS):
        raise click.UsageError(f"--only takes {', '.join(PROGRAMS)}, not {', '.join(unknown)}.")
    device = Device.open(selector)
    click.echo(f"{device_text(describe_environment(device))}\n{quiet_enough()}")
    setup: dict[str, Any] = {
        "pitch": 125e-6, "focal": 2.5e-3, "magnification": 20.0, "na": 0.5, "index": 1.0,
        "wavelength": 520e-9, "tube": 0.2, "fine": FINE, "device": selector or "",
        "memory": memory, "pixels": pixels, **(QUICK if quick else LARGE),
    }  # fmt: skip
    frame, truth = made(setup, device)
    with TemporaryDirectory() as folder:
        path = str(Path(folder, "setup.npz"))
        np.savez(path, **{"frame": frame, **setup})
        peers = [started(name, path, python, folders) for name in names]
        try:
            told(measured(peers, iterations), truth)
        finally:
            for peer in peers:
                peer.end()

