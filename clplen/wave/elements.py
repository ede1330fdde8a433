"""Optical elements that act in one plane: thin lens, apertures."""

from __future__ import annotations

import math
import warnings
from typing import Literal

import numpy as np
import pyopencl.array as cla

from clplen.errors import SamplingError, SamplingWarning
from clplen.wave.field import Field, Grid
from clplen.wave.phase import phasor

Aliasing = Literal["raise", "warn", "allow"]


def thin_lens(
    field: Field, f: float, *, diameter: float | None = None, aliasing: Aliasing = "raise"
) -> Field:
    """A paraxial thin lens centred on the axis: u exp(-i pi r^2/(lam f)).

    Goodman (2005), eq. 5-10.

    Parameters
    ----------
    field : Field
    f : float
        Focal length in metres, not 0; negative diverges, infinite does nothing.
    diameter : float, optional
        Of its circular, area-weighted aperture in metres; None: unbounded.
    aliasing : {"raise", "warn", "allow"}
        What to do when neighbouring samples of the phase differ by more than pi, that is beyond
        R_max = lam f/(2 dx). Without a diameter the half window counts.

    Returns
    -------
    Field

    Raises
    ------
    SamplingError
        If the phase is aliased and ``aliasing`` is "raise".
    ValueError
        For f = 0 or NaN, or a diameter that is not positive.

    Warns
    -----
    SamplingWarning
        If the phase is aliased and ``aliasing`` is "warn".
    """
    if math.isnan(f) or f == 0:
        raise ValueError(f"The focal length is not 0, in metres; got {f!r}.")
    _check_diameter(diameter)
    half = None if diameter is None else diameter / 2
    check_lens_sampling(field.grid, f, half, field.wavelength, aliasing)
    bent = _bend(field, f)
    if diameter is None:
        return bent
    _disc(bent.data, bent, diameter / 2, (0.0, 0.0), out=bent.data)
    return bent


def aperture(
    field: Field,
    diameter: float,
    *,
    shape: Literal["circular", "square"] = "circular",
    centre: tuple[float, float] = (0.0, 0.0),
) -> Field:
    """An area-weighted hard aperture: a rim sample keeps the fraction of its cell inside.

    Parameters
    ----------
    field : Field
    diameter : float
        Of the circle, or side of the square, in metres.
    shape : {"circular", "square"}
    centre : tuple of float
        (y, x) in metres.

    Returns
    -------
    Field

    Raises
    ------
    ValueError
        For a diameter that is not positive or another shape.
    """
    _check_diameter(diameter)
    if not np.isfinite(centre).all():
        raise ValueError(f"The centre of an aperture is finite, (y, x) in metres, not {centre!r}.")
    if shape == "circular":
        out = field.device.empty(field.shape, field.device.complex)
        return field.with_data(_disc(field.data, field, diameter / 2, centre, out=out))
    if shape != "square":
        raise ValueError(f"An aperture is 'circular' or 'square', not {shape!r}.")
    tables = [
        _overlap(coordinate - middle, pitch, diameter / 2).astype(field.device.complex)
        for coordinate, middle, pitch in zip(
            (field.grid.y, field.grid.x), centre, field.grid.pitch, strict=True
        )
    ]
    return multiply_separable(field, tables[0], tables[1])


def multiply_separable(field: Field, ty: np.ndarray, tx: np.ndarray) -> Field:
    """``field`` times the product of two 1-D complex tables over y and x."""
    device, (ny, nx) = field.device, field.grid.shape
    out = device.empty(field.shape, device.complex)
    kernel = device.kernel("separable.cl", "multiply_separable", **device.wave_defines())
    device.launch_rows(
        kernel,
        field.shape,
        out,
        field.data,
        device.upload(ty),
        device.upload(tx),
        np.int32(ny),
        np.int32(nx),
    )
    return field.with_data(out)


def multiply(field: Field, transmission: cla.Array) -> Field:
    """``field`` (or each of a batch) times a complex transmission of shape (ny, nx)."""
    device, (ny, nx) = field.device, field.grid.shape
    out = device.empty(field.shape, device.complex)
    kernel = device.kernel("multiply.cl", "multiply", **device.wave_defines())
    device.launch_rows(
        kernel, field.shape, out, field.data, transmission, np.int32(ny), np.int32(nx)
    )
    return field.with_data(out)


def check_lens_sampling(
    grid: Grid, f: float, radius: float | None, wavelength: float, aliasing: Aliasing
) -> None:
    """Act on a lens phase that is sampled too coarsely.

    Neighbouring samples differ by at most pi up to R_max = lam f/(2 dx).

    Parameters
    ----------
    grid : Grid
    f : float
        Focal length in metres.
    radius : float or None
        Used radius of the lens in metres; None: the half window.
    wavelength : float
        In metres.
    aliasing : {"raise", "warn", "allow"}

    Raises
    ------
    SamplingError
        With R, R_max and the focal length that would do.
    ValueError
        If ``aliasing`` is none of the three words.
    """
    if aliasing not in ("raise", "warn", "allow"):
        raise ValueError(f"aliasing is 'raise', 'warn' or 'allow', not {aliasing!r}.")
    for axis in (0, 1):
        if grid.shape[axis] == 1 or math.isinf(f):
            continue
        reach = float(np.abs((grid.y, grid.x)[axis]).max())
        used = reach if radius is None else min(radius, reach)
        largest = wavelength * abs(f) / (2 * grid.pitch[axis])
        if used <= largest * (1 + 1e-9):
            continue
        message = (
            f"The phase of a lens of f = {f:g} m is aliased on samples of {grid.pitch[axis]:g} m: "
            f"its radius is R = {used:.4g} m, R_max = lam f/(2 dx) = {largest:.4g} m; a focal "
            f"length of at least {2 * used * grid.pitch[axis] / wavelength:.4g} m would do."
        )
        if aliasing == "raise":
            raise SamplingError(message + " aliasing='warn' or 'allow' goes on all the same.")
        if aliasing == "warn":
            warnings.warn(message, SamplingWarning, stacklevel=3)
            return


def _bend(field: Field, f: float) -> Field:
    turns = [-(c**2) / (2 * field.wavelength * f) for c in (field.grid.y, field.grid.x)]
    return multiply_separable(field, *(phasor(t, field.device.complex) for t in turns))


def _disc(
    data: cla.Array, like: Field, radius: float, centre: tuple[float, float], *, out: cla.Array
) -> cla.Array:
    device, grid = like.device, like.grid
    real = device.real.type
    kernel = device.kernel("aperture.cl", "disc", **device.wave_defines())
    device.launch_rows(
        kernel,
        like.shape,
        out,
        data,
        device.upload((grid.y - centre[0]).astype(device.real)),
        device.upload((grid.x - centre[1]).astype(device.real)),
        real(radius),
        real(grid.pitch[0] / 2),
        real(grid.pitch[1] / 2),
        np.int32(grid.shape[0]),
        np.int32(grid.shape[1]),
    )
    return out


def _overlap(offset: np.ndarray, pitch: float, half: float) -> np.ndarray:
    """Fraction of each cell of width ``pitch`` about ``offset`` that lies within +-half."""
    low = np.maximum(offset - pitch / 2, -half)
    high = np.minimum(offset + pitch / 2, half)
    return np.maximum(high - low, 0) / pitch


def _check_diameter(diameter: float | None) -> None:
    if diameter is not None and not (math.isfinite(diameter) and diameter > 0):
        raise ValueError(f"A diameter is positive, in metres, not {diameter!r}.")
