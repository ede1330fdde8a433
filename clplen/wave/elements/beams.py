"""Fields of simple sources in one plane, and the tilt that turns a field's direction."""

from __future__ import annotations

import math

import numpy as np

from clplen import units
from clplen.checks import fits_float64, float64_array
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import SamplingWarning, warn_caller
from clplen.wave.field.field import Field, Grid, require_field, require_grid
from clplen.wave.field.sampling import exceeds, nyquist, sampled_from, sampled_radius
from clplen.wave.field.transmission import (
    Vector,
    multiply_separable,
    multiply_sphere,
    offsets,
    phasor,
)

Pair = tuple[float, float]


def plane_wave(
    grid: Grid, *, wavelength: float, device: DeviceLike | None = None, direction: Pair = (0.0, 0.0)
) -> Field:
    """Return a plane wave of unit amplitude, exp(ik(a_y y + a_x x)), phase 0 at the origin.

    Parameters
    ----------
    grid : Grid
        Samples of the plane, shape (ny, nx).
    wavelength : float
        In metres.
    device : Device or str, optional
        Default ``Device.open()``.
    direction : tuple of float
        Direction cosines (a_y, a_x), a_y^2 + a_x^2 < 1. Along an axis of length 1 nothing varies.

    Returns
    -------
    Field
        Of amplitude 1, shape (ny, nx).

    Raises
    ------
    ValueError
        For a direction without a propagating wave, or a wavelength that is not positive.

    Warns
    -----
    SamplingWarning
        If its spatial frequency a/lam is beyond the Nyquist frequency 1/(2 d) of an axis.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9, direction=(0.0, 0.01))
    >>> np.round(np.angle(wave.to_numpy()[32, 33:36], deg=True)).tolist()  # 0.2 cycles a sample
    [72.0, 144.0, -144.0]
    """
    device = _check_wave(grid, wavelength, device)
    _check_direction(direction)
    _warn_beyond_nyquist(grid, _frequencies(direction, wavelength), "A plane wave")
    ty, tx = _tilt_tables(grid, direction, wavelength, device)
    return _separable(ty, tx, grid, wavelength, device)


def tilt(field: Field, direction: Pair) -> Field:
    """Turn a field: times exp(ik(a_y y + a_x x)), as a thin prism does.

    Parameters
    ----------
    field : Field
        Of any shape (..., ny, nx).
    direction : tuple of float
        Direction cosines (a_y, a_x) that are added, a_y^2 + a_x^2 < 1. Along an axis of length 1
        nothing varies.

    Returns
    -------
    Field
        Of the shape of ``field``.

    Raises
    ------
    ValueError
        For a direction without a propagating wave.

    Warns
    -----
    SamplingWarning
        If the frequency a/lam that is added is beyond the Nyquist frequency of an axis.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> turned = clplen.wave.tilt(wave, (0.0, 0.01))
    >>> np.round(np.angle(turned.to_numpy()[32, 33:36], deg=True)).tolist()
    [72.0, 144.0, -144.0]
    """
    require_field(field)
    _check_direction(direction)
    _warn_beyond_nyquist(field.grid, _frequencies(direction, field.wavelength), "A tilt")
    return multiply_separable(
        field, *_tilt_tables(field.grid, direction, field.wavelength, field.device)
    )


def spherical_wave(
    grid: Grid,
    z: float,
    *,
    wavelength: float,
    device: DeviceLike | None = None,
    source: Pair = (0.0, 0.0),
) -> Field:
    """Return the wave of a unit point source, exp(ik(r - abs(z)))/r.

    r is the distance from the source. The carrier exp(ik abs(z)) is dropped, as every propagation
    drops it.

    Parameters
    ----------
    grid : Grid
        Samples of the plane, shape (ny, nx).
    z : float
        Distance from the source to the plane in metres, not 0. Negative: the wave converges to a
        point abs(z) behind the plane, the complex conjugate.
    wavelength : float
        In metres.
    device : Device or str, optional
        Default ``Device.open()``.
    source : tuple of float
        (y, x) of the point in metres. Along an axis of length 1 the point is on the axis.

    Returns
    -------
    Field
        In 1/m: of amplitude 1/abs(z) at the foot of the source.

    Raises
    ------
    ValueError
        For z that is 0 or not finite, a source that is not finite, or a wavelength that is not
        positive.

    Warns
    -----
    SamplingWarning
        If the phase changes by more than pi between neighbouring samples.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.spherical_wave(grid, 0.1, wavelength=500e-9)
    >>> wave.shape, f"{abs(wave.to_numpy()[32, 32]):.2f} 1/m"
    ((64, 64), '10.00 1/m')
    """
    device = _check_wave(grid, wavelength, device)
    if not fits_float64(z) or z == 0:
        raise ValueError(f"The distance z of a point source is finite and not 0, not {z!r} m.")
    if not np.isfinite(source).all():
        raise ValueError(f"The place of a source is finite, (y, x) in metres, not {source!r}.")
    _warn_steep_sphere(grid, z, source, wavelength)
    ones = Field.from_array(np.ones(grid.shape), grid, wavelength=wavelength, device=device)
    return multiply_sphere(ones, z, source, fades=True, out=ones.data)


def gaussian_beam(
    grid: Grid,
    waist: float,
    *,
    wavelength: float,
    device: DeviceLike | None = None,
    z: float = 0.0,
    centre: Pair = (0.0, 0.0),
    direction: Pair = (0.0, 0.0),
) -> Field:
    """Return a paraxial Gaussian beam, q^(-1) exp(-r^2/(w0^2 q)) with q = 1 + i z lam/(pi w0^2).

    Saleh and Teich (2019), eq. 3.1-7, with the carrier exp(ikz) dropped; exact for Fresnel
    propagation. A direction (a_y, a_x) moves the beam by a z and gives it the phase
    exp(ik(a s - a^2 z/2)), s from the centre of the waist.

    Parameters
    ----------
    grid : Grid
        Samples of the plane, shape (ny, nx).
    waist : float
        Radius w0 in metres at which the amplitude of the waist is 1/e.
    wavelength : float
        In metres.
    device : Device or str, optional
        Default ``Device.open()``.
    z : float
        Distance from the waist to the plane in metres; negative before the waist.
    centre : tuple of float
        (y, x) of the waist in metres.
    direction : tuple of float
        Direction cosines (a_y, a_x) of the beam, small.

    Returns
    -------
    Field
        1 at the centre of the waist. Each axis carries q^(-1/2), one of length 1 nothing.

    Raises
    ------
    ValueError
        For a waist or wavelength that is not positive, or z, centre or direction out of range.

    Warns
    -----
    SamplingWarning
        If a/lam + 1/(pi w0), where the spectrum is at 1/e, is beyond the Nyquist frequency.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> rayleigh_range = np.pi * (100e-6) ** 2 / 500e-9  # 63 mm
    >>> beam = clplen.wave.gaussian_beam(grid, 100e-6, wavelength=500e-9, z=rayleigh_range)
    >>> f"{beam.intensity().to_numpy().max():.3f} of the waist's intensity"
    "0.500 of the waist's intensity"
    """
    device = _check_wave(grid, wavelength, device)
    if not (fits_float64(waist) and waist > 0):
        raise ValueError(f"The waist of a beam is positive, in metres, not {waist!r}.")
    units.DIAMETER.check(waist, "The waist of a beam")
    if not (fits_float64(z) and np.isfinite(centre).all()):
        raise ValueError(f"z and centre of a beam are finite, in metres, not {z!r} and {centre!r}.")
    _check_direction(direction)
    spread = tuple(f + 1 / (math.pi * waist) for f in _frequencies(direction, wavelength))
    _warn_beyond_nyquist(grid, (spread[0], spread[1]), "A Gaussian beam")
    q = 1 + 1j * z * wavelength / (math.pi * waist**2)
    ty, tx = (
        np.ones(1, device.complex)
        if len(s) == 1
        else _gaussian(s, waist, q, a, z / wavelength * a, wavelength).astype(device.complex)
        for s, a in zip(offsets(grid, centre), direction, strict=True)
    )
    return _separable(ty, tx, grid, wavelength, device)


def _gaussian(
    s: Vector, waist: float, q: complex, cosine: float, walk: float, wavelength: float
) -> Vector:
    """One axis of a beam; ``walk`` is its displacement in wavelengths."""
    turns = cosine * (s / wavelength - walk / 2)
    turns = turns - np.rint(turns)
    around = (s - walk * wavelength) / waist
    return q**-0.5 * np.exp(2j * math.pi * turns - around**2 / q)


def _separable(ty: Vector, tx: Vector, grid: Grid, wavelength: float, device: Device) -> Field:
    return Field.from_array(np.multiply.outer(ty, tx), grid, wavelength=wavelength, device=device)


def _tilt_tables(
    grid: Grid, direction: Pair, wavelength: float, device: Device
) -> tuple[Vector, Vector]:
    ty, tx = (
        phasor(a * s / wavelength, device.complex)
        for a, s in zip(direction, offsets(grid), strict=True)
    )
    return ty, tx


def _frequencies(direction: Pair, wavelength: float) -> Pair:
    return (abs(direction[0]) / wavelength, abs(direction[1]) / wavelength)


def _check_wave(grid: Grid, wavelength: float, device: DeviceLike | None) -> Device:
    require_grid(grid)
    device = as_device(device)
    if not (fits_float64(wavelength) and wavelength > 0):
        raise ValueError(f"The wavelength is positive, in metres, not {wavelength!r}.")
    units.WAVELENGTH.check(wavelength, "The wavelength")
    nbytes = 2 * grid.shape[0] * grid.shape[1] * device.complex.itemsize
    device.require_memory(nbytes, "This wave")
    return device


def _check_direction(direction: Pair) -> None:
    cosines = float64_array(direction)
    if cosines.shape != (2,) or not np.hypot(*cosines) < 1:
        raise ValueError(
            f"A direction is (y, x) direction cosines with a sum of squares below 1, not "
            f"{direction!r}."
        )


def _warn_beyond_nyquist(grid: Grid, frequencies: Pair, what: str) -> None:
    for name, n, pitch, f in zip("yx", grid.shape, grid.pitch, frequencies, strict=True):
        if n > 1 and exceeds(f, nyquist(pitch)):
            warn_caller(
                f"{what} with {f:.4g} cycles/m along {name} is aliased: samples of {pitch:g} m "
                f"carry up to 1/(2 d) = {nyquist(pitch):.4g}; at most {1 / (2 * f):.4g} m would "
                "do.",
                SamplingWarning,
            )
            return


def _warn_steep_sphere(grid: Grid, z: float, source: Pair, wavelength: float) -> None:
    distances = [np.abs(s) for s in offsets(grid, source)]
    for axis, name in enumerate("yx"):
        if grid.shape[axis] == 1:
            continue
        reach, beside = float(distances[axis].max()), float(distances[1 - axis].min())
        far = sampled_radius(math.hypot(z, beside), grid.pitch[axis], wavelength)
        if not exceeds(reach, far):
            continue
        least = sampled_from(reach, grid.pitch[axis], wavelength)
        warn_caller(
            f"A spherical wave from z = {z:g} m is aliased on samples of {grid.pitch[axis]:g} m "
            f"along {name}: the grid reaches {reach:.4g} m from its axis, the samples carry it up "
            f"to {far:.4g} m; a distance of at least {least:.4g} m would do.",
            SamplingWarning,
        )
        return
