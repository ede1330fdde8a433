"""How right pupils are that are found from a microscope's own frames, and what they are good for.

    python benchmarks/accuracy_pupil.py [--device pocl] [--only beads,shell,...] [--quick]

20x/0.5, 525 nm, lenslets of 125 um at f/20, 5 x 5 pixels a lenslet (25 of 5 x 5 parts), 2e5 photons
a frame. Astigmatism, coma, trefoil and spherical aberration (Noll's 6, 8, 9, 11) of 60 nm rms
together, drawn at random. Frames of scenes come from twelve planes and 5 x 5 voxels a lenslet,
their pupils from six planes and 3 x 3 voxels. "off" is the norm of the four errors; "error" that of
the volume over its own norm, 20 iterations. "field" is a frame of 9 x 27 lenslets with filaments of
points whose astigmatism grows along x, found in 1 x 3 patches; what is put in is the mean over the
points of a patch. Ends with 1 where beads are off by 10 nm, filaments, the shell or a patch by
20 nm. The vesicle's frame: benchmarks/vesicle_residual.py.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from setups_microscope import beads, counted, filaments, shell, wrong

from clplen import (
    Device,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    Projector,
    deconvolve,
    point_images,
)  # fmt: skip
from clplen.cameras import Microscope
from clplen.microscopy import fit_pupil, fit_pupil_patches

TERMS = (6, 8, 9, 11)
RMS, PHOTONS = 60e-9, 2e5
TRUE_PLANES = np.linspace(-27.5, 27.5, 12) * 1e-6
PLANES = np.linspace(-25, 25, 6) * 1e-6
SCENES = {"filaments": filaments, "shell": shell, "voxels": beads}
LIMITS = {"beads": 10e-9, "filaments": 20e-9, "shell": 20e-9, "field": 20e-9}
LENSLETS, BEADS = 9, 10
SIDE = 6.25e-6  # of a lenslet in the specimen
PATCHES, SLOPE = 3, 60e-9 / (13.5 * SIDE)  # along x; metres of astigmatism (6) a metre
Vector = np.ndarray[Any, Any]


def microscope(
    device: Device, pupil: Any = None, count: int | tuple[int, int] = LENSLETS
) -> Microscope:
    """With 25 pixels a lenslet, of which 5 x 5 are one of the sensor."""
    return PlenopticCamera.microscope(
        magnification=20, na=0.5, wavelength=525e-9, pixels_per_lenslet=25, pupil=pupil,
        mla=MicrolensArray(125e-6, 2.5e-3, count=count, fill="full"), device=device,
    )  # fmt: skip


def drawn(seed: int) -> Vector:
    """Four coefficients."""
    found = np.random.default_rng(seed).normal(size=len(TERMS))
    return np.asarray(found * RMS / np.linalg.norm(found))


def words(values: Vector) -> str:
    """In nanometres."""
    return " ".join(f"{value * 1e9:6.1f}" for value in values)


def of_beads(device: Device, seed: int) -> tuple[str, float]:
    """Ten beads anywhere, found in the frame itself."""
    true, rng, count = drawn(seed), np.random.default_rng(seed + 100), 13
    half = 5 * SIDE
    low, high = np.array([-half, -half, -30e-6]), np.array([half, half, 30e-6])
    places, power = rng.uniform(low, high, (BEADS, 3)), rng.uniform(0.5, 1, BEADS)
    points = PointSources(places, power=power * PHOTONS / power.sum())
    fine = microscope(device, dict(zip(TERMS, true, strict=True)), count).expose(points).to_numpy()
    mean = fine.reshape(5 * count, 5, 5 * count, 5).sum(axis=(1, 3), dtype=float) + 0.5
    frame, began = rng.poisson(mean), time.perf_counter()
    camera = microscope(device, count=count)
    z = np.linspace(-35, 35, 8) * 1e-6
    found = fit_pupil(frame, camera, planes=z, beads="find", terms=TERMS, binning=5)
    off = float(np.linalg.norm(found.coefficients - true))
    text = f"beads      {seed}  put in {words(true)}  found {words(found.coefficients)}"
    text += f"  +- {words(found.errors)}  off {off * 1e9:5.1f} nm"
    text += f"; {len(found.energies)} for {BEADS} beads"
    text += f"; residual {found.residuals[0]:.4f} to {found.residuals[-1]:.4f}"
    text += f", chi2 {found.chi2:.2f}"
    return text + f"; {time.perf_counter() - began:.0f} s", off


def of_scene(device: Device, name: str, seed: int, volumes: bool) -> tuple[list[str], float]:
    """A scene's frame, its pupil, and its volume without and with it."""
    true = drawn(seed)
    aberrated = microscope(device, dict(zip(TERMS, true, strict=True)))
    images = point_images(aberrated, TRUE_PLANES, binning=5, cut=5e-3)
    known = Projector(images, (LENSLETS, LENSLETS), device=device)
    frame, volume = counted(known, SCENES[name](known), PHOTONS, seed)
    began = time.perf_counter()
    found = fit_pupil(
        frame, microscope(device), planes=PLANES, terms=TERMS, binning=5, steps=3
    )  # fmt: skip
    off = float(np.linalg.norm(found.coefficients - true))
    text = f"{name:10} {seed}  put in {words(true)}  found {words(found.coefficients)}"
    text += f"  +- {words(found.errors)}  off {off * 1e9:5.1f} nm"
    text += f"; residual {found.residuals[0]:.4f} to {found.residuals[-1]:.4f}"
    text += f", chi2 {found.chi2:.2f}"
    lines = [text + f"; {time.perf_counter() - began:.0f} s"]
    if not volumes:
        return lines, off
    lines.append(f"{'':13} error of the volume, residual:")
    for what, pupil in (("without", None), ("found", found.pupil), ("true", aberrated.pupil)):
        projector = known
        if what != "true":
            images = point_images(microscope(device, pupil), TRUE_PLANES, binning=5, cut=5e-3)
            projector = Projector(images, (LENSLETS, LENSLETS), device=device)
        made = deconvolve(frame, projector, iterations=20)
        lines[-1] += f"  {what} {wrong(made.volume, volume):.3f}, {made.residuals[-1]:.4f}"
    return lines, off


def of_field(device: Device) -> tuple[str, float]:
    """Filaments whose astigmatism grows along x, in patches."""
    began, rng = time.perf_counter(), np.random.default_rng(5)
    count = (LENSLETS, PATCHES * LENSLETS)
    half = np.array([count[1], count[0]]) * SIDE / 2
    t, lines = np.linspace(-25e-6, 25e-6, 60), []
    for at in np.linspace(-0.9, 0.9, 5 * PATCHES):
        middle = (at * half[0], rng.uniform(-0.5, 0.5) * half[1], rng.uniform(-1, 1) * 12e-6)
        along = rng.normal(size=3)
        lines.append(middle + t[:, None] * along / np.linalg.norm(along))
    points = np.concatenate(lines)
    inside = (np.abs(points[:, :2]) < half - SIDE / 2).all(axis=1) & (abs(points[:, 2]) < 25e-6)
    points = points[inside]
    column = np.floor((points[:, 0] + half[0]) / SIDE).astype(int)
    mean = np.zeros((5 * count[0], 5 * count[1]))
    for one in np.unique(column):
        here = points[column == one]
        camera = microscope(device, {6: SLOPE * float(here[:, 0].mean())}, count)
        fine = camera.expose(PointSources(here)).to_numpy()
        mean += fine.reshape(5 * count[0], 5, 5 * count[1], 5).sum(axis=(1, 3), dtype=float)
    frame = rng.poisson(mean * PATCHES * PHOTONS / mean.sum())
    found = fit_pupil_patches(
        frame, microscope(device, count=count), (1, PATCHES), planes=PLANES, terms=TERMS,
        binning=5, steps=3,
    )[0]  # fmt: skip
    lines, worst = [], 0.0
    for number, one in enumerate(found):
        true = np.zeros(len(TERMS))
        true[0] = SLOPE * points[column // LENSLETS == number, 0].mean()
        off = float(np.linalg.norm(one.coefficients - true))
        text = f"field      patch {number}  put in {words(true)}  found {words(one.coefficients)}"
        text += f"  +- {words(one.errors)}  off {off * 1e9:5.1f} nm"
        text += f"; residual {one.residuals[0]:.4f} to {one.residuals[-1]:.4f}, chi2 {one.chi2:.2f}"
        lines.append(text)
        worst = max(worst, off)
    return "\n".join(lines) + f"; {time.perf_counter() - began:.0f} s", worst


FRAMES = (("filaments", 1), ("filaments", 2), ("voxels", 4), ("shell", 3))
NAMES = ("beads", *SCENES, "field")


def rows(device: Device, only: list[str], quick: bool) -> Iterator[tuple[str, str, float]]:
    """(name, line, off)."""
    for seed in (1,) if quick else (1, 2, 3):
        if "beads" in only:
            yield "beads", *of_beads(device, seed)
    for name, seed in FRAMES[:1] if quick else FRAMES:
        if name in only:
            lines, off = of_scene(device, name, seed, volumes=not quick)
            yield name, "\n".join(lines), off
    if "field" in only and not quick:
        yield "field", *of_field(device)


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--only", default=",".join(NAMES), show_default=True, help="Which.")
@click.option("--quick", is_flag=True, help="One of beads and one of filaments, no volumes.")
def main(selector: str | None, only: str, quick: bool) -> None:
    """A line for each frame."""
    met = True
    for name, line, off in rows(Device.open(selector), only.split(","), quick):
        good = off < LIMITS.get(name, np.inf)
        met &= good
        click.echo(line + ("" if good else "  NOT MET"))
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
