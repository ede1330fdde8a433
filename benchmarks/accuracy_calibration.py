"""How right lenslet lattices and decoded raw frames are, as numbers.

    python benchmarks/accuracy_calibration.py [--device pocl] [--quick]

Drawn white images whose lattice is known; real ones, where ``$CLPLEN_DATA`` (or ../shared/data
beside the project) has them; and the section 1.5 camera decoded by its white image, against the
decode by its own geometry (minutes at full size; --quick takes 53 lenslets across for 101).
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from reference_lattice import Drawn, white
from reference_lattice import lattice as drawn_lattice

from clplen import Device, LightField, SurfaceScene, decode_raw, estimate_lattice
from clplen.cameras import Plane
from clplen.demo import camera, scene
from clplen.lightfield import Lattice

DATA = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))


def say(what: str, value: str, limit: str = "") -> None:
    click.echo(f"  {what:<52} {value:<44} {limit}")


def timed(picture: Any, **words: Any) -> tuple[Lattice, float]:
    start = time.perf_counter()
    found = estimate_lattice(picture, **words)
    return found, time.perf_counter() - start


def drawings() -> Iterator[tuple[str, Drawn, np.ndarray]]:
    """(name, lattice, white image): kinds, pitches, angles, dim lenslets, noise."""
    random = np.random.default_rng(1)
    for kind, pitch, degrees, dim, noisy in (
        ("square", 5.0, 0.0, "none", False),
        ("square", 14.0, -9.0, "random", False),
        ("hexagonal", 9.3, 3.0, "none", False),
        ("hexagonal", 30.7, -9.0, "second", False),
        ("turned", 14.0, 3.0, "none", False),
        ("square", 9.3, 3.0, "none", True),
        ("hexagonal", 14.0, 0.0, "random", True),
        ("square", 60.0, 3.0, "none", True),
    ):
        n = max(300, int(16 * pitch))
        true = drawn_lattice(
            kind, pitch, degrees=degrees, stretch=1.002, origin=(n / 2 + 0.3, n / 2)
        )
        picture = white((n, n + 31), true, dim=dim)
        if noisy:
            picture = picture + random.normal(0, 0.1, picture.shape)  # SNR 10
        lenslets = "" if dim == "none" else f", {dim} dim"
        yield f"{kind} {pitch} px, {degrees:+.0f} deg{lenslets}{', SNR 10' * noisy}", true, picture


def drawn() -> None:
    """Lattices found on drawn white images."""
    for name, true, picture in drawings():
        found, seconds = timed(picture)
        off = np.sqrt((true.off(found.centres()) ** 2).sum(1).mean())
        limit = 0.2 if "SNR" in name else 0.02
        say(name, f"centres {off:.4f} px rms, trust {found.trust}, {seconds:.1f} s", f"{limit} px")


def real() -> None:
    """Lattices of real frames, against what is known of them."""
    import tifffile

    if not (DATA / "lfm_guv").is_dir():
        say(f"real frames: none in {DATA}", "left out")
        return
    flat, dark = (
        tifffile.imread(DATA / "lfm_guv" / f"{name}_GUVExperim1.tif")
        for name in ("Radiometry", "DarkFrame")
    )
    beads = tifffile.imread(DATA / "lfm_beads" / "img_bg.tif")
    for name, picture, words, pitch, centre in (
        ("vesicle, flat less dark", flat, {"dark": dark}, (15.387, 15.410), (210.05, 224.64)),
        ("beads, background", beads, {}, (19.217, 19.217), (608.60, 803.83)),
    ):
        found, seconds = timed(picture, **words)
        matrix = np.array([found.row, found.column])
        places = (np.array(centre) - found.origin) @ np.linalg.inv(matrix)
        off = np.hypot(*((places - np.rint(places)) @ matrix))
        wrong = max(abs(a / b - 1) for a, b in zip(found.pitch, pitch, strict=True))
        text = (
            f"{found.pitch[0]:.3f} x {found.pitch[1]:.3f} px, {np.degrees(found.rotation):+.3f} deg"
        )
        say(f"{name}: pitch, rotation", text, f"{pitch[0]} x {pitch[1]}")
        say("  pitch off by, centre off by, residual", f"{100 * wrong:.3f} %, {off:.3f} px, "
            f"{found.residual:.3f} px, {seconds:.1f} s", ".05 %, .2 px (beads .5)")  # fmt: skip


def simulated(device: Device, count: int) -> None:
    """The raw image of three points, decoded by its white image and by the camera's geometry."""
    cam = camera(device, count=count)
    even = cam.expose(SurfaceScene(Plane(0.0)), model="rays").to_numpy()
    lattice, seconds = timed(even)
    pitch = cam.pixels_per_lenslet * (1 + cam.mla.f / cam.image_distance)
    say(
        f"white image of {count} x {count} lenslets: pitch",
        f"{lattice.pitch[0]:.5f} x {lattice.pitch[1]:.5f} px, {seconds:.1f} s",
        f"{pitch:.5f}",
    )
    raw = scene(cam)
    words = {"views": (30, 30), "step": 1, "devignette": False, "complete": False}
    got = decode_raw(raw.to_numpy(), lattice, device=device, **words).to_numpy()
    edge = (count - got.shape[2]) // 2
    true = LightField.from_raw(replace(raw, lattice=None)).to_numpy()
    inside = true[:, :, edge : count - edge, edge : count - edge]
    error = 1 - np.corrcoef(got.ravel(), inside.ravel())[0, 1]
    say(
        f"decoded, {got.shape[2]} x {got.shape[3]} lenslets: 1 - correlation",
        f"{error:.1e}",
        "1e-3",
    )


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--quick", is_flag=True, help="53 lenslets across in place of 101.")
def main(selector: str | None, quick: bool) -> None:
    """Drawn, real and simulated white images."""
    device = Device.open(selector)
    click.echo(repr(device))
    drawn()
    real()
    simulated(device, 53 if quick else 101)


if __name__ == "__main__":
    main()
