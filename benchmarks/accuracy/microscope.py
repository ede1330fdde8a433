"""Errors of volumes deconvolved from simulated frames with photon noise.

    python -m benchmarks accuracy/microscope [--device pocl] [--only volumes,...] [--quick]

A line for each figure with its limit; without a limit where it only informs. 20x/0.5, 525 nm,
lenslets of 125 um at f/20, 25 pixels and 5 voxels (1.25 um) a lenslet. "error" is the norm of
the difference from the true volume over its own norm.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import click
import numpy as np
from setups_microscope import beads, counted, filaments, projector_of, shell, wrong

from clplen import Device, Projector, deconvolve

Row = tuple[str, float, str, bool]
Vector = np.ndarray[Any, Any]
THIRTEEN = np.arange(-30, 31, 5) * 1e-6
PHOTONS = (2e6, 2e4)
SHAPES = {"shell": shell, "beads": beads, "filaments": filaments}
WAYS: dict[str, dict[str, Any]] = {
    "RL": {},
    "RL, accelerated": {"accelerate": True, "iterations": 15},
    "tv": {"prior": "tv"},
    "tv, accelerated": {"prior": "tv", "accelerate": True, "iterations": 15},
    "tv of strength 1/3": {"prior": "tv", "strength": 1 / 3},
    "gaussian": {"prior": "gaussian"},
}


def near_to(name: str, found: float, reference: float, off: float) -> Row:
    """A figure within so much of a reference."""
    return name, found, f"{reference:g} +- {off:.2g}", abs(found - reference) <= off


def below(name: str, found: float, most: float, what: str = "") -> Row:
    """A figure below another one."""
    return name, found, f"below {most:.3g}{what}", found < most


def told(name: str, found: float) -> Row:
    """A figure without a limit."""
    return name, found, "", True


def volumes(device: Device, quick: bool) -> Iterator[Row]:
    """Known volumes, two light levels: errors by back-projection, iterations, priors."""
    projector = projector_of(device, THIRTEEN, 11)
    for name, shape in list(SHAPES.items())[: 1 if quick else None]:
        for photons in PHOTONS[1:] if quick else PHOTONS:
            frame, true = counted(projector, shape(projector), photons)
            plain = projector.backward(frame)
            plain *= np.vdot(plain, true) / np.vdot(plain, plain)
            lit = np.square(frame, dtype=float).sum() / frame.sum() - 1
            yield told(f"{name}, {photons:.0e} photons: photons of a pixel that sees light", lit)
            text = "    error of "
            level = wrong(plain, true)
            yield told(text + "back-projection, best scale", level)
            most = {"": (level, " (back-projection)")}
            for way, given in WAYS.items():
                found = deconvolve(frame, projector, **({"iterations": 30} | given)).volume
                error = wrong(found, true)
                # smooth volumes are what priors are for
                limit = most.get(name if "prior" in given else "", most[""])
                free = way == "RL, accelerated"  # which soon fits the noise
                yield told(f"{text}{way}", error) if free else below(f"{text}{way}", error, *limit)
                if way == "RL":
                    most["shell"] = (error, " (RL)")
            found = deconvolve(frame, projector, iterations=60, residual="noise")
            yield told(
                f"{text}RL to the noise, {found.iterations} iterations", wrong(found.volume, true)
            )


def native(device: Device, quick: bool) -> Iterator[Row]:
    """Volumes with nothing near the native plane: what is found there."""
    for step in (5,) if quick else (5, 2):
        z = np.arange(-30, 31, 5) * 1e-6 if step == 5 else np.arange(-18, 19, 2) * 1e-6
        projector = projector_of(device, z, 11)
        near = np.abs(z) < 6.5e-6
        for photons in PHOTONS:
            volume = filaments(projector)
            volume[near] = 0
            frame, true = counted(projector, volume, photons)
            text = f"filaments without z = 0, every {step} um, {photons:.0e} photons: "
            base: dict[str, float] = {}
            for way in ("RL", "tv", "gaussian"):
                found = deconvolve(frame, projector, iterations=30, **WAYS[way]).volume
                middle = len(z) // 2
                at_zero = float(found[middle].sum() / found.sum())
                yield told(f"{text}share of the light found at z = 0, {way}", at_zero)
                for what, value in (
                    ("share near z = 0", float(found[near].sum() / found.sum())),
                    ("error of it", float(np.linalg.norm(found[near]) / np.linalg.norm(true))),
                    ("error of all", wrong(found, true)),
                ):
                    line = f"    {what}, {way}"
                    base.setdefault(what, value)
                    less = way == "gaussian"
                    yield below(line, value, base[what], " (RL)") if less else told(line, value)


def acceleration(device: Device, quick: bool) -> Iterator[Row]:
    """Iterations to the residual of twenty plain ones; what they cost in noise."""
    projector = projector_of(device, THIRTEEN, 11)
    for name, shape in list(SHAPES.items())[: 1 if quick else None]:
        for photons in PHOTONS:
            frame, true = counted(projector, shape(projector), photons)
            plain = _course(frame, true, projector, 20 if quick else 40)
            quicker = [
                _state(frame, true, projector, iterations=count, accelerate=True)[1:]
                for count in range(1, 14 if quick else 26)
            ]
            text = f"{name}, {photons:.0e} photons: "
            aim, error = plain[19]
            done = next((k for k, one in enumerate(quicker) if one[0] <= aim), len(quicker) - 1)
            yield below(f"{text}iterations to the residual of 20", done + 1, 14)
            yield near_to(
                "    error there, over that of 20 plain ones", quicker[done][1] / error, 1, 0.05
            )
            if quick:
                continue
            yield told("    error after 20 plain ones", error)
            yield told("    error after 20 accelerated ones", quicker[19][1])
            for what, course in (("plain", plain), ("accelerated", quicker)):
                best = min(range(len(course)), key=lambda k: course[k][1])
                yield told(f"    least error, {what}, after {best + 1}", course[best][1])


def _course(frame: Vector, true: Vector, projector: Projector, count: int) -> list[Any]:
    """Residual and error after 1, 2, ... plain iterations."""
    volume, course = None, []
    for _ in range(count):
        volume, *state = _state(frame, true, projector, iterations=1, start=volume)
        course.append(state)
    return course


def _state(frame: Vector, true: Vector, projector: Projector, **given: Any) -> tuple[Any, ...]:
    """A volume, its residual and its error."""
    found = deconvolve(frame, projector, **given).volume
    off = np.square(projector.forward(found).astype(float) - frame).sum()
    return found, float(off / np.square(frame, dtype=float).sum()), wrong(found, true)


SECTIONS: dict[str, Callable[[Device, bool], Iterator[Row]]] = {
    one.__name__: one for one in (volumes, native, acceleration)
}


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--only", default=",".join(SECTIONS), show_default=True)
@click.option("--quick", is_flag=True, help="Fewer volumes and iterations.")
def main(selector: str | None, only: str, quick: bool) -> None:
    """A table of figures and limits; ends with 1 where one is not met."""
    device = Device.open(selector)
    click.echo(f"{device!r}\n")
    met = True
    for name in only.split(","):
        for what, found, limit, is_met in SECTIONS[name](device, quick):
            met &= is_met
            click.echo(f"{what:<88}{found:>11.4g}   {limit}{'' if is_met else '  NOT MET'}")
    sys.exit(0 if met else 1)

