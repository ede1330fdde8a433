"""Gratings and axicons."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from clplen import units
from clplen.checks import Aliasing, act_on_aliasing, check_centre, fits_float64
from clplen.errors import SamplingError
from clplen.wave.elements.transparency import apply_transmission
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.sampling import exceeds
from clplen.wave.field.transmission import offsets, phasor

Kind = Literal["binary", "sinusoidal", "phase", "blazed"]
Values = np.ndarray[Any, Any]


def grating(
    field: Field,
    period: float,
    *,
    kind: Kind = "binary",
    orientation: float = 0.0,
    duty: float = 0.5,
    depth: float | None = None,
    offset: float = 0.0,
) -> Field:
    """Multiply a field by a thin grating of straight lines over the whole plane.

    With s = x cos(orientation) + y sin(orientation) - offset and p the period:

    - "binary" (Ronchi for duty 0.5): 1 for abs(s - n p) < duty p/2, else 0; order n has the
      amplitude duty sinc(n duty). Each sample has the exact clear fraction of its cell, at any
      orientation (the projection of a cell along the lines is a trapezoid).
    - "sinusoidal": (1 + m cos(2 pi s/p))/2; orders 1/2, m/4, m/4 (Goodman 2005, section 4.4.3).
    - "phase": exp(i h cos(2 pi s/p)); order n has the amplitude i^n J_n(h) (Goodman 2005,
      section 4.4.4).
    - "blazed": exp(i h frac(s/p)); h = 2 pi sends all light into the order +1, towards +s. A
      cell across a jump averages its two sides by area.

    Smooth parts are sampled at the centre of each cell. Orders beyond the Nyquist frequency of the
    grid are aliased. The transmission is computed in float64 on the host.

    Parameters
    ----------
    field : Field
        Field of any shape (..., ny, nx).
    period : float
        Period in metres along s, at least two samples.
    kind : {"binary", "sinusoidal", "phase", "blazed"}
        Type of the transmission.
    orientation : float
        Direction of s in radians, positive from +x towards +y (y down); 0: vertical lines.
    duty : float
        Clear fraction of a period of a binary grating, above 0 and below 1; otherwise ignored.
    depth : float, optional
        Depth: m in 0..1 for "sinusoidal" (None: 1), h in radians for "phase" (required) and
        "blazed" (None: 2 pi). A binary grating has none.
    offset : float
        Shift along s in metres of a clear bar's centre, a cosine's maximum or a jump.

    Returns
    -------
    Field
        Field behind the grating, with the shape of ``field``.

    Raises
    ------
    SamplingError
        If the period is below two samples along either axis.
    ValueError
        If the kind is unknown, a value out of range, or the grating varies along an axis of
        length 1.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> behind = clplen.wave.grating(wave, 80e-6, kind="sinusoidal")
    >>> orders = np.fft.fft(behind.to_numpy()[32]) / 64
    >>> [f"{abs(orders[n]):.2f}" for n in (-8, 0, 8)]  # amplitudes of the orders -1, 0 and 1
    ['0.25', '0.50', '0.25']
    """
    require_field(field)
    _check(period, kind, orientation, duty, offset)
    strength = _depth(kind, depth)
    position, width = _across(field.grid, period, orientation)
    periods = position - offset / period
    if kind == "binary":
        return apply_transmission(field, _bars(periods, duty, width))
    if kind == "sinusoidal":
        return apply_transmission(field, (1 + strength * np.cos(2 * np.pi * periods)) / 2)
    if kind == "phase":
        turns = strength / (2 * np.pi) * np.cos(2 * np.pi * periods)
        return apply_transmission(field, phasor(turns, field.device.complex))
    return apply_transmission(field, _ramps(periods, strength, width))


def axicon(
    field: Field,
    angle: float,
    *,
    centre: tuple[float, float] = (0.0, 0.0),
    aliasing: Aliasing = "raise",
) -> Field:
    """Multiply a field by a thin axicon: u exp(-i k angle r).

    The element deflects every ray towards the axis by the same small angle (McLeod 1954; thin and
    paraxial). A plane wave of radius R becomes J0(k angle r) up to z = R/angle. The phase is
    computed in float64 on the host. With an axis of length 1 the element is a biprism.

    Parameters
    ----------
    field : Field
        Field of any shape (..., ny, nx).
    angle : float
        Deflection in radians, (n - 1) times the base angle of a glass cone; negative diverges.
    centre : tuple of float
        Centre (y, x) of the cone in metres.
    aliasing : {"raise", "warn", "allow"}
        Action if neighbouring samples of the phase differ by more than pi, for a pitch above lam/(2
        angle).

    Returns
    -------
    Field
        Field behind the axicon, with the shape of ``field``.

    Raises
    ------
    SamplingError
        If the phase is aliased and ``aliasing`` is "raise".
    ValueError
        If the angle or the centre is not finite, or ``aliasing`` is not one of the three values.

    Warns
    -----
    SamplingWarning
        If the phase is aliased and ``aliasing`` is "warn".

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> behind = clplen.wave.axicon(wave, 0.01)
    >>> np.round(np.angle(behind.to_numpy()[32, 33:36], deg=True)).tolist()
    [-72.0, -144.0, 144.0]
    """
    require_field(field)
    if not fits_float64(angle):
        raise ValueError(f"The angle of an axicon must be finite, in radians, got {angle!r}.")
    check_centre(centre, "an axicon")
    pitch = max(
        (d for d, n in zip(field.grid.pitch, field.grid.shape, strict=True) if n > 1), default=0.0
    )
    message = ""
    if exceeds(2 * abs(angle) * pitch, field.wavelength):
        message = (
            f"The phase of an axicon of {angle:g} rad is aliased on samples of {pitch:g} m; use a "
            f"pitch of at most lam/(2 angle) = {field.wavelength / (2 * abs(angle)):.4g} m."
        )
    act_on_aliasing(message, aliasing)
    y, x = offsets(field.grid, centre)
    turns = np.hypot(y[:, None], x) * (-angle / field.wavelength)
    return apply_transmission(field, phasor(turns, field.device.complex))


def half_plane(distance: Values, width: tuple[float, float]) -> Values:
    """Return the fraction of rectangular cells on the lower side of a straight edge.

    Projected along the edge, a cell is a trapezoid, the convolution of two boxes; this is its
    integral.
    """
    narrow, wide = sorted(width)
    away = np.abs(distance)
    corner = np.clip((narrow + wide) / 2 - away, 0, narrow)
    sloped = 1 - corner**2 / max(2 * narrow * wide, np.finfo(float).tiny)
    straight = 0.5 + away / wide
    beyond = np.where(away <= (wide - narrow) / 2, straight, sloped)
    return np.where(distance < 0, 1 - beyond, beyond)


def _check(period: float, kind: str, orientation: float, duty: float, offset: float) -> None:
    if kind not in ("binary", "sinusoidal", "phase", "blazed"):
        raise ValueError(f"kind must be 'binary', 'sinusoidal', 'phase' or 'blazed', got {kind!r}.")
    if not (fits_float64(period) and period > 0):
        raise ValueError(f"The period of a grating must be positive, in metres, got {period!r}.")
    units.PITCH.check(period, "The period of a grating")
    if not fits_float64(orientation):
        raise ValueError(
            f"The orientation of a grating must be finite, in radians, got {orientation!r}."
        )
    if not fits_float64(offset):
        raise ValueError(f"The offset of a grating must be finite, in metres, got {offset!r}.")
    if not 0 < duty < 1:
        raise ValueError(f"The duty of a grating must lie between 0 and 1, got {duty!r}.")


def _depth(kind: str, depth: float | None) -> float:
    """Return the depth of a kind, or its default."""
    if kind == "binary" and depth is not None:
        raise ValueError(f"depth must be None for a binary grating, got {depth!r}.")
    if kind == "phase" and depth is None:
        raise ValueError("A phase grating requires depth= in radians.")
    value = {"sinusoidal": 1.0, "blazed": 2 * np.pi}.get(kind, 0.0) if depth is None else depth
    if not fits_float64(value):
        raise ValueError(f"The depth of a grating must be finite, got {depth!r}.")
    if kind == "sinusoidal" and not 0 <= value <= 1:
        raise ValueError(f"depth of a sinusoidal grating must be from 0 to 1, got {depth!r}.")
    return value


def _across(grid: Grid, period: float, orientation: float) -> tuple[Values, tuple[float, float]]:
    """Return samples along s and the widths of a cell across the lines, in periods."""
    slopes = (math.sin(orientation), math.cos(orientation))
    width = [0.0, 0.0]
    for axis, slope in enumerate(slopes):
        if abs(slope) < 1e-12:
            continue
        if grid.shape[axis] == 1:
            raise ValueError(
                f"A grating of orientation {orientation:g} rad varies along axis {axis}, but the "
                "field has a single sample along it; change the orientation."
            )
        width[axis] = grid.pitch[axis] * abs(slope) / period
        if exceeds(width[axis], 0.5):
            raise SamplingError(
                f"A period must have at least 2 samples, got {1 / width[axis]:.3g} along axis "
                f"{axis}; use a pitch of at most {period / (2 * abs(slope)):.4g} m."
            )
    y, x = (
        c * slope / period if w else 0 * c
        for c, slope, w in zip((grid.y, grid.x), slopes, width, strict=True)
    )
    return y[:, None] + x, (width[0], width[1])


def _bars(periods: Values, duty: float, width: tuple[float, float]) -> Values:
    """Return the clear fraction of each cell, which reaches at most the edges of the next bars."""
    position = periods - np.rint(periods)
    clear = np.zeros(periods.shape)
    for n in (-1, 0, 1):
        clear += half_plane(position - n + duty / 2, width)
        clear -= half_plane(position - n - duty / 2, width)
    return clear


def _ramps(periods: Values, depth: float, width: tuple[float, float]) -> Values:
    """Return exp(i depth frac(periods)), averaged by area in cells across a jump."""
    position = periods - np.floor(periods)
    ramp = np.exp(1j * depth * position)
    below, above = half_plane(-position, width), half_plane(position - 1, width)
    step = np.exp(1j * depth)
    return ramp * (1 + below * (step - 1) + above * (1 / step - 1))
