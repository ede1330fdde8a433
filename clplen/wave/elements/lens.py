"""Thin lenses, and the sampling that lenses and lenslets require."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clplen import units
from clplen.checks import (
    Aliasing,
    act_on_aliasing,
    alias_argument,
    check_aliasing,
    check_diameter,
)
from clplen.wave.elements.hard_apertures import disc
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.field_gradients import (
    check_cotangent,
    log_moments,
    transmission_gradient,
)
from clplen.wave.field.sampling import exceeds, sampled_from, sampled_radius, steepest_slope
from clplen.wave.field.transmission import (
    multiply_separable,
    multiply_sphere,
    offsets,
    phasor,
)

Form = Literal["paraxial", "stigmatic"]


@alias_argument(f="focal_length")
def thin_lens(
    field: Field,
    focal_length: float,
    *,
    diameter: float | None = None,
    form: Form = "paraxial",
    aliasing: Aliasing = "raise",
) -> Field:
    """Multiply a field by the phase of a thin lens centred on the axis.

    The paraxial form is u exp(-i pi r^2/(lam f)) (Goodman 2005, eq. 5-10). The stigmatic form is
    u exp(-ik sign(f) (sqrt(r^2 + f^2) - abs(f))); it turns a plane wave into a sphere about the
    focus, without aberration.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx).
    focal_length : float
        Focal length in metres, not 0; negative diverges, infinite has no effect.
    diameter : float, optional
        Diameter of a circular, area-weighted aperture in metres; None: unbounded.
    form : {"paraxial", "stigmatic"}
        Form of the phase.
    aliasing : {"raise", "warn", "allow"}
        Action if neighbouring samples of the phase differ by more than pi, beyond R_max = lam f/(2
        dx), or f q/sqrt(1 - q^2) with q = lam/(2 dx) for the stigmatic form. Without a diameter the
        half window counts.

    Returns
    -------
    Field
        Field behind the lens, on the same grid.

    Raises
    ------
    SamplingError
        If the phase is aliased and ``aliasing`` is "raise".
    ValueError
        If f is 0 or NaN, the diameter not positive, or the form unknown.

    Warns
    -----
    SamplingWarning
        If the phase is aliased and ``aliasing`` is "warn".

    Notes
    -----
    If the field has length 1 along an axis, the lens is cylindrical.

    Examples
    --------
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> behind = clplen.thin_lens(wave, 0.04, diameter=0.5e-3)
    >>> focus = clplen.propagate(behind, 0.04).intensity().to_numpy()
    >>> f"{focus.max():.0f}"  # (pi D^2/(4 lam f))^2 = 96
    '96'
    """
    require_field(field)
    f = focal_length
    if f != f or f == 0:
        raise ValueError(f"focal_length must not be 0 or NaN, got {f!r}.")
    units.WEAK_LENS.check(f, "The focal length")
    check_diameter(diameter)
    half = None if diameter is None else diameter / 2
    check_lens_sampling(field.grid, f, half, field.wavelength, aliasing, form)
    bent = _bend(field, f) if form == "paraxial" or math.isinf(f) else multiply_sphere(field, -f)
    if diameter is None:
        return bent
    return disc(bent, diameter / 2, (0.0, 0.0), out=bent.data)


def thin_lens_gradient(
    field: Field,
    cotangent: Field,
    focal_length: float,
    *,
    diameter: float | None = None,
    form: Form = "paraxial",
) -> dict[str, float]:
    """Return the gradient of a loss with respect to the focal length of a thin lens.

    With the transmission t = A exp(i p) of `thin_lens`, dL/df = sum Im(conj(u t) g) dp/df. Here
    dp/df = pi r^2/(lam f^2), or k (1 - abs(f)/sqrt(r^2 + f^2)) for the stigmatic form.

    Parameters
    ----------
    field : Field
        Field u in front of the lens, shape (..., ny, nx).
    cotangent : Field
        Gradient g = dL/dRe + i dL/dIm with respect to the field behind the lens, with the shape of
        ``field``.
    focal_length : float
        Focal length in metres, as in `thin_lens`.
    diameter : float, optional
        Diameter of the aperture, as in `thin_lens`.
    form : {"paraxial", "stigmatic"}
        Form of the phase.

    Returns
    -------
    dict of str to float
        Gradient "focal_length", per metre; 0 for a lens of infinite focal length.

    Raises
    ------
    ShapeError
        If the shapes differ.
    ValueError
        If `thin_lens` does not accept the focal length, diameter or form.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.gaussian_beam(grid, 150e-6, wavelength=500e-9)
    >>> target = clplen.thin_lens(wave, 0.05).to_numpy()
    >>> error = clplen.thin_lens(wave, 0.06).to_numpy() - target  # L = sum abs(error)^2/2
    >>> cotangent = clplen.Field.from_array(error, grid, wavelength=500e-9)
    >>> slope = clplen.wave.thin_lens_gradient(wave, cotangent, 0.06)["focal_length"]
    >>> slope > 0  # a shorter focal length lessens the loss
    True
    """
    check_cotangent(field, cotangent)
    cotangent = field.with_data(cotangent.data)
    before = thin_lens(cotangent, -focal_length, diameter=diameter, form=form, aliasing="allow")
    return {"focal_length": focal_length_slope(field, before, focal_length, form)}


def focal_length_slope(field: Field, before: Field, focal_length: float, form: Form) -> float:
    """Return dL/df of a thin lens from the gradients by the field in front of it.

    With conj(t) g = `before`, conj(u t) g of `thin_lens_gradient` equals conj(u) times `before`, so
    that the field u and `before` are read only once.
    """
    f, lam, (y, x) = focal_length, field.wavelength, offsets(field.grid)
    if form == "paraxial" or math.isinf(f):
        second = log_moments(field, before, y, x).imag
        return float(math.pi / (lam * f**2) * (second[2, 0] + second[0, 2]))
    r2 = y[:, None] ** 2 + x**2
    far = np.sqrt(r2 + f**2)
    by_phase = field.device.download(transmission_gradient(field, before)).imag
    steps = 2 * math.pi / lam * r2 / (far * (far + abs(f)))
    return float((by_phase.astype(np.float64) * steps).sum())


def check_lens_sampling(
    grid: Grid,
    f: float,
    radius: float | None,
    wavelength: float,
    aliasing: Aliasing,
    form: Form = "paraxial",
) -> None:
    """Raise or warn if a lens phase is undersampled.

    Neighbouring samples differ by at most pi up to R_max = lam f/(2 dx), or f q/sqrt(1 - q^2) with
    q = lam/(2 dx) for a stigmatic lens.
    """
    check_aliasing(aliasing)
    if form not in ("paraxial", "stigmatic"):
        raise ValueError(f"form must be 'paraxial' or 'stigmatic', got {form!r}.")
    for axis in (0, 1):
        if grid.shape[axis] == 1 or math.isinf(f):
            continue
        reach = float(np.abs((grid.y, grid.x)[axis]).max())
        used = reach if radius is None else min(radius, reach)
        sampling = {"pitch": grid.pitch[axis], "wavelength": wavelength}
        is_paraxial = form == "paraxial"
        largest = sampled_radius(f, **sampling, is_paraxial=is_paraxial)
        if not exceeds(used, largest):
            continue
        min_focal_length = sampled_from(used, **sampling, is_paraxial=is_paraxial)
        max_pitch = wavelength * (abs(f) if is_paraxial else math.hypot(f, used)) / (2 * used)
        rule = "lam f/(2 dx)" if is_paraxial else "f q/sqrt(1 - q^2), q = lam/(2 dx),"
        message = (
            f"The phase of a lens of f = {f:g} m is aliased on samples of {grid.pitch[axis]:g} m: "
            f"its radius is R = {used:.4g} m, R_max = {rule} = {largest:.4g} m; use more "
            f"samples, of at most {max_pitch * (1 - 5e-4):.4g} m, or a focal length of at least "
            f"{min_focal_length:.4g} m."
        )
        act_on_aliasing(message, aliasing)
        return


def _bend(field: Field, f: float) -> Field:
    turns = [-(t**2) / (2 * field.wavelength * f) for t in offsets(field.grid)]
    ty, tx = (phasor(t, field.device.complex) for t in turns)
    return multiply_separable(field, ty, tx)


@dataclass(frozen=True)
class LensSampling:
    """Sampling of a thin paraxial lens: lengths in metres, slopes, and the largest slope."""

    radius: float  # of the used part of the lens
    largest_radius: float  # R_max = lam abs(f)/(2 dx)
    shortest_focal_length: float  # f_min = 2 R dx/lam
    f_number: float
    fastest: float  # smallest f-number that is sampled, dx/lam
    arriving: float  # largest slope of the light in front of the lens
    alone: float  # largest slope of the lens
    behind: float  # largest slope of the light behind the lens
    limit: float  # largest slope that is sampled, lam/(2 dx)

    def is_sampled(self, slope: float) -> bool:
        """Return True if a slope is at most the limit."""
        return not exceeds(slope, self.limit)


def lens_sampling(
    grid: Grid,
    f: float,
    *,
    wavelength: float,
    diameter: float | None = None,
    arriving: float = math.inf,
) -> LensSampling:
    """Return the sampling of a thin lens, along the axis with the worse sampling.

    ``arriving`` is the radius of curvature of the light at the lens in metres: positive for a
    source in front, negative for a focus behind it. Without a diameter the half window counts.
    """
    _check_focal_length(f)
    check_diameter(diameter)
    candidates = []
    for axis, coordinates in enumerate((grid.y, grid.x)):
        reach = float(np.abs(coordinates).max())
        if grid.shape[axis] > 1:
            radius = reach if diameter is None else min(diameter / 2, reach)
            candidates.append((radius * grid.pitch[axis], radius, grid.pitch[axis]))
    _, radius, pitch = max(candidates, default=(0.0, 0.0, max(grid.pitch)))
    return LensSampling(
        radius=radius,
        largest_radius=sampled_radius(f, pitch, wavelength, is_paraxial=True),
        shortest_focal_length=sampled_from(radius, pitch, wavelength, is_paraxial=True),
        f_number=abs(f) / (2 * radius) if radius else math.inf,
        fastest=pitch / wavelength,
        arriving=radius / abs(arriving),
        alone=radius / abs(f),
        behind=radius * abs(1 / arriving - 1 / f),
        limit=steepest_slope(pitch, wavelength),
    )


def _check_focal_length(f: float) -> None:
    if not abs(f) > 0:
        raise ValueError(f"The focal length must be a number of metres other than 0, got {f!r}.")


@dataclass(frozen=True)
class LensletSampling:
    """Sampling of lenslets in the light of a lens, by the slopes of both."""

    lenslet: float  # slope d/(2 f_mu) of a lenslet
    lens: float  # slope D/(2 z) of the incident light
    limit: float  # largest slope that is sampled, lam/(2 dx)
    shortest_focal_length: float  # smallest sampled f_mu in metres; infinite if there is none

    @property
    def is_sampled(self) -> bool:
        """True if d/(2 f_mu) + D/(2 z) <= lam/(2 dx)."""
        return not exceeds(self.lenslet + self.lens, self.limit)


def lenslet_sampling(
    pitch: float,
    f: float,
    *,
    samples: float,
    wavelength: float,
    diameter: float = 0.0,
    z: float = math.inf,
) -> LensletSampling:
    """Return the sampling of lenslets in a plane wave, or ``z`` behind a lens of a diameter."""
    _check_focal_length(f)
    limit, lens = steepest_slope(samples, wavelength), diameter / (2 * abs(z))
    margin = limit - lens
    shortest = pitch / (2 * margin) if margin > 0 else math.inf
    return LensletSampling(pitch / (2 * abs(f)), lens, limit, shortest)
