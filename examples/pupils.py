"""A light-field microscope with an aberrated pupil: figure 7.2.

10x/0.2 in air, 525 nm, 11 x 11 lenslets of 60 um at f/25 with 11 x 11 pixels each.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from common import BLUE, ORANGE, Run
from matplotlib.axes import Axes

from clplen import MicrolensArray, PlenopticCamera
from clplen.cameras import Microscope
from clplen.microscopy import PupilFit

COUNT = 11  # lenslets
SIDE = 6.0  # um of a lenslet in the specimen
NAMES = {5: "astig., oblique", 6: "astigmatism", 7: "coma, y", 8: "coma, x", 9: "trefoil",
         10: "trefoil, oblique", 11: "spherical"}  # fmt: skip


def camera(run: Run, pupil: Any = None) -> Microscope:
    """With a pupil."""
    return PlenopticCamera.microscope(
        magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11, pupil=pupil,
        mla=MicrolensArray(60e-6, 1.5e-3, count=COUNT, fill="full"), device=run.device)


def helix(z: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A helix 32 um wide, 100 um high, 1.2 um (rms) thick across and 5 um along z."""
    x = (np.arange(shape[2]) - (shape[2] - 1) / 2) * COUNT * SIDE / shape[2]
    deep, volume = z[:, None, None] * 1e6, np.zeros(shape)
    for t in np.linspace(-0.5, 0.5, 200):
        cy, cx = (16 * way(2.5 * np.pi * t) for way in (np.sin, np.cos))
        across = np.hypot(x[:, None] - cy, x - cx) / 1.2
        volume += np.exp(-0.5 * (across**2 + ((deep - 100 * t) / 5) ** 2))
    return volume


def draw_pupils(panels: Any, pupils: Any, words: Any) -> Any:
    """Optical path over the pupils, one scale."""
    y, x = np.mgrid[-1:1:201j, -1:1:201j]
    rho, theta = np.hypot(y, x), np.arctan2(y, x)
    paths = [np.where(rho <= 1, one.path(rho, theta) * 1e9, np.nan) for one in pupils]
    largest = np.nanmax(np.abs(paths))
    for panel, path, pupil, name in zip(panels, paths, pupils, words, strict=True):
        drawn = panel.imshow(path, cmap="RdBu_r", vmin=-largest, vmax=largest)
        panel.set(xticks=[], yticks=[], title=f"pupil {name}: {pupil.rms * 1e9:.1f} nm rms")
        panel.set_frame_on(False)
    return drawn


def draw_terms(panel: Axes, found: PupilFit, put_in: Mapping[int, float]) -> None:
    """Coefficients, and by how much they are off."""
    at = np.arange(len(found.terms))
    true = np.array([put_in.get(j, 0.0) for j in found.terms]) * 1e9
    panel.bar(at, true, color="0.8", label="put in")
    panel.plot(at, found.coefficients * 1e9, "o", color=BLUE, ms=4, label="found")
    for k, (c, error) in enumerate(zip(found.coefficients * 1e9 - true, found.errors * 1e9,
                                       strict=True)):
        panel.text(k, 68, f"{c:+.1f}\n$\\pm${error:.1f}", ha="center", va="bottom", fontsize=6.5)
    panel.axhline(0, color="0.4", lw=0.6)
    panel.set(xticks=at, ylim=(-72, 90), ylabel="nm of path, rms",
              title="Zernike terms; off by, nm")
    panel.set_xticklabels([NAMES[j] for j in found.terms], fontsize=7, rotation=30, ha="right")
    panel.legend(loc="lower left")


def draw_section(panel: Axes, volume: np.ndarray, z: np.ndarray, words: str) -> None:
    """The largest along y, square root."""
    side, step = COUNT * SIDE / 2, np.diff(z)[0] * 5e5
    panel.imshow(np.sqrt(np.clip(volume.max(axis=1), 0, 1)), cmap="inferno", vmin=0, vmax=1,
                 origin="lower", aspect="auto",
                 extent=(-side, side, z[0] * 1e6 - step, z[-1] * 1e6 + step))
    panel.set(xlabel="x / um", ylabel="z / um", title=words)


def draw_residuals(panel: Axes, volumes: Mapping[str, Any], mean: np.ndarray) -> None:
    """What is left of the frame over iterations, and what photon noise leaves."""
    for (name, one), colour in zip(volumes.items(), (ORANGE, BLUE), strict=False):
        panel.semilogy(one.residuals, color=colour, label=f"with {name}")
    panel.axhline(mean.sum() / np.square(mean).sum(), color="0.4", ls="--", lw=1,
                  label="photon noise alone")
    panel.set(xlabel="iterations", title="residual of the frame")
    panel.legend(loc="upper right")
