"""Fields of simple sources in a plane, and the tilt that changes the direction of a field."""

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
        Wavelength in metres.
    device : Device or str, optional
        Default ``Device.open()``.
    direction : tuple of float
        Direction cosines (a_y, a_x), a_y^2 + a_x^2 < 1; ignored along an axis of length 1.

    Returns
    -------
    Field
        Plane wave of amplitude 1, shape (ny, nx).

    Raises
    ------
    ValueError
        If the direction has no propagating wave, or the wavelength is not positive.

    Warns
    -----
    SamplingWarning
        If the spatial frequency a/lam exceeds the Nyquist frequency 1/(2 d) of an axis.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9, direction=(0.0, 0.01))
    >>> np.round(np.angle(wave.to_numpy()[32, 33:36], deg=True)).tolist()  # 0.2 cycles per sample
    [72.0, 144.0, -144.0]
    """
    device = _check_wave(grid, wavelength, device)
    _check_direction(direction)
    _warn_beyond_nyquist(grid, _frequencies(direction, wavelength), "A plane wave")
    ty, tx = _tilt_tables(grid, direction, wavelength, device)
    return _separable(ty, tx, grid, wavelength, device)


def tilt(field: Field, direction: Pair) -> Field:
    """Multiply a field by the phase exp(ik(a_y y + a_x x)) of a thin prism.

    Parameters
    ----------
    field : Field
        Field of any shape (..., ny, nx).
    direction : tuple of float
        Direction cosines (a_y, a_x) to add, a_y^2 + a_x^2 < 1; ignored along an axis of length 1.

    Returns
    -------
    Field
        Tilted field, with the shape of ``field``.

    Raises
    ------
    ValueError
        If the direction has no propagating wave.

    Warns
    -----
    SamplingWarning
        If the added frequency a/lam exceeds the Nyquist frequency of an axis.

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

    r is the distance from the source. The carrier exp(ik abs(z)) is omitted, as in every
    propagation.

    Parameters
    ----------
    grid : Grid
        Samples of the plane, shape (ny, nx).
    z : float
        Distance from the source to the plane in metres, not 0. For a negative z the wave is the
        complex conjugate and converges to a point abs(z) behind the plane.
    wavelength : float
        Wavelength in metres.
    device : Device or str, optional
        Default ``Device.open()``.
    source : tuple of float
        Position (y, x) of the source in metres; on the axis along an axis of length 1.

    Returns
    -------
    Field
        Wave in 1/m, with amplitude 1/abs(z) in the plane next to the source.

    Raises
    ------
    ValueError
        If z is 0 or not finite, the source not finite, or the wavelength not positive.

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
        raise ValueError(f"The distance z of a point source must be finite and not 0, got {z!r} m.")
    if not np.isfinite(source).all():
        raise ValueError(f"The place of a source must be finite, (y, x) in metres, got {source!r}.")
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

    Saleh and Teich (2019), eq. 3.1-7, without the carrier exp(ikz); exact for Fresnel propagation.
    A direction (a_y, a_x) moves the beam by a z and multiplies it by exp(ik(a s - a^2 z/2)), with s
    measured from the centre of the waist.

    Parameters
    ----------
    grid : Grid
        Samples of the plane, shape (ny, nx).
    waist : float
        Radius w0 in metres at which the amplitude of the waist is 1/e.
    wavelength : float
        Wavelength in metres.
    device : Device or str, optional
        Default ``Device.open()``.
    z : float
        Distance from the waist to the plane in metres; negative in front of the waist.
    centre : tuple of float
        Position (y, x) of the waist in metres.
    direction : tuple of float
        Direction cosines (a_y, a_x) of the beam, small.

    Returns
    -------
    Field
        Beam, 1 at the centre of the waist. Each axis has the factor q^(-1/2), an axis of length 1
        none.

    Raises
    ------
    ValueError
        If the waist or wavelength is not positive, or z, centre or direction is out of range.

    Warns
    -----
    SamplingWarning
        If a/lam + 1/(pi w0), the 1/e point of the spectrum, exceeds the Nyquist frequency.

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
        raise ValueError(f"The waist of a beam must be positive, in metres, got {waist!r}.")
    units.DIAMETER.check(waist, "The waist of a beam")
    if not (fits_float64(z) and np.isfinite(centre).all()):
        raise ValueError(
            f"z and centre of a beam must be finite, in metres, got {z!r} and {centre!r}."
        )
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
    """Return a beam along an axis; ``walk`` is its displacement in wavelengths."""
    turns = cosine * (s / wavelength - walk / 2)
    turns = turns - np.rint(turns)
    distance = (s - walk * wavelength) / waist
    return q**-0.5 * np.exp(2j * math.pi * turns - distance**2 / q)


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
        raise ValueError(f"The wavelength must be positive, in metres, got {wavelength!r}.")
    units.WAVELENGTH.check(wavelength, "The wavelength")
    nbytes = 2 * grid.shape[0] * grid.shape[1] * device.complex.itemsize
    device.require_memory(nbytes, "This wave")
    return device


def _check_direction(direction: Pair) -> None:
    cosines = float64_array(direction)
    if cosines.shape != (2,) or not np.hypot(*cosines) < 1:
        raise ValueError(
            f"A direction must be (y, x) direction cosines with a sum of squares below 1, got "
            f"{direction!r}."
        )


def _warn_beyond_nyquist(grid: Grid, frequencies: Pair, what: str) -> None:
    for name, n, pitch, f in zip("yx", grid.shape, grid.pitch, frequencies, strict=True):
        if n > 1 and exceeds(f, nyquist(pitch)):
            warn_caller(
                f"{what} with {f:.4g} cycles/m along {name} is aliased: the Nyquist frequency of "
                f"samples of {pitch:g} m is 1/(2 d) = {nyquist(pitch):.4g} cycles/m; use a pitch "
                f"of at most {1 / (2 * f):.4g} m.",
                SamplingWarning,
            )
            return


def _warn_steep_sphere(grid: Grid, z: float, source: Pair, wavelength: float) -> None:
    distances = [np.abs(s) for s in offsets(grid, source)]
    for axis, name in enumerate("yx"):
        if grid.shape[axis] == 1:
            continue
        reach, across = float(distances[axis].max()), float(distances[1 - axis].min())
        limit = sampled_radius(math.hypot(z, across), grid.pitch[axis], wavelength)
        if not exceeds(reach, limit):
            continue
        min_distance = sampled_from(reach, grid.pitch[axis], wavelength)
        warn_caller(
            f"A spherical wave from z = {z:g} m is aliased on samples of {grid.pitch[axis]:g} m "
            f"along {name}: the grid extends {reach:.4g} m from its axis, the sampling suffices up "
            f"to {limit:.4g} m; use a distance of at least {min_distance:.4g} m.",
            SamplingWarning,
        )
        return
