"""A giant vesicle before a light-field microscope: a real frame, or one like it for figure 3.8.

60x/1.2 in water (index 1.35), 593 nm, lenslets of 100 um with f_mu = 2.5 mm, pixels of 6.5 um. The
real frame by R. Oldenbourg (MBL Woods Hole) comes with napari-LF; `$CLPLEN_DATA` names the folder
that holds it as lfm_guv, by default ../shared/data beside the project.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import tifffile
from common import Run

from clplen import MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras.microscope import Microscope

DATA = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))
RADIUS = 13.2e-6  # metres, of the real one
SMALLER = 0.4  # the simulated one, whose light stays on the array
COUNTS, DARK = 2e6, 100.0
REAL = (DATA / "lfm_guv").is_dir()


def camera(run: Run) -> Microscope:
    """The microscope."""
    array = MicrolensArray(100e-6, 2.5e-3, count=27, fill="full")
    return PlenopticCamera.microscope(magnification=60, na=1.2, medium_index=1.35, mla=array,
                                      wavelength=593e-9, pixels_per_lenslet=100 / 6.5,
                                      device=run.device)


def radius() -> float:
    """Of the vesicle in metres."""
    return RADIUS if REAL else SMALLER * RADIUS


def frames(cam: Microscope, *, quick: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Frame, white frame, dark frame, and which they are."""
    folder = DATA / "lfm_guv"
    if REAL:
        found = (tifffile.imread(folder / f"{name}_GUVExperim1.tif")
                 for name in ("Lightfield", "Radiometry", "DarkFrame"))
        return *found, "real frame: R. Oldenbourg, MBL Woods Hole, napari-LF"
    k = np.arange(24 if quick else 400) + 0.5
    z, turn = 1 - 2 * k / len(k), np.pi * (1 + np.sqrt(5)) * k
    shell = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], 1)
    light = cam.expose(PointSources(shell * radius())).to_numpy().astype(float)
    rng, dark = np.random.default_rng(0), np.full(light.shape, DARK)
    frame = rng.poisson(np.maximum(light, 0) / light.sum() * COUNTS) + dark
    return frame, rng.poisson(2000 * pupils(cam)) + dark, dark, "simulated frame of a hollow shell"


def pupils(cam: Microscope) -> np.ndarray:
    """The objective's pupil behind every lenslet, its rim soft over a pixel."""
    p, radius = cam.mla.pitch, cam.na / cam.magnification * cam.mla.f
    y, x = (np.mod(axis + p / 2, p) - p / 2 for axis in (cam.grid.y, cam.grid.x))
    return np.clip((radius - np.hypot(y[:, None], x)) / cam.pixel_pitch + 0.5, 0, 1)
