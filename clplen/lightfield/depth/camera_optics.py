"""What a camera with lenslets does to the sharpness of points, and how exactly depth is known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import CameraModel

Real = np.ndarray[Any, np.dtype[np.floating[Any]]]

BAND = (0.1, 0.45)  # cycles a lenslet, of the spectral energy
UNFLOORED = 0.8  # of the ambiguity offset: up to here the transfer function is not floored
_HEXAGON = math.sqrt(2 * math.sqrt(3) / math.pi)  # disc as large as a hexagon, over its width
_UNKNOWN = 1 / 5  # of the share of alpha - 1 that steep lenslets and large pixels change
_NODES = 16  # of the quadrature over a round lenslet
_SHARP, _BLURRED = 0.05, 0.2  # Airy radii a lenslet
_AIRY = 1.22  # of lam F/D
_FWHM = 0.886  # of sinc^2, in units of its first zero
_FWHM_PER_SIGMA = 2.355
# Standard deviation of alpha over p/D at blurs of so many lenslets, where there is no noise: by
# where points fall on the lenslets. Measured on the cameras of claims "uncertainty".
_BLURS = (0.3, 0.9, 1.4, 1.8, 2.25, 2.75, 3.5, 5.0, 6.0)
_DEVIATIONS = {
    "compensated": (0.54, 0.45, 0.28, 0.19, 0.12, 0.085, 0.066, 0.062, 0.058),
    "energy": (0.54, 0.46, 0.27, 0.24, 0.19, 0.135, 0.08, 0.073, 0.088),
    "slope": (0.83, 0.75, 0.50, 0.47, 0.28, 0.20, 0.12, 0.10, 0.09),
}


@dataclass(frozen=True)
class LensletBlur:
    """How the lenslets smooth what they record."""

    # lam f_mu/(dx d): the ambiguity offset, in lenslet diameters, of one cycle a sensor pixel
    q: float
    fill: tuple[float, float]  # Lenslet diameter over pitch, (y, x)
    circular: bool  # Round lenslets; square ones otherwise
    # Of what else blurs the spots behind lenslets, along one axis, in square pixels
    variance: float = 0.0

    def transfer(self, ky: Real, kx: Real, *, shear: tuple[float, float]) -> Real:
        """Factor on the spectrum of a refocused image."""
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
    """Ambiguity function of an interval of length 1: (1 - t) sinc(k (1 - t)), 0 from t = 1.

    Woodward 1953, "Probability and information theory", chapter 7.
    """
    overlap = np.maximum(1 - offset, 0)
    return overlap * np.sinc(frequency * overlap)


def disc_ambiguity(frequency: Real, offset: Real) -> Real:
    """Ambiguity function of a disc of diameter 1, the frequency parallel to the offset.

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
    """What a point's light passes: the main lens, and the lenslets.

    Attributes
    ----------
    radius : float
        Of the main lens' aperture, in views along x.
    lenslet : float
        Radius of round lenslets in pitches; inf where they fill the plane.
    airy : float
        Radius of the main lens' Airy disc on the array, in pitches.
    """

    radius: float
    lenslet: float = math.inf
    airy: float = 0.0

    @property
    def sharpness(self) -> float:
        """1 where the rim of a blur is sharp against a lenslet, 0 where diffraction blurs it.

        Between .05 and .2 Airy radii a lenslet, measured with `estimate_alpha`: beyond, what
        diffraction does to the lenslets at the rim outweighs that they are lit in part.
        """
        return float(np.clip((_BLURRED - self.airy) / (_BLURRED - _SHARP), 0, 1))


@dataclass(frozen=True)
class CameraOptics:
    """What the camera does to a focus measure."""

    blur: LensletBlur
    # By which the plane of highest energy is nearer to the focus than the object: U^2/(U^2 + s^2)
    # with U the rms radius of the pupil and s that of what blurs directions: diffraction at the
    # lenslets, their aberrations, the area of the pixels
    kappa: float
    tolerance: float  # p/D, the change of alpha that blurs a point in focus by a lenslet
    pupil: Pupil
    # Share of alpha - 1 by which steep lenslets and large pixels change it: what is known of that
    # is not all
    corrected: float

    def band(self, c_max: float) -> tuple[float, float]:
        """Frequencies where the transfer function is not floored, in cycles a lenslet."""
        return (BAND[0], min(BAND[1], UNFLOORED / (self.blur.q * c_max)))

    def bias(self, alpha: float, method: str) -> float:
        """What an alpha found by a method is off by in the mean: that of "energy" by kappa."""
        return (alpha - 1) * (1 - 1 / self.kappa) if method == "energy" else 0.0

    def deviation(self, alpha: float, method: str, noise: float) -> float:
        """Standard deviation of an alpha found by "compensated", "energy" or "slope".

        ``noise`` is that by the noise of the samples alone.
        """
        off = abs(1 - alpha + self.bias(alpha, method))
        share = float(np.interp(off / self.tolerance, _BLURS, _DEVIATIONS[method]))
        return math.hypot(share * self.tolerance, _UNKNOWN * self.corrected * off, noise)


def camera_optics(lf: LightField) -> CameraOptics | None:
    """Those of the camera of a light field; None where camera or spacing are not known."""
    camera = lf.camera
    if camera is None or lf.spacing is None or not np.isfinite(lf.spacing).all():
        return None
    diameter, p = camera.lenslet_diameter, camera.lenslet_pitch
    if camera.lenslet_lattice == "hexagonal" and camera.lenslet_fill != "circular":
        diameter *= _HEXAGON
    q = camera.wavelength * camera.lenslet_focal_length / (camera.pixel_pitch * diameter)
    fill = (diameter / abs(lf.spacing[2]), diameter / abs(lf.spacing[3]))
    other = getattr(camera, "spot_variance", 0.0)  # cameras that tell have it
    spread = (_FWHM * q / _FWHM_PER_SIGMA) ** 2 + other
    view = abs(lf.spacing[1])
    radius = camera.aperture_diameter / 2 / view
    paraxial = camera.pixel_pitch * camera.image_distance / camera.lenslet_focal_length
    variance = _pupil_variance(lf, radius)
    return CameraOptics(
        LensletBlur(q, fill, _has_round_lenslets(camera), other),
        variance / (variance + spread),
        p / camera.aperture_diameter,
        Pupil(
            radius,
            camera.lenslet_diameter / 2 / p if camera.lenslet_fill == "circular" else math.inf,
            _AIRY * camera.wavelength * camera.image_distance / (camera.aperture_diameter * p),
        ),
        abs(paraxial / view - 1) + other / variance,
    )


def _pupil_variance(lf: LightField, radius: float) -> float:
    """Mean square of u, in views, over the views inside the pupil of a radius in views."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in lf.shape[:2])
    weights = np.where(np.hypot(v[:, None], u[None, :]) <= radius, lf.weights, 0)
    if not weights.any():
        return radius**2 / 4
    return float((weights * u**2).sum() / weights.sum())


def _has_round_lenslets(camera: CameraModel) -> bool:
    """Hexagonal cells count as round."""
    return camera.lenslet_fill == "circular" or camera.lenslet_lattice == "hexagonal"
