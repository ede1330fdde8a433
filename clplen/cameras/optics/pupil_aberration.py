"""Aberrations of an objective and its sample over the pupil, by Zernike terms.

A path W over the pupil multiplies the pupil function by exp(2 pi i W/lam). W = sum_j c_j Z_j with
Noll's Z_j (`clplen.wave.zernike`), c_j metres of optical path, rms over the pupil. rho is the sine
times n over NA, theta the angle of the frequency (fy, fx) on the image side, from +x towards +y.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from clplen.checks import is_finite
from clplen.wave.elements.zernike import noll, plate_terms, zernike, zernike_gradient

Vector = np.ndarray[Any, Any]

_RADIAL_NODES, _ANGULAR_NODES = 64, 64  # nodes of the quadrature over the pupil
_LAST_SHIFT_TERM = 3  # last of Noll's indices without aberration: piston, and two that shift images


@dataclass(frozen=True, init=False)
class PupilAberration:
    """Zernike terms over the pupil of an objective.

    Parameters
    ----------
    coefficients : mapping of int to float
        Noll's index j, 2 or more, to metres of optical path, rms over the pupil. 2 and 3 shift
        images by x and y, 4 is defocus, 5 and 6 astigmatism, 7 and 8 coma, 9 and 10 trefoil,
        11 spherical aberration.

    Attributes
    ----------
    terms : tuple of (int, float)
        Noll's index and metres in ascending order, without zeros.

    Raises
    ------
    TypeError
        If the coefficients are not a mapping.
    ValueError
        If an index does not exist, or a coefficient is not finite or above a millimetre.

    Examples
    --------
    >>> pupil = clplen.cameras.PupilAberration({6: 30e-9, 11: -40e-9})
    >>> pupil
    <PupilAberration 6: 30 nm, 11: -40 nm, 50 nm rms>
    >>> f"{pupil.path(1.0, 0.0) * 1e9:.1f} nm at the rim along x"
    '-16.0 nm at the rim along x'
    """

    terms: tuple[tuple[int, float], ...]

    def __init__(self, coefficients: Mapping[int, float]) -> None:
        plate_terms(coefficients, "noll")
        if any(int(j) < 2 for j in coefficients):
            raise ValueError(
                "Terms of a pupil must begin with 2, got 1: a piston does not change an image."
            )
        terms = sorted((int(j), float(c)) for j, c in coefficients.items() if c)
        object.__setattr__(self, "terms", tuple(terms))

    def __repr__(self) -> str:
        parts = [f"{j}: {c * 1e9:.4g} nm" for j, c in self.terms]
        return f"<PupilAberration {', '.join([*parts, f'{self.rms * 1e9:.3g} nm rms'])}>"

    @property
    def coefficients(self) -> dict[int, float]:
        """Noll's index to metres."""
        return dict(self.terms)

    @property
    def rms(self) -> float:
        """Rms of the path over the pupil in metres."""
        return math.hypot(*(c for _, c in self.terms))

    @property
    def orders(self) -> tuple[int, ...]:
        """Azimuthal order m of each term, negative for sines."""
        return tuple(noll(j)[1] for j, _ in self.terms)

    @property
    def is_symmetric(self) -> bool:
        """True if the path does not depend on the angle."""
        return not any(self.orders)

    def path(self, rho: Any, theta: Any) -> Vector:
        """Compute W in metres.

        Parameters
        ----------
        rho, theta : array_like
            Polar coordinates in the pupil, the rim at 1; W is 0 beyond.

        Returns
        -------
        numpy.ndarray
        """
        shape = np.broadcast(rho, theta).shape
        total = sum((c * zernike(*noll(j), rho, theta) for j, c in self.terms), np.zeros(shape))
        return np.asarray(np.where(np.asarray(rho) <= 1, total, 0.0))

    @cached_property
    def steepest(self) -> float:
        """Steepest slope of W within the rim, in metres over the pupil's radius."""
        rho, theta = _nodes()[:2]
        y, x = rho * np.sin(theta), rho * np.cos(theta)
        down, right = np.zeros(rho.shape), np.zeros(rho.shape)
        for j, c in self.terms:
            dy, dx = zernike_gradient(*noll(j), y, x)
            down, right = down + c * dy, right + c * dx
        return float(np.hypot(down, right).max())

    @classmethod
    def from_index_mismatch(
        cls, depth: float, sample_index: float, *, na: float, medium_index: float, terms: int = 22
    ) -> PupilAberration:
        """Compute the aberration of a point in a sample with another index than the medium.

        W = d (sqrt(n_s^2 - s^2) - (n/n_s) sqrt(n^2 - s^2)) with s = n sin(theta): the sample
        replaces the medium, refocused so that the paraxial focus stays (Gibson and Lanni 1991,
        eq. 3; the phase of Torok, Varga, Laczik and Booker 1995, eq. 32). Light loss at the
        boundary is neglected.

        Parameters
        ----------
        depth : float
            Depth d of the point below the cover glass in metres.
        sample_index : float
            Refractive index n_s of the sample, above NA.
        na, medium_index : float
            Numerical aperture and medium of the objective.
        terms : int
            Noll's index of the last term of the expansion.

        Returns
        -------
        PupilAberration
            Terms without piston, with defocus.

        Raises
        ------
        ValueError
            If the sample's index is not above NA, the depth is more than 0.01 m, or there are fewer
            than four terms.

        Examples
        --------
        >>> clplen.cameras.PupilAberration.from_index_mismatch(
        ...     20e-6, 1.33, na=1.2, medium_index=1.40, terms=11)
        <PupilAberration 4: -188.4 nm, 11: -91.86 nm, 210 nm rms>
        """
        _check_pupil(na, medium_index)
        if not (is_finite(sample_index) and sample_index > na):
            raise ValueError(
                f"sample_index must be above NA {na:g}, got {sample_index!r}: use a larger index "
                "or a smaller NA."
            )
        if not (is_finite(depth) and 0 <= depth <= 0.01):
            raise ValueError(
                f"depth must be 0 to 0.01 m below the cover glass, got {depth!r}: 20 um are 20e-6."
            )
        n, g = float(medium_index), float(sample_index)

        def path(rho: Vector, _: Vector) -> Vector:
            s2 = (na * rho) ** 2
            refocused = (n / g) * np.sqrt(n**2 - s2)
            return np.asarray(depth * (np.sqrt(g**2 - s2) - refocused))

        return cls(fitted_terms(path, terms))

    @classmethod
    def from_tilted_cover(
        cls,
        angle: float,
        *,
        na: float,
        medium_index: float,
        azimuth: float = 0.0,
        thickness: float = 170e-6,
        index: float = 1.5255,
        terms: int = 22,
    ) -> PupilAberration:
        """Compute the aberration of the designed cover glass when it is tilted.

        A plane plate in the medium adds t (sqrt(g^2 - s^2) - sqrt(n^2 - s^2)), s = n sin of the
        angle between ray and normal (Born and Wolf 1999, section 5.4 for its lowest orders). W is
        the path of the tilted plate minus that of the plate at a right angle.

        Parameters
        ----------
        angle : float
            Angle between the normal and the axis in radians, below 0.2.
        na, medium_index : float
            Numerical aperture and medium of the objective.
        azimuth : float
            Direction of the tilt, from +x towards +y of the image side, in radians.
        thickness, index : float
            Thickness in metres and index of the glass; the index must be above NA.
        terms : int
            Noll's index of the last term of the expansion.

        Returns
        -------
        PupilAberration
            Terms without piston and image shifts: defocus, coma, astigmatism.

        Raises
        ------
        ValueError
            If a number is outside its range, or a ray would graze the glass.

        Examples
        --------
        >>> tilted = clplen.cameras.PupilAberration.from_tilted_cover(
        ...     np.radians(1), na=0.8, medium_index=1.0, terms=8)
        >>> [f"{j}: {c * 1e9:.0f} nm" for j, c in tilted.terms]
        ['4: 1 nm', '6: 2 nm', '8: -58 nm']
        """
        _check_pupil(na, medium_index)
        if not (is_finite(index) and na < index < 5):
            raise ValueError(f"index must be above NA and below 5, got {index!r}.")
        if not (is_finite(thickness) and 0 <= thickness <= 0.01):
            raise ValueError(
                f"A cover glass must be 0 to 0.01 m thick, got {thickness!r}: 150 um are 150e-6."
            )
        steepest = math.asin(na / medium_index)
        if not (is_finite(angle) and abs(angle) < min(0.2, math.pi / 2 - steepest)):
            raise ValueError(
                "angle must be below 0.2 rad, and no ray of the pupil may graze the glass, got "
                f"{angle!r}: 1 degree is 0.0175."
            )
        n, g = float(medium_index), float(index)

        def plate(s2: Vector) -> Vector:
            return np.asarray(thickness * (np.sqrt(g**2 - s2) - np.sqrt(n**2 - s2)))

        def path(rho: Vector, theta: Vector) -> Vector:
            sine = na * rho / n
            cosine = np.sqrt(1 - sine**2) * math.cos(angle)
            cosine = cosine + sine * math.sin(angle) * np.cos(theta - azimuth)
            return plate(n**2 * (1 - cosine**2)) - plate((n * sine) ** 2)

        fit = fitted_terms(path, terms)
        return cls({j: c for j, c in fit.items() if j > _LAST_SHIFT_TERM})


def fitted_terms(path: Callable[[Vector, Vector], Vector], last: int) -> dict[int, float]:
    """Fit Zernike terms 2 to ``last`` of a path by inner products over the pupil."""
    if not (is_finite(last) and int(last) == last and 4 <= last <= 200):
        raise ValueError(f"terms must be Noll's index of the last term, 4 to 200, got {last!r}.")
    rho, theta, weights = _nodes()
    values = path(rho, theta) * weights
    fit = {
        j: float((values * zernike(*noll(j), rho, theta)).sum()) for j in range(2, int(last) + 1)
    }
    return {j: c for j, c in fit.items() if abs(c) > 1e-15}


def _nodes() -> tuple[Vector, Vector, Vector]:
    """Return (rho, theta) over the pupil, rho^2 at Gauss-Legendre nodes, and weights of a mean."""
    t, w = np.polynomial.legendre.leggauss(_RADIAL_NODES)
    theta = 2 * np.pi * np.arange(_ANGULAR_NODES) / _ANGULAR_NODES
    rho = np.sqrt((t + 1) / 2)
    weights = np.outer(w / 2, np.ones(_ANGULAR_NODES) / _ANGULAR_NODES)
    return np.outer(rho, np.ones(_ANGULAR_NODES)), np.outer(np.ones(_RADIAL_NODES), theta), weights


def _check_pupil(na: float, medium_index: float) -> None:
    if not (is_finite(na) and is_finite(medium_index) and 0 < na < medium_index):
        raise ValueError(
            f"na must be between 0 and the medium's index, {medium_index!r}, got {na!r}."
        )
