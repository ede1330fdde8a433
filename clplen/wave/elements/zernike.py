"""Zernike polynomials, and phase plates composed of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from clplen import units
from clplen.checks import (
    Aliasing,
    act_on_aliasing,
    check_centre,
    check_finite,
    fits_float64,
    float64_array,
    is_finite,
    is_integer,
    real_array,
)
from clplen.wave.elements.transparency import apply_transmission
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.sampling import exceeds
from clplen.wave.field.transmission import offsets, phasor

Values = np.ndarray[Any, Any]
MAX_RADIAL_ORDER = 500  # coefficients of higher orders overflow float64


def zernike(n: int, m: int, rho: Any, theta: Any) -> Values:
    """Return a Zernike polynomial of unit rms over the unit disc.

    Noll (1976), eq. 1 and 2: sqrt(n+1) R_n^0(rho) for m = 0, sqrt(2(n+1)) R_n^m(rho) cos(m theta)
    for m > 0 and sqrt(2(n+1)) R_n^abs(m)(rho) sin(abs(m) theta) for m < 0. The radial part is the
    Jacobi polynomial R_n^m(rho) = rho^m P_k^(0,m)(2 rho^2 - 1), k = (n-m)/2 (Born & Wolf, 9.2.1),
    evaluated by recurrence, with an error of R of at most 1e-14 up to n = 40.

    Parameters
    ----------
    n : int
        Radial order, 0 to 500.
    m : int
        Azimuthal order: abs(m) <= n, n - m even; positive for cos, negative for sin.
    rho : array_like
        Distance from the centre as a fraction of the radius. The polynomial continues beyond 1.
    theta : array_like
        Angle in radians, from +x towards +y (y down).

    Returns
    -------
    numpy.ndarray
        Values, float64, with the broadcast shape of ``rho`` and ``theta``.

    Raises
    ------
    ValueError
        If the orders do not exist.

    Examples
    --------
    >>> rho = np.array([0.0, 0.5, 1.0])
    >>> np.round(clplen.wave.zernike(2, 0, rho, 0.0), 3).tolist()  # defocus
    [-1.732, -0.866, 1.732]
    """
    if not (is_integer(n) and is_integer(m)) or not abs(m) <= n <= MAX_RADIAL_ORDER or (n - m) % 2:
        raise ValueError(
            "Zernike orders must be integers n >= abs(m) with n - m even and n up to "
            f"{MAX_RADIAL_ORDER}, got n = {n!r}, m = {m!r}."
        )
    order = abs(int(m))
    r, angle = real_array(rho, "rho", np.float64), real_array(theta, "theta", np.float64)
    from scipy.special import eval_jacobi

    radial = r**order * eval_jacobi((int(n) - order) // 2, 0, order, 2 * r * r - 1)
    if m == 0:
        return math.sqrt(n + 1) * radial * np.ones_like(angle)
    angular = np.cos(order * angle) if m > 0 else np.sin(order * angle)
    return math.sqrt(2 * (n + 1)) * radial * angular


def zernike_gradient(n: int, m: int, y: Any, x: Any) -> tuple[Values, Values]:
    """Return the slopes (d/dy, d/dx) of a Zernike polynomial, in units of its rms over the radius.

    R = rho^m P(2 rho^2 - 1), P = P_k^(0,m), has R' = m R/rho + 4 rho^(m+1) P'(2 rho^2 - 1), with P'
    = (k + m + 1)/2 P_(k-1)^(1,m+1) (DLMF 18.9.15). The slopes along rho and theta are rotated to x
    and y.
    """
    zernike(n, m, 0.0, 0.0)
    y, x = np.broadcast_arrays(float64_array(y), float64_array(x))
    from scipy.special import eval_jacobi

    order = abs(int(m))
    k, rho, theta = (int(n) - order) // 2, np.hypot(y, x), np.arctan2(y, x)
    t = 2 * rho**2 - 1
    steep = (k + order + 1) / 2 * eval_jacobi(k - 1, 1, order + 1, t) if k else 0.0
    if m == 0:
        outward = math.sqrt(n + 1) * 4 * rho * steep * np.ones_like(theta)
        return outward * np.sin(theta), outward * np.cos(theta)
    over_rho = rho ** (order - 1) * eval_jacobi(k, 0, order, t)
    outward = order * over_rho + 4 * rho ** (order + 1) * steep
    cos, sin = np.cos(order * theta), np.sin(order * theta)
    along, around = (cos, -sin) if m > 0 else (sin, cos)
    outward, around = outward * along, order * over_rho * around
    norm = math.sqrt(2 * (n + 1))
    down = outward * np.sin(theta) + around * np.cos(theta)
    right = outward * np.cos(theta) - around * np.sin(theta)
    return norm * down, norm * right


def zernike_monomials(n: int, m: int) -> Values:
    """Return coefficients c[i, k] of a Zernike polynomial as a sum of y^i x^k, in radii.

    R_n^m follows Noll (1976), eq. 2, with rho^2s = (x^2 + y^2)^s. rho^m cos(m theta) and
    rho^m sin(m theta) are the real and the imaginary part of (x + iy)^m.
    """
    zernike(n, m, 0.0, 0.0)
    n, order = int(n), abs(int(m))
    coefficients = np.zeros((n + 1, n + 1))
    for j in range(order + 1):  # (x + iy)^m: binomial (m, j) x^(m - j) (iy)^j
        part = 1j**j * math.comb(order, j)
        angular = part.imag if m < 0 else part.real
        for s in range((n - order) // 2 + 1):
            half = (n - order) // 2 - s  # power of y^2 and x^2 in (x^2 + y^2)^half
            radial = (-1) ** s * math.comb(n - s, s) * math.comb(n - 2 * s, half)
            for i in range(half + 1):
                coefficients[j + 2 * i, order - j + 2 * (half - i)] += (
                    angular * radial * math.comb(half, i)
                )
    return coefficients * math.sqrt((n + 1) * (1 if m == 0 else 2))


def noll(j: int) -> tuple[int, int]:
    """Return the orders (n, m) of Noll's single index.

    In Noll (1976), table I, n ascends, then abs(m); even j is a cosine (m > 0), odd j a sine
    (m < 0): 1 piston, 2 and 3 tilt in x and y, 4 defocus, 5 and 6 astigmatism, 7 and 8 coma in y
    and x, 9 and 10 trefoil, 11 spherical aberration.

    Parameters
    ----------
    j : int
        Index, at least 1.

    Returns
    -------
    tuple of int
        Radial and azimuthal order (n, m) of `zernike`.

    Raises
    ------
    ValueError
        If j is not an integer in this range.

    Examples
    --------
    >>> clplen.wave.noll(4)  # defocus
    (2, 0)
    >>> [clplen.wave.noll(j) for j in (5, 6, 11)]
    [(2, -2), (2, 2), (4, 0)]
    """
    if not is_integer(j) or j < 1:
        raise ValueError(f"Noll's index must be an integer of at least 1, got {j!r}.")
    j = int(j)
    n = (math.isqrt(8 * j - 7) - 1) // 2
    rank = j - n * (n + 1) // 2 - 1
    m = 2 * ((rank + 1) // 2) if n % 2 == 0 else 2 * (rank // 2) + 1
    return n, m if j % 2 == 0 else -m


def osa(j: int) -> tuple[int, int]:
    """Return the orders (n, m) of the OSA standard index j = (n (n + 2) + m)/2.

    ANSI Z80.28 (2004); Thibos et al. (2002): n ascends, then m from -n (sine) to n (cosine).
    0 piston, 1 and 2 tilt in y and x, 3 and 5 astigmatism, 4 defocus, 6 and 9 trefoil, 7 and 8
    coma in y and x, 12 spherical aberration.

    Parameters
    ----------
    j : int
        Index, at least 0.

    Returns
    -------
    tuple of int
        Radial and azimuthal order (n, m) of `zernike`.

    Raises
    ------
    ValueError
        If j is not an integer in this range.

    Examples
    --------
    >>> clplen.wave.osa(4)  # defocus
    (2, 0)
    >>> [clplen.wave.osa(j) for j in (3, 5, 12)]
    [(2, -2), (2, 2), (4, 0)]
    """
    if not is_integer(j) or j < 0:
        raise ValueError(f"The OSA index must be an integer of at least 0, got {j!r}.")
    j = int(j)
    n = (math.isqrt(8 * j + 1) - 1) // 2
    return n, 2 * j - n * (n + 2)


def phase_plate(
    field: Field,
    coefficients: Mapping[int, float],
    *,
    diameter: float,
    indexing: Literal["noll", "osa"] = "noll",
    centre: tuple[float, float] = (0.0, 0.0),
    aliasing: Aliasing = "raise",
) -> Field:
    """Multiply a field by the phase of a plate of Zernike polynomials.

    The result is u exp(+i 2 pi W/lam) on a disc and u outside. The path length W = sum_j c_j Z_j
    does not depend on the wavelength. The plate blocks no light; combine it with `aperture`. If
    the cell of a sample only overlaps the disc, the sample gets the phase of the nearest point of
    the rim, as the light in an area-weighted aperture has. If the field has length 1 along an
    axis, the plate is its section through the centre. The host computes it in float64.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx).
    coefficients : mapping of int to float
        Coefficients: index j to metres of optical path, rms over the disc; positive retards as
        exp(+ikz) does.
    diameter : float
        Diameter of the disc in metres.
    indexing : {"noll", "osa"}
        Meaning of j: see `noll` and `osa`.
    centre : tuple of float
        Centre (y, x) in metres.
    aliasing : {"raise", "warn", "allow"}
        Action if neighbouring samples of the phase in the disc differ by more than pi.

    Returns
    -------
    Field
        Field behind the plate, on the same grid.

    Raises
    ------
    SamplingError
        If the phase is aliased and ``aliasing`` is "raise".
    TypeError
        If ``coefficients`` is not a mapping.
    ValueError
        If an index does not exist, a coefficient or the centre is not finite, the diameter is not
        positive, or ``indexing`` or ``aliasing`` is unknown.

    Warns
    -----
    SamplingWarning
        If the phase is aliased and ``aliasing`` is "warn".

    Examples
    --------
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> plate = clplen.phase_plate(wave, {4: 50e-9}, diameter=0.4e-3)  # defocus, 0.1 waves rms
    >>> f"{np.angle(plate.to_numpy()[32, 32]):.3f}"  # -sqrt(3) 0.1 waves in the middle
    '-1.088'
    """
    require_field(field)
    terms = plate_terms(coefficients, indexing)
    if not (fits_float64(diameter) and diameter > 0):
        raise ValueError(f"The diameter of a plate must be positive, in metres, got {diameter!r}.")
    units.DIAMETER.check(diameter, "The diameter of a plate")
    check_centre(centre, "a plate")
    path, on_plate = wavefront(field.grid, terms, diameter=diameter, centre=centre)
    turns = path / field.wavelength
    act_on_aliasing(_aliased(turns, on_plate, field.grid), aliasing)
    return apply_transmission(field, phasor(turns, field.device.complex))


def wavefront(
    grid: Grid,
    terms: Mapping[tuple[int, int], float],
    *,
    diameter: float,
    centre: tuple[float, float] = (0.0, 0.0),
) -> tuple[Values, Values]:
    """Return the path length of a plate, and a mask of the cells that overlap its disc.

    `phase_plate` applies this wavefront to a field.

    Parameters
    ----------
    grid : Grid
        Samples of the plane, shape (ny, nx).
    terms : mapping of (int, int) to float
        Terms: orders (n, m) to metres, rms over the disc.
    diameter : float
        Diameter of the disc in metres.
    centre : tuple of float
        Centre (y, x) in metres.

    Returns
    -------
    tuple of numpy.ndarray
        Path length in metres, float64, 0 outside of the disc, and a bool mask of the cells that
        overlap the disc. Both have shape (ny, nx).

    Raises
    ------
    ValueError
        If the orders do not exist.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> terms = {clplen.wave.noll(4): 50e-9}  # defocus of 50 nm rms
    >>> path, inside = clplen.wave.wavefront(grid, terms, diameter=400e-6)
    >>> path.shape, f"{path.min() * 1e9:.0f} to {path.max() * 1e9:.0f} nm"
    ((64, 64), '-87 to 87 nm')
    """
    if not (is_finite(diameter) and diameter > 0):
        raise ValueError(f"A diameter must be a positive number of metres, got {diameter!r}.")
    on_plate, rho, theta = plate_coordinates(grid, diameter, centre)
    path = np.zeros(grid.shape)
    for (n, m), metres in terms.items():
        check_finite(path=metres)
        path[on_plate] += metres * zernike(n, m, rho, theta)
    return path, on_plate


def plate_coordinates(
    grid: Grid, diameter: float, centre: tuple[float, float]
) -> tuple[Values, Values, Values]:
    """Return a mask of the cells that overlap a plate's disc, and their (rho, theta)."""
    y, x = offsets(grid, centre)
    on_plate = _cells_of_disc(grid, y, x, diameter / 2)
    rows, columns = np.nonzero(on_plate)
    rho = np.minimum(np.hypot(y[rows], x[columns]) / (diameter / 2), 1)
    return on_plate, rho, np.arctan2(y[rows], x[columns])


def plate_terms(
    coefficients: Mapping[int, float], indexing: Literal["noll", "osa"]
) -> dict[tuple[int, int], float]:
    """Return {orders (n, m): metres} of coefficients {index: metres}."""
    if indexing not in ("noll", "osa"):
        raise ValueError(f"indexing must be 'noll' or 'osa', got {indexing!r}.")
    if not isinstance(coefficients, Mapping):
        raise TypeError(f"The coefficients must be {{index: metres}}, got {coefficients!r}.")
    for j, metres in coefficients.items():
        if not fits_float64(metres):
            raise ValueError(
                f"Coefficient {j!r} of the plate must be finite, in metres, got {metres!r}."
            )
        units.WAVEFRONT.check(metres, f"Coefficient {j!r} of the plate")
    orders = noll if indexing == "noll" else osa
    return {orders(j): float(metres) for j, metres in coefficients.items()}


def _cells_of_disc(grid: Grid, y: Values, x: Values, radius: float) -> Values:
    """Return a mask of cells that overlap a disc about the origin of ``y`` and ``x``."""
    nearest = [
        np.maximum(np.abs(c) - (pitch / 2 if c.size > 1 else 0), 0)
        for c, pitch in zip((y, x), grid.pitch, strict=True)
    ]
    return nearest[0][:, None] ** 2 + nearest[1] ** 2 < radius**2


def _aliased(turns: Values, on_plate: Values, grid: Grid) -> str:
    """Return the message about phase steps above half a turn on the plate, or an empty string."""
    pairs = (on_plate[1:] & on_plate[:-1], on_plate[:, 1:] & on_plate[:, :-1])
    steps = [
        float(np.abs(np.diff(turns, axis=axis)).max(where=pair, initial=0))
        for axis, pair in enumerate(pairs)
    ]
    axis = int(np.argmax(steps))
    if not exceeds(steps[axis], 0.5):
        return ""
    return (
        f"The phase of the plate is aliased: it steps by {2 * np.pi * steps[axis]:.4g} rad, more "
        f"than pi, between neighbouring samples {grid.pitch[axis]:g} m apart; use a pitch of at "
        f"most {grid.pitch[axis] / (2 * steps[axis]):.4g} m."
    )
