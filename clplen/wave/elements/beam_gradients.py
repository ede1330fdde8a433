"""Gradients of a loss with respect to tilts, Gaussian beams and point sources."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.types import Array, Complex128Array
from clplen.wave.elements.beams import gaussian_beam, spherical_wave, tilt
from clplen.wave.field.field import Field, require_field
from clplen.wave.field.field_gradients import log_moments, transmission_gradient
from clplen.wave.field.transmission import offsets

Pair = tuple[float, float]


def tilt_gradient(field: Field, cotangent: Field, direction: Pair) -> dict[str, Array]:
    """Return the gradient of a loss with respect to the direction of a tilt.

    Parameters
    ----------
    field : Field
        Field in front of the tilt, shape (..., ny, nx); for `plane_wave`, a plane wave of direction
        (0, 0).
    cotangent : Field
        Gradient dL/dRe + i dL/dIm with respect to the field behind the tilt, with the shape of
        ``field``.
    direction : tuple of float
        Direction cosines (a_y, a_x) of `tilt`.

    Returns
    -------
    dict of str to numpy.ndarray
        Gradient "direction", (y, x), float64; 0 along an axis of length 1.

    Raises
    ------
    ShapeError
        If the shapes differ.
    ValueError
        If the direction has no propagating wave.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> behind = clplen.wave.tilt(wave, (0.0, 0.001)).to_numpy()
    >>> right = np.where(grid.x > 0, 1j, -1j) * behind  # more phase on the right is more loss
    >>> cotangent = clplen.Field.from_array(right, grid, wavelength=500e-9)
    >>> gradient = clplen.wave.tilt_gradient(wave, cotangent, (0.0, 0.001))["direction"]
    >>> [round(float(value) / 1e6, 1) for value in gradient]  # 2 pi/lam 64 sum abs(x)
    [0.0, 8.2]
    """
    moments = log_moments(tilt(field, direction), cotangent, *offsets(field.grid), order=1).imag
    k = 2 * math.pi / field.wavelength
    return {"direction": k * np.array([moments[1, 0], moments[0, 1]])}


def spherical_wave_gradient(
    cotangent: Field, z: float, *, source: Pair = (0.0, 0.0)
) -> dict[str, Any]:
    """Return the gradient of a loss with respect to a point source.

    Parameters
    ----------
    cotangent : Field
        Gradient dL/dRe + i dL/dIm with respect to the field of `spherical_wave`, shape (ny, nx);
        its grid and wavelength are those of the wave.
    z : float
        Distance from the source to the plane in metres, as in `spherical_wave`.
    source : tuple of float
        Position (y, x) of the source in metres.

    Returns
    -------
    dict of str to float or numpy.ndarray
        Gradients: "z", per metre; "source", (y, x), per metre, float64; and "amplitude", for a
        factor of the wave, at 1.

    Raises
    ------
    ShapeError
        If the cotangent has leading axes.
    ValueError
        If `spherical_wave` does not accept z or the source.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> target = clplen.wave.spherical_wave(grid, 0.1, wavelength=500e-9, source=(0.0, 1e-5))
    >>> wave = clplen.wave.spherical_wave(grid, 0.1, wavelength=500e-9)
    >>> error = wave.to_numpy() - target.to_numpy()  # L = sum abs(error)^2/2
    >>> cotangent = clplen.Field.from_array(error, grid, wavelength=500e-9)
    >>> gradients = clplen.wave.spherical_wave_gradient(cotangent, 0.1)
    >>> bool(gradients["source"][1] < 0)  # the source has to move to larger x
    True
    """
    require_field(cotangent)
    grid, lam = cotangent.grid, cotangent.wavelength
    wave = spherical_wave(grid, z, wavelength=lam, device=cotangent.device, source=source)
    of_log = cotangent.device.download(transmission_gradient(wave, cotangent))
    of_log = np.conj(of_log.astype(np.complex128))
    y, x = offsets(grid, source)
    rho2 = y[:, None] ** 2 + x**2
    r = np.sqrt(rho2 + z**2)
    by_r = math.copysign(2 * math.pi / lam, z) * 1j - 1 / r  # derivative of log exp(ik r sign z)/r
    by_z = -2j * math.pi / lam * rho2 / (r * (r + abs(z))) - z / r**2
    by_source = [-(of_log * by_r * s / r).sum().real for s in (y[:, None], x)]
    return {
        "z": float((of_log * by_z).sum().real),
        "source": np.array(by_source),
        "amplitude": float(of_log.sum().real),
    }


def gaussian_beam_gradient(
    cotangent: Field,
    waist: float,
    *,
    z: float = 0.0,
    centre: Pair = (0.0, 0.0),
    direction: Pair = (0.0, 0.0),
) -> dict[str, Any]:
    """Return the gradient of a loss with respect to a Gaussian beam.

    Parameters
    ----------
    cotangent : Field
        Gradient dL/dRe + i dL/dIm with respect to the field of `gaussian_beam`, shape (ny, nx);
        its grid and wavelength are those of the beam.
    waist, z : float
        Waist radius and distance from the waist in metres, as in `gaussian_beam`.
    centre : tuple of float
        Position (y, x) of the waist in metres.
    direction : tuple of float
        Direction cosines (a_y, a_x) of the beam.

    Returns
    -------
    dict of str to float or numpy.ndarray
        Gradients: "waist" and "z", per metre; "centre", per metre, and "direction", (y, x),
        float64; and "amplitude", for a factor of the beam, at 1.

    Raises
    ------
    ShapeError
        If the cotangent has leading axes.
    ValueError
        If `gaussian_beam` does not accept the values.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> beam = clplen.wave.gaussian_beam(grid, 100e-6, wavelength=500e-9)
    >>> g = clplen.wave.gaussian_beam_gradient(beam, 100e-6)  # of L = sum abs(u)^2/2
    >>> f"{g['waist'] * 100e-6:.1f}, {g['amplitude']:.1f}"  # pi w^2/(2 dx^2) = 157.1
    '157.1, 157.1'
    """
    require_field(cotangent)
    grid, lam = cotangent.grid, cotangent.wavelength
    beam = gaussian_beam(
        grid, waist, wavelength=lam, device=cotangent.device, z=z, centre=centre,
        direction=direction,
    )  # fmt: skip
    y, x = offsets(grid, centre)
    moments = np.conj(log_moments(beam, cotangent, y, x))
    axes = [
        _beam_axis(axis, waist, z, a, lam) if n > 1 else np.zeros(4)
        for axis, a, n in zip((moments[:, 0], moments[0]), direction, grid.shape, strict=True)
    ]
    return {
        "waist": float(axes[0][0] + axes[1][0]),
        "z": float(axes[0][1] + axes[1][1]),
        "centre": np.array([axes[0][2], axes[1][2]]),
        "direction": np.array([axes[0][3], axes[1][3]]),
        "amplitude": float(moments[0, 0].real),
    }


def _beam_axis(sums: Complex128Array, waist: float, z: float, a: float, lam: float) -> Array:
    """Return the gradients along an axis with respect to waist, z, centre and direction cosine.

    log t = -log(q)/2 + 2 pi i a (s - a z/2)/lam - (s - a z)^2/(w^2 q), q = 1 + i z lam/(pi w^2).
    """
    k, walk = 2j * math.pi / lam, a * z
    q, by_z = 1 + 1j * z * lam / (math.pi * waist**2), 1j * lam / (math.pi * waist**2)
    by_waist = -2 * (q - 1) / waist
    zeroth = sums[0]
    first = sums[1] - walk * sums[0]  # first moment of s - a z
    second = sums[2] - 2 * walk * sums[1] + walk**2 * sums[0]
    of_q = -zeroth / (2 * q) + second / (waist**2 * q**2)
    steep = 2 * first / (waist**2 * q)
    gradients = (
        of_q * by_waist + 2 * second / (waist**3 * q),
        of_q * by_z - k * a**2 / 2 * zeroth + a * steep,
        -k * a * zeroth + steep,
        k * first + z * steep,
    )
    return np.array(gradients).real
