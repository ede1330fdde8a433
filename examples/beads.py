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
from scipy.ndimage import gaussian_filter

from clplen import (
    FocalStack,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    focal_stack,
)
from clplen.cameras import Microscope
from clplen.lightfield import Lattice
from clplen.microscopy import Points, find_points, match_points

DATA = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))
REAL = (DATA / "lfm_beads").is_dir()
QUICK = (slice(300, 840), slice(1000, 1540))  # pixels of the real frame
GAIN, ZERO = 2.0, 90.0  # of the simulated camera
FARTHEST = 12  # lenslets apart at most, of pixels that are compared
BINS = 40

STEP = 0.05  # lenslets a pixel of a sub-image, between planes
PLANES = STEP * np.arange(-30, 31)
SIZE = (2.3, 0.64)  # planes, lenslets: sigma of a point, its width at half height over 2.35
DISTANCE = (4.0, 1.5)  # planes, lenslets: nearer ones are not told apart
LIMITS = (1.0, 0.3)  # planes, lenslets: what is to hold
WITHIN = (4 * STEP, 1.5, 1.5)  # further apart are not of the same bead


def frames(run: Run) -> tuple[np.ndarray, np.ndarray, str]:
    """Frame of beads, white frame, and which they are."""
    if REAL:
        part = QUICK if run.quick else (slice(None), slice(None))
        found = (tifffile.imread(DATA / "lfm_beads" / f"img_{name}.tif")[part]
                 for name in ("beads", "bg"))
        return *found, "real frame: HyLFM-Net, MIT licence"
    cam = camera(run)
    rng = np.random.default_rng(1)
    places = rng.uniform(-1, 1, (8 if run.quick else 25, 3)) * (50e-6, 50e-6, 45e-6)
    light = cam.expose(PointSources(places)).to_numpy().astype(float)
    p, radius = cam.mla.pitch, cam.na / cam.magnification * cam.mla.f
    y, x = (np.mod(axis + p / 2, p) - p / 2 for axis in (cam.grid.y, cam.grid.x))
    pupil = np.clip((radius - np.hypot(y[:, None], x)) / cam.pixel_pitch + 0.5, 0.02, 1)
    counts = (np.maximum(light, 0) / light.sum() * 1e5 * len(places) + 2, 300 * pupil)
    frame, white = (GAIN * rng.poisson(mean) + ZERO for mean in counts)
    return frame, white, "simulated frame"


def camera(run: Run) -> Microscope:
    """The microscope of the simulated frame; of the real one, an objective that is assumed.

    What its frames tell: pixels of 6.5 um see a lenslet of 125 um as 19.2, and sub-images fill
    their cells, so that objective and lenslets match, M/(2 NA) = f_mu/p. 40x/0.8 in water would.
    """
    if REAL:
        mla = MicrolensArray(125e-6, 3.125e-3, count=45, fill="full")
        return PlenopticCamera.microscope(magnification=40, na=0.8, medium_index=1.33, mla=mla,
                                          wavelength=525e-9, pixels_per_lenslet=20,
                                          device=run.device)
    mla = MicrolensArray(125e-6, 2.5e-3, count=21, fill="full")
    return PlenopticCamera.microscope(magnification=20, na=0.5, mla=mla, wavelength=525e-9,
                                      pixels_per_lenslet=25, device=run.device)


def photon_transfer(white: np.ndarray, lattice: Lattice) -> tuple[float, float]:
    """Gain in grey levels a count, and the grey level at which noise vanishes.

    Pixels of lenslets that lie a nearly whole number of pixels apart see the same light. In bins of
    their mean m, variance = gain (m - zero) + c g^2, where g is the slope of the picture and the
    last term what lenslets off their places leave. `zero` is the offset less the square of the
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


def bright(lf: LightField) -> np.ndarray:
    """The views whose white level is above half of the brightest one's: 1, the others 0."""
    return (lf.weights > 0.5).astype(np.float32)


def stack_of(lf: LightField, some: np.ndarray | float = 1.0, *,
             interpolation: str = "fourier") -> FocalStack:
    """Refocused on all planes, from the bright views."""
    return focal_stack(lf, disparities=PLANES, aperture=bright(lf) * some,
                       interpolation=interpolation)


def points_of(stack: FocalStack) -> Points:
    """The beads of a stack."""
    return find_points(stack, size=SIZE, distance=DISTANCE)


def compared(what: str, first: Points, second: Points, *, step: float = STEP) -> np.ndarray:
    """Differences (planes, lenslets) of two lists of the same beads, and a line on them."""
    pairs = match_points(first.positions, second.positions, tolerance=WITHIN)
    far = first.positions[pairs[:, 0]] - second.positions[pairs[:, 1]]
    off = np.stack([np.abs(far[:, 0]) / step, np.hypot(far[:, 1], far[:, 2])], axis=1)
    rms, most = np.sqrt((off**2).mean(0)), off.max(0)
    held = int((off <= LIMITS).all(1).sum())
    print(f"  {what:<24} {len(first):4d} and {len(second):4d} points, {len(pairs):4d} in both, "
          f"{held:4d} within limits; rms {rms[1]:.3f} lenslets, {rms[0]:.3f} planes, "
          f"largest {most[1]:.3f}, {most[0]:.3f}")
    alone = [(snr, d) for k, one in enumerate((first, second))
             for snr, d in np.delete(np.stack([one.snr, one.positions[:, 0]], 1), pairs[:, k], 0)]
    words = ", ".join(f"{snr:.2f} at {d:.2f}" for snr, d in sorted(alone, reverse=True))
    print(f"    in one list only: {'snr and d ' + words if words else 'none'}")
    return off


def clear(stack: np.ndarray) -> np.ndarray:
    """A stack less what is smooth in each plane, for the eye."""
    return np.maximum(stack - gaussian_filter(stack, (0, 2, 2), mode="nearest"), 0)
