"""A giant vesicle before a light-field microscope: a real frame or, without it, a simulated one.

60x/1.2 in water (index 1.35), 593 nm, lenslets of 100 um with f_mu = 2.5 mm, pixels of 6.5 um. The
real frame by R. Oldenbourg (MBL Woods Hole) comes with napari-LF; `$CLPLEN_DATA` names the folder
that holds it as lfm_guv, by default ../shared/data beside the project.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shell
import tifffile
from common import Run
from scipy.optimize import minimize

from clplen import Device, MicrolensArray, PlenopticCamera, PointSources, Projector
from clplen.cameras import Microscope
from clplen.lightfield import Lattice
from clplen.microscopy import preparation

DATA = Path(os.environ.get("CLPLEN_DATA", Path(__file__).parents[2] / "shared" / "data"))
RADIUS = 13.2e-6  # metres, of the real one
SMALLER = 0.4  # the simulated one, whose light stays on the array
COUNTS, DARK = 2e6, 100.0
GAIN = 0.46  # photoelectrons a count of this camera by its maker's data sheet
REAL = (DATA / "lfm_guv").is_dir()


def camera(device: Device, pixels: float = 100 / 6.5, *, index: float = 1.35) -> Microscope:
    """The microscope, with so many pixels a lenslet."""
    array = MicrolensArray(100e-6, 2.5e-3, count=27, fill="full")
    return PlenopticCamera.microscope(magnification=60, na=1.2, medium_index=index, mla=array,
                                      wavelength=593e-9, pixels_per_lenslet=pixels, device=device)


def radius() -> float:
    """Of the vesicle in metres."""
    return RADIUS if REAL else SMALLER * RADIUS


def read() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The real frame, white frame and dark frame."""
    frame, white, dark = (tifffile.imread(DATA / "lfm_guv" / f"{name}_GUVExperim1.tif")
                          for name in ("Lightfield", "Radiometry", "DarkFrame"))
    return frame, white, dark


def frames(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Frame, white frame, dark frame, and which they are."""
    if REAL:
        return *read(), "real frame: R. Oldenbourg, MBL Woods Hole, napari-LF"
    cam = camera(run.device)
    points = PointSources(shell.directions(24 if run.quick else 400)[:, ::-1] * radius())
    light = cam.expose(points).to_numpy().astype(float)
    rng, dark = np.random.default_rng(0), np.full(light.shape, DARK)
    frame = rng.poisson(np.maximum(light, 0) / light.sum() * COUNTS) + dark
    return frame, rng.poisson(2000 * pupils(cam)) + dark, dark, "simulated frame of a hollow shell"


def pupils(cam: Microscope) -> np.ndarray:
    """The objective's pupil behind every lenslet, its rim soft over a pixel."""
    p, rim = cam.mla.pitch, cam.na / cam.magnification * cam.mla.f
    y, x = (np.mod(axis + p / 2, p) - p / 2 for axis in (cam.grid.y, cam.grid.x))
    return np.clip((rim - np.hypot(y[:, None], x)) / cam.pixel_pitch + 0.5, 0, 1)


def beyond(picture: np.ndarray, side: float) -> float:
    """Light from 1.2 to 1.5 of the radius over that of the rim, both above what lies farther."""
    y, x = ((np.arange(size) - (size - 1) / 2) * side / radius() for size in picture.shape)
    r = np.hypot(y[:, None], x)
    far, rim, outside = (picture[(low < r) & (r < high)].mean()
                         for low, high in ((1.55, np.inf), (0.95, 1.05), (1.2, 1.5)))
    return float((outside - far) / (rim - far))


@dataclass(frozen=True)
class Seen:
    """A frame on whole pixels a lenslet: photoelectrons, how sensitive pixels are, and the haze.

    Haze is light of the medium from far beyond the volume. It fills the pupil evenly, so that it
    looks like the white frame, and is as bright as in the darkest lenslets.
    """

    counts: np.ndarray
    white: np.ndarray
    haze: np.ndarray
    lattice: Lattice


def seen(frame: Any, white: Any, dark: Any, pixels: int, device: Device) -> Seen:
    """A raw frame, rectified."""
    prepare = preparation(pixels, device=device, white=white, dark=dark)
    assert prepare.lattice is not None
    found = prepare(frame)
    haze = GAIN * prepare.haze(found.counts, found.white)
    return Seen(GAIN * found.counts, found.white, haze, prepare.lattice)


@dataclass(frozen=True)
class Fitted:
    """A shell that explains a frame: (z, y, x) and radii in metres, dim as of `shell.drawn`."""

    centre: np.ndarray
    radii: np.ndarray
    dim: float
    light: float


def fitted(seen: Seen, projector: Projector, voxels: shell.Voxels, start: shell.Shell,
           *, most: int = 400) -> Fitted:
    """The ellipsoidal shell of revolution that explains the counts best, without deconvolution.

    Least squares in units of the photon noise over centre, radii and dimming; the light of the
    shell and of the haze, which may change over the frame as a quadratic, are linear.
    """
    y, x = np.meshgrid(*(np.linspace(-1, 1, size) for size in seen.counts.shape), indexing="ij")
    noise = np.sqrt(seen.counts + seen.haze.mean())
    haze = [seen.haze * one / noise for one in (1, x, y, x * x, x * y, y * y)]
    counts = (seen.counts / noise).ravel()

    def explained(values: np.ndarray) -> tuple[float, float]:
        """Mean square of what is left, and the light of the shell."""
        centre, (across, along) = values[:3] * 1e-6, values[3:5] * 1e-6
        volume = shell.drawn(voxels, centre, (along, across, across), dim=min(values[5], 1.0))
        frame = seen.white * projector.forward(volume) / noise
        parts = np.stack([frame, *haze]).reshape(len(haze) + 1, -1)
        shares = np.linalg.solve(parts @ parts.T, parts @ counts)
        return float(np.square(counts - shares @ parts).mean()), float(shares[0])

    first = np.array([*start.centre, start.radii[1:].mean(), start.radii[1:].mean()]) * 1e6
    first = np.append(first, 0.5)
    corners = first + np.vstack([np.zeros(6), np.diag([0.5, 0.2, 0.2, 0.3, 1.0, 0.3])])
    found = minimize(lambda values: explained(values)[0], first, method="Nelder-Mead",
                     options={"initial_simplex": corners, "xatol": 0.02, "fatol": 1e-3,
                              "maxfev": most}).x
    across, along = found[3:5] * 1e-6
    return Fitted(found[:3] * 1e-6, np.array([along, across, across]), min(float(found[5]), 1.0),
                  explained(found)[1])


def twin(seen: Seen, projector: Projector, voxels: shell.Voxels, known: Fitted) -> np.ndarray:
    """The frame of a sphere as wide, as bright and as dim at its poles, with photon noise."""
    volume = known.light * shell.drawn(voxels, known.centre, known.radii[1:2], dim=known.dim)
    mean = seen.white * projector.forward(volume) + seen.haze
    return np.random.default_rng(0).poisson(mean)
