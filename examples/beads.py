"""Fluorescent beads before a light-field microscope: a real frame, or a simulated one like it.

The real frames, of beads and of an even fluorescent slide, come with HyLFM-Net (on GitHub as
kreshuklab/hylfm-net, MIT licence), without the optics; `$CLPLEN_DATA` names the folder that holds
them as lfm_beads, by default ../shared/data beside the project.
"""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import tifffile
from common import Run

from clplen import Lattice, LightField, MicrolensArray, PlenopticCamera, PointSources
from clplen.lightfield.calibration import decode_raw

DATA = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))
REAL = (DATA / "lfm_beads").is_dir()
QUICK = (slice(300, 840), slice(1000, 1540))  # pixels of the real frame
GAIN, ZERO = 2.0, 90.0  # of the simulated camera
FARTHEST = 12  # lenslets apart at most, of pixels that are compared
BINS = 40


def frames(run: Run) -> tuple[np.ndarray, np.ndarray, str]:
    """Frame of beads, white frame, and which they are."""
    if REAL:
        part = QUICK if run.quick else (slice(None), slice(None))
        found = (tifffile.imread(DATA / "lfm_beads" / f"img_{name}.tif")[part]
                 for name in ("beads", "bg"))
        return *found, "real frame: HyLFM-Net, MIT licence"
    mla = MicrolensArray(125e-6, 2.5e-3, count=21, fill="full")
    cam = PlenopticCamera.microscope(magnification=20, na=0.5, mla=mla, wavelength=525e-9,
                                     pixels_per_lenslet=25, device=run.device)
    rng = np.random.default_rng(1)
    places = rng.uniform(-1, 1, (8 if run.quick else 25, 3)) * (50e-6, 50e-6, 45e-6)
    light = cam.expose(PointSources(places)).to_numpy().astype(float)
    p, radius = mla.pitch, cam.na / cam.magnification * mla.f
    y, x = (np.mod(axis + p / 2, p) - p / 2 for axis in (cam.grid.y, cam.grid.x))
    pupil = np.clip((radius - np.hypot(y[:, None], x)) / cam.pixel_pitch + 0.5, 0.02, 1)
    counts = (np.maximum(light, 0) / light.sum() * 1e5 * len(places) + 20, 300 * pupil)
    frame, white = (GAIN * rng.poisson(mean) + ZERO for mean in counts)
    return frame, white, "simulated frame"


def photon_transfer(white: np.ndarray, lattice: Lattice) -> tuple[float, float]:
    """Gain in grey levels a count, and the grey level at which noise vanishes.

    Pixels of lenslets that lie a nearly whole number of pixels apart see the same light. In bins of
    their mean m, variance = gain (m - zero) + c g^2, where g is the slope of the picture and the
    last term what the fraction of a pixel leaves. `zero` is the offset less the square of the
    readout noise over the gain, so that (level - zero)/gain has the variance of Poisson counts.
    """
    pitch, most = lattice.column[1], white.shape[1] // 3
    apart = [k * pitch for k in range(2, FARTHEST + 1) if k * pitch < most]
    step = round(min(apart, key=lambda far: abs(far - round(far))))
    left, middle, right = (white[:, k:white.shape[1] - 2 * step + k].astype(float)
                           for k in (0, step, 2 * step))
    mean, off = (left + middle + right) / 3, (left - 2 * middle + right) / np.sqrt(6)
    slope = np.gradient(mean, axis=1) ** 2
    edges = np.quantile(mean, np.linspace(0.001, 0.999, BINS + 1))
    rows = []
    for low, high in pairwise(edges):
        chosen = (mean >= low) & (mean <= high)
        spread = np.percentile(off[chosen], (15.865, 84.135))  # hot pixels do not count
        rows.append((mean[chosen].mean(), 1.0, slope[chosen].mean(), (np.diff(spread)[0] / 2) ** 2))
    *model, variance = np.array(rows).T
    scaled = np.array(model) / variance
    gain, offset, _ = np.linalg.lstsq(scaled.T, np.ones(BINS), rcond=None)[0]
    return float(gain), float(-offset / gain)


def halves(frame: np.ndarray, gain: float, zero: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two frames of independent noise, each count given to one of them by a coin.

    Halves of Poisson counts are Poisson counts, independent of each other (binomial thinning). Both
    are scaled to the grey levels of the frame, less `zero`.
    """
    counts = np.maximum(np.rint((frame - zero) / gain), 0).astype(np.int64)
    first = np.random.default_rng(seed).binomial(counts, 0.5)
    return 2 * gain * first, 2 * gain * (counts - first)


def views(run: Run, frame: np.ndarray, lattice: Lattice, white: np.ndarray) -> LightField:
    """Light field of a frame, both frames without their zero."""
    return decode_raw(frame, lattice, device=run.device, white=white)


def bright(lf: LightField) -> np.ndarray:
    """The views whose white level is above half of the brightest one's: 1, the others 0."""
    return (lf.weights > 0.5).astype(np.float32)
