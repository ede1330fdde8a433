"""Effect of a camera with lenslets on focus measures, and accuracy of depth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import CameraModel

Real = np.ndarray[Any, np.dtype[np.floating[Any]]]

BAND = (0.1, 0.45)  # cycles a lenslet: band of the spectral energy
UNFLOORED = 0.8  # of the ambiguity offset: limit up to which the transfer function is not floored
# Diameter of the disc of a hexagon's area over its width
_HEXAGON_DIAMETER = math.sqrt(2 * math.sqrt(3) / math.pi)
# Of the share by which steep lenslets and large pixels change alpha - 1: uncertain part
_UNCERTAIN_SHARE = 1 / 5
_NODES = 16  # nodes of the quadrature over a round lenslet
_MIN_AIRY, _MAX_AIRY = 0.05, 0.2  # Airy radii a lenslet
_AIRY_FACTOR = 1.22  # times lam F/D
_FWHM = 0.886  # of sinc^2, over its first zero
_FWHM_PER_SIGMA = 2.355
# Standard deviation of alpha over p/D by blur in lenslets, without noise; it comes from the point's
# position on the lenslets. Measured on the cameras of claims "uncertainty".
_BLURS = (0.3, 0.9, 1.4, 1.8, 2.25, 2.75, 3.5, 5.0, 6.0)
_DEVIATIONS = {
    "compensated": (0.54, 0.45, 0.28, 0.19, 0.12, 0.085, 0.066, 0.062, 0.058),
    "energy": (0.54, 0.46, 0.27, 0.24, 0.19, 0.135, 0.08, 0.073, 0.088),
    "slope": (0.83, 0.75, 0.50, 0.47, 0.28, 0.20, 0.12, 0.10, 0.09),
}


@dataclass(frozen=True)
class LensletBlur:
    """Blur by the lenslets."""

    # Ambiguity offset lam f_mu/(dx d), in lenslet diameters, at one cycle a sensor pixel
    q: float  # Lenslet diameter over pitch, (y, x)
    fill: tuple[float, float]  # Lenslet diameter over pitch, (y, x)
    circular: bool  # True for round lenslets, False for square ones
    # Variance of other blur of the spots behind lenslets, along one axis, in square pixels
    variance: float = 0.0

    def transfer(self, ky: Real, kx: Real, *, shear: tuple[float, float]) -> Real:
        """Return the factor on the spectrum of a refocused image."""
        ny, nx = (k * fill for k, fill in zip((ky, kx), self.fill, strict=True))
        ty, tx = (np.abs(self.q * c * k) for k, c in zip((ky, kx), shear, strict=True))
        gy, gx = (
            np.exp(-2 * np.pi**2 * self.variance * (c * k) ** 2)
            for k, c in zip((ky, kx), shear, strict=True)
        )
        if self.circular:
            lens = disc_ambiguity(
                np.hypot(ny[:, None], nx[None, :]), np.hypot(ty[:, None], tx[None, :])
            )
            return lens * (gy[:, None] * gx[None, :])
        return (gy * interval_ambiguity(ny, ty))[:, None] * (gx * interval_ambiguity(nx, tx))


def interval_ambiguity(frequency: Real, offset: Real) -> Real:
    """Return the ambiguity function of a unit interval, (1 - t) sinc(k (1 - t)) for t < 1.

    Woodward 1953, "Probability and information theory", chapter 7.
    """
    overlap = np.maximum(1 - offset, 0)
    return overlap * np.sinc(frequency * overlap)


def disc_ambiguity(frequency: Real, offset: Real) -> Real:
    """Return the ambiguity function of a unit disc, frequency parallel to the offset.

    (4/pi) times the integral of cos(2 pi k x) over the overlap of two discs ``offset`` apart; with
    x = (sin(angle) - offset)/2 its integrand is smooth (Gauss-Legendre quadrature).
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    t = np.minimum(offset, 1)[..., None]
    half = (np.pi / 2 - np.arcsin(t)) / 2
    angle = np.pi / 2 - half * (1 + nodes)
    wave = np.cos(np.pi * frequency[..., None] * (np.sin(angle) - t))
    return 4 / np.pi * (half * weights * np.cos(angle) ** 2 * wave).sum(axis=-1)


@dataclass(frozen=True)
class Pupil:
    """Apertures of the main lens and the lenslets.

    Attributes
    ----------
    radius : float
        Radius of the main lens' aperture, in views along x.
    lenslet : float
        Radius of round lenslets in pitches; inf if the lenslets fill the plane.
    airy : float
        Radius of the main lens' Airy disc on the array, in pitches.
    """

    radius: float
    lenslet: float = math.inf
    airy: float = 0.0

    @property
    def sharpness(self) -> float:
        """Weight of the rim correction: 1 for a sharp rim of the blur, 0 at the diffraction limit.

        It falls between 0.05 and 0.2 Airy radii a lenslet, measured with `estimate_alpha`:
        diffraction at the rim then outweighs partial illumination.
        """
        return float(np.clip((_MAX_AIRY - self.airy) / (_MAX_AIRY - _MIN_AIRY), 0, 1))


@dataclass(frozen=True)
class CameraOptics:
    """Optical constants of a camera that affect focus measures."""

    blur: LensletBlur
    # Bias of the plane of highest energy towards the focus: U^2/(U^2 + s^2), U the rms radius of
    # the pupil, s that of the blur of directions (diffraction, aberrations, pixel area)
    kappa: float
    tolerance: float  # p/D, the change of alpha that blurs a focused point by a lenslet
    pupil: Pupil
    # Share of alpha - 1 by which steep lenslets and large pixels change alpha
    corrected: float

    def band(self, c_max: float) -> tuple[float, float]:
        """Return the frequency range without floor of the transfer function, cycles a lenslet."""
        return (BAND[0], min(BAND[1], UNFLOORED / (self.blur.q * c_max)))

    def bias(self, alpha: float, method: str) -> float:
        """Return the mean error of an alpha by a method; only "energy" has one, by kappa."""
        return (alpha - 1) * (1 - 1 / self.kappa) if method == "energy" else 0.0

    def deviation(self, alpha: float, method: str, noise: float) -> float:
        """Return the standard deviation of an alpha by "compensated", "energy" or "slope".

        ``noise`` is the part due to the noise of the samples.
        """
        offset = abs(1 - alpha + self.bias(alpha, method))
        share = float(np.interp(offset / self.tolerance, _BLURS, _DEVIATIONS[method]))
        return math.hypot(share * self.tolerance, _UNCERTAIN_SHARE * self.corrected * offset, noise)


def camera_optics(lf: LightField) -> CameraOptics | None:
    """Return the optics of a light field's camera, None without camera or spacing."""
    camera = lf.camera
    if camera is None or lf.spacing is None or not np.isfinite(lf.spacing).all():
        return None
    diameter, p = camera.lenslet_diameter, camera.lenslet_pitch
    if camera.lenslet_lattice == "hexagonal" and camera.lenslet_fill != "circular":
        diameter *= _HEXAGON_DIAMETER
    q = camera.wavelength * camera.lenslet_focal_length / (camera.pixel_pitch * diameter)
    fill = (diameter / abs(lf.spacing[2]), diameter / abs(lf.spacing[3]))
    spot_variance = getattr(camera, "spot_variance", 0.0)  # optional attribute of cameras
    spread = (_FWHM * q / _FWHM_PER_SIGMA) ** 2 + spot_variance
    view = abs(lf.spacing[1])
    radius = camera.aperture_diameter / 2 / view
    paraxial = camera.pixel_pitch * camera.image_distance / camera.lenslet_focal_length
    variance = _pupil_variance(lf, radius)
    return CameraOptics(
        LensletBlur(q, fill, _has_round_lenslets(camera), spot_variance),
        variance / (variance + spread),
        p / camera.aperture_diameter,
        Pupil(
            radius,
            camera.lenslet_diameter / 2 / p if camera.lenslet_fill == "circular" else math.inf,
            _AIRY_FACTOR
            * camera.wavelength
            * camera.image_distance
            / (camera.aperture_diameter * p),
        ),
        abs(paraxial / view - 1) + spot_variance / variance,
    )


def _pupil_variance(lf: LightField, radius: float) -> float:
    """Return the mean square of u, in views, over the views within the pupil's radius."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in lf.shape[:2])
    weights = np.where(np.hypot(v[:, None], u[None, :]) <= radius, lf.weights, 0)
    if not weights.any():
        return radius**2 / 4
    return float((weights * u**2).sum() / weights.sum())


def _has_round_lenslets(camera: CameraModel) -> bool:
    """Return True for round lenslets; hexagonal cells count as round."""
    return camera.lenslet_fill == "circular" or camera.lenslet_lattice == "hexagonal"
