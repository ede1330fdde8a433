"""Thin lenses and how finely they must be sampled."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from clplen.compute import lengths
from clplen.wave.elements.apertures import disc
from clplen.wave.field.arguments import Aliasing, act_on_aliasing, check_aliasing, check_diameter
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.phase_tables import phasor
from clplen.wave.field.spherical_phase import multiply_sphere, sampled_from, sampled_radius
from clplen.wave.field.transmission import multiply_separable, offsets

Form = Literal["paraxial", "stigmatic"]


def thin_lens(
    field: Field,
    f: float,
    *,
    diameter: float | None = None,
    form: Form = "paraxial",
    aliasing: Aliasing = "raise",
) -> Field:
    """A thin lens centred on the axis.

    Paraxial: u exp(-i pi r^2/(lam f)), Goodman (2005), eq. 5-10. Stigmatic:
    u exp(-ik sign(f) (sqrt(r^2 + f^2) - abs(f))), which makes a plane wave a sphere about the focus
    without aberration.

    Parameters
    ----------
    field : Field
    f : float
        Focal length in metres, not 0; negative diverges, infinite does nothing.
    diameter : float, optional
        Of its circular, area-weighted aperture in metres; None: unbounded.
    form : {"paraxial", "stigmatic"}
    aliasing : {"raise", "warn", "allow"}
        What to do when neighbouring samples of the phase differ by more than pi, that is beyond
        R_max = lam f/(2 dx), or f q/sqrt(1 - q^2) with q = lam/(2 dx) for the stigmatic form.
        Without a diameter the half window counts.

    Returns
    -------
    Field

    Raises
    ------
    SamplingError
        If the phase is aliased and ``aliasing`` is "raise".
    ValueError
        For f = 0 or NaN, a diameter that is not positive, or another form.

    Warns
    -----
    SamplingWarning
        If the phase is aliased and ``aliasing`` is "warn".

    Notes
    -----
    Along an axis of length 1 there is neither phase nor edge: the lens is cylindrical.
    """
    require_field(field)
    if math.isnan(f) or f == 0:
        raise ValueError(f"The focal length is not 0, in metres; got {f!r}.")
    lengths.WEAK_LENS.check(f, "The focal length")
    check_diameter(diameter)
    half = None if diameter is None else diameter / 2
    check_lens_sampling(field.grid, f, half, field.wavelength, aliasing, form)
    bent = _bend(field, f) if form == "paraxial" or math.isinf(f) else multiply_sphere(field, -f)
    if diameter is None:
        return bent
    return disc(bent, diameter / 2, (0.0, 0.0), out=bent.data)


def check_lens_sampling(
    grid: Grid,
    f: float,
    radius: float | None,
    wavelength: float,
    aliasing: Aliasing,
    form: Form = "paraxial",
) -> None:
    """Act on a lens phase that is sampled too coarsely.

    Neighbouring samples differ by at most pi up to R_max = lam f/(2 dx), or f q/sqrt(1 - q^2) with
    q = lam/(2 dx) for a stigmatic lens.

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
    form : {"paraxial", "stigmatic"}

    Raises
    ------
    SamplingError
        With R, R_max and the focal length that would do.
    ValueError
        If ``aliasing`` or ``form`` is none of the words.
    """
    check_aliasing(aliasing)
    if form not in ("paraxial", "stigmatic"):
        raise ValueError(f"The form of a lens is 'paraxial' or 'stigmatic', not {form!r}.")
    for axis in (0, 1):
        if grid.shape[axis] == 1 or math.isinf(f):
            continue
        reach = float(np.abs((grid.y, grid.x)[axis]).max())
        used = reach if radius is None else min(radius, reach)
        largest, enough, rule = _limits(f, used, grid.pitch[axis], wavelength, form)
        if used <= largest * (1 + 1e-9):
            continue
        message = (
            f"The phase of a lens of f = {f:g} m is aliased on samples of {grid.pitch[axis]:g} m: "
            f"its radius is R = {used:.4g} m, R_max = {rule} = {largest:.4g} m; a focal "
            f"length of at least {enough:.4g} m would do."
        )
        act_on_aliasing(message, aliasing, stacklevel=4)
        return


def _limits(
    f: float, used: float, pitch: float, wavelength: float, form: Form
) -> tuple[float, float, str]:
    """R_max, the focal length that would do for the radius used, and the rule in words."""
    if form == "paraxial":
        largest, enough = wavelength * abs(f) / (2 * pitch), 2 * used * pitch / wavelength
        return largest, enough, "lam f/(2 dx)"
    rule = "f q/sqrt(1 - q^2), q = lam/(2 dx),"
    return sampled_radius(f, pitch, wavelength), sampled_from(used, pitch, wavelength), rule


def _bend(field: Field, f: float) -> Field:
    turns = [-(t**2) / (2 * field.wavelength * f) for t in offsets(field.grid)]
    ty, tx = (phasor(t, field.device.complex) for t in turns)
    return multiply_separable(field, ty, tx)
