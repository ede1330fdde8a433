"""Cameras in white light, and lenslets whose glass disperses, for tests of colours.

The focal length of a lenslet is found in raw images by the closed form of a square opening (Fresnel
integrals; Goodman 2005, section 4.5); a point in focus beside a lenslet's middle moves by
X (1 - z3/f) + z3 X/z2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import fresnel

from clplen import Coherence, Device, MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras import Aberrations, ColorFilterArray, PixelArray, Plenoptic1
from clplen.wave import Glass, LensletSurface, SpectralDistribution

Values = np.ndarray[Any, Any]

GLASS = Glass.named("SF11")
DESIGN = 587.5618e-9  # helium's yellow line, of `LensletSurface.design_wavelength`


def white_cameras(device: Device) -> dict[str, Plenoptic1]:
    """Cameras with Bayer filters, of small lenslets."""
    bayer = ColorFilterArray.bayer("GRBG")
    shared: dict[str, Any] = {"object_distance": 1.0, "wavelength": 550e-9, "device": device}
    fast = MicrolensArray(20e-6, 40e-6, count=(19, 17), lattice="hexagonal", fill="full")
    glass = MicrolensArray(
        30e-6, count=(15, 17), surface=LensletSurface(0.12e-3, GLASS), lattice="hexagonal"
    )
    slow = MicrolensArray(40e-6, 0.32e-3, count=13)
    pixels = {pitch: PixelArray(pitch=pitch, filters=bayer) for pitch in (1.4e-6, 3.1e-6, 4.1e-6)}
    return {
        "f/2, 20 um": PlenopticCamera.type1(
            focal_length=0.03, aperture_diameter=0.015, mla=fast, pixels=pixels[1.4e-6], **shared
        ),
        "f/5, SF11": PlenopticCamera.type1(
            focal_length=0.05, aperture_diameter=0.010, mla=glass, pixels=pixels[3.1e-6], **shared
        ),
        "f/8, 40 um": PlenopticCamera.type1(
            focal_length=0.04, aperture_diameter=0.005, mla=slow, pixels=pixels[4.1e-6], **shared
        ),
    }


def by_wavelengths(
    camera: Plenoptic1, position: Any, light: SpectralDistribution, number: int | None
) -> tuple[Values, int]:
    """The raw image of a point, and by how many wavelengths."""
    coherence = None if number is None else Coherence(None, light.spectrum, wavelengths=number)
    raw = camera.expose(PointSources(position, spectrum=light), coherence=coherence)
    assert raw.exposure is not None
    assert raw.exposure.wavelengths is not None
    return raw.to_numpy().astype(np.float64), raw.exposure.wavelengths


def apart(found: Values, wanted: Values) -> float:
    """L2 difference, relative."""
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def dispersive(
    device: Device, wavelength: float, *, pitch: float, focal_length: float, shift: float,
    aperture: float, count: int,
) -> Plenoptic1:  # fmt: skip
    """A camera of parabolic lenslets of SF11, its sensor moved by a share of the focal length."""
    radius = focal_length * (float(GLASS.index(DESIGN)) - 1)
    surface = LensletSurface(radius, GLASS, conic=-1.0)
    return PlenopticCamera.type1(
        focal_length=0.1, object_distance=0.4, aperture_diameter=aperture, wavelength=wavelength,
        mla=MicrolensArray(pitch, surface=surface, count=count, fill="full"),
        pixels=PixelArray(pitch=2e-6, shape=(201, 203)), lens_model="corrected",
        aberrations=Aberrations(sensor_shift=shift * focal_length), device=device,
    )  # fmt: skip


def focal_length_of(focal_length: float, wavelength: float) -> float:
    """R/(n(lam) - 1) of a lenslet with a focal length at the design wavelength."""
    powers = [float(GLASS.index(lam)) - 1 for lam in (DESIGN, wavelength)]
    return focal_length * powers[0] / powers[1]


def marginal(camera: Plenoptic1, position: Any) -> tuple[Values, Values]:
    """Energy by columns of the raw image of a point, sum 1, and their x in metres."""
    raw = camera.expose(PointSources(position)).to_numpy().astype(np.float64)
    n = camera.grid.shape[1]
    x = camera.grid.origin[1] + (np.arange(n) - n // 2) * camera.pixel_pitch
    return raw.sum(axis=0) / raw.sum(), x


def focal_length_in_image(camera: Plenoptic1, dz: float, guess: float) -> float:
    """Of the only lenslet, from the image of a point on the axis that fills it."""
    found, x = marginal(camera, (0.0, 0.0, dz))
    places = x[:, None] + (np.arange(8) - 3.5) / 8 * camera.pixel_pitch
    z2, z3 = camera.array_distance, camera.sensor_distance
    behind = z2 / float(camera.array_alpha(dz)) - z2  # from the array to the main lens' image

    def misfit(f: float) -> float:
        bent = 1 / z3 - 1 / f - 1 / behind
        middle, half = places / (z3 * bent), camera.mla.pitch / 2
        scale = np.sqrt(2 * abs(bent) / camera.wavelength)
        ends = [np.array(fresnel(scale * (edge - middle))) for edge in (-half, half)]
        expected = ((ends[1] - ends[0]) ** 2).sum(axis=0).mean(axis=1)
        return apart(expected / expected.sum(), found)

    coarse = guess * np.linspace(0.9, 1.1, 101)
    best = coarse[int(np.argmin([misfit(f) for f in coarse]))]
    fit = minimize_scalar(
        misfit, bounds=(0.996 * best, 1.004 * best), method="bounded",
        options={"xatol": 1e-6 * guess},
    )  # fmt: skip
    return float(fit.x)


def place_in_image(camera: Plenoptic1, X: float) -> float:
    """Median x of the light behind the middle lenslet, of a point in focus imaged at X."""
    magnification = float(camera.array_scale(0.0))
    found, x = marginal(camera, (X / magnification, 0.0, 0.0))
    own = np.abs(x) < camera.mla.pitch / 2
    share = np.concatenate([[0.0], np.cumsum(found[own])]) / found[own].sum()
    edges = np.append(x[own], x[own][-1] + camera.pixel_pitch) - camera.pixel_pitch / 2
    return float(np.interp(0.5, share, edges))
