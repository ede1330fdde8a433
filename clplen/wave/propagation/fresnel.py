"""Propagation in the paraxial approximation, separable in x and y."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from clplen.compute.fft.lines import (
    Line,
    Separable,
    chirp_z,
    convolution,
    identity,
    smooth_length,
)
from clplen.errors import SamplingError, argument
from clplen.wave.field.field import Grid, derived_grid
from clplen.wave.field.transmission import phasor
from clplen.wave.propagation.description import (
    Description,
    Request,
    exceeds_energy,
    padded_length,
)

STEP_TOLERANCE = 1e-9  # rounding of the number of steps
LIMIT_STEPS = 10**5  # maximum number of steps
MAX_ABSORBED_STEPS = 32  # measured limit, above which light that the border reflects dominates


def transfer_function(r: Request) -> Description:
    """Describe H = exp(-i pi lam z f^2), sampled up to z_c = W dx/lam (Goodman 2005, eq. 4-20)."""
    lines, critical = [], math.inf
    for axis, n in enumerate(r.grid.shape):
        length, d = padded_length(n, r.pad), r.grid.pitch[axis]
        lines.append(identity(1) if n == 1 else convolution(n, n, paraxial(length, d, r.z, r)))
        if n > 1:
            critical = min(critical, length * d * d / r.wavelength)
    step = abs(r.z) / critical
    warning = ""
    if step > 1 and r.pad != 1:
        warning = (
            f"Fresnel's transfer function at z = {r.z:g} m is aliased above {critical:.4g} m. Use "
            f"{argument('method', 'fresnel-ir')}, or 'auto'."
        )
    return _separable(r, "fresnel-tf", lines, "transfer function", step, (0.0, critical), warning)


def distance_slopes(
    into: Separable, pitch: tuple[float, float], wavelength: float
) -> list[Separable]:
    """Return the terms of the derivative of convolutions with exp(-i pi lam z f^2) by z."""
    terms = []
    for name, d in (("y", pitch[0]), ("x", pitch[1])):
        (line,) = getattr(into, name)
        if line.kind == "convolve":
            terms.append(replace(into, **{name: (_sloped(line, d, wavelength),)}))
    return terms


def _sloped(line: Line, d: float, wavelength: float) -> Line:
    f = np.fft.fftfreq(line.length, d)
    assert line.kernel is not None
    return replace(line, kernel=line.kernel * (-1j * np.pi * wavelength * f**2))


def impulse_response(r: Request) -> Description:
    """Describe h = exp(i pi x^2/(lam z))/sqrt(i lam z), sampled from z_c = W dx/lam on.

    Goodman (2005), eq. 4-16.
    """
    lines, critical = [], 0.0
    for axis, n in enumerate(r.grid.shape):
        length, d = padded_length(n, r.pad), r.grid.pitch[axis]
        if n == 1:
            lines.append(identity(1))
            continue
        x = np.fft.fftfreq(length) * length * d
        h = _constant(r) * d * phasor(x**2 / (2 * r.wavelength * r.z))
        lines.append(convolution(n, n, np.fft.fft(h)))
        critical = max(critical, length * d * d / r.wavelength)
    step, refused = critical / abs(r.z), exceeds_energy(r)
    warning = ""
    if step > 1 and (r.pad != 1 or refused):
        warning = (
            f"Fresnel's impulse response at z = {r.z:g} m is aliased below {critical:.4g} m. Use "
            f"{argument('method', 'fresnel-tf')}, or 'auto'."
        )
    valid = (critical, math.inf)
    description = _separable(r, "fresnel-ir", lines, "kernel", step, valid, warning)
    return replace(description, is_refused=refused)


def one_step(r: Request) -> Description:
    """Describe a single DFT between chirps (Goodman 2005, eq. 4-17), output pitch lam z/(L dx).

    For another grid a chirp-z transform replaces the DFT. A thin ``lens`` in front is combined with
    the first chirp before sampling.
    """
    if r.z == 0:
        raise SamplingError(
            "The output pitch of fresnel-1fft, lam z/(L dx), is 0 at z = 0; use another method."
        )
    lines, pitches, steps, nearest = [], [], [], 0.0
    for axis, n in enumerate(r.grid.shape):
        d = r.grid.pitch[axis]
        length = n if n == 1 else round(r.pad * n)
        pitches.append(d if n == 1 else r.wavelength * abs(r.z) / (length * d))
        if n == 1:
            lines.append(identity(1))
            continue
        lines.append(_fused(r, axis, length) if r.out_grid is None else _onto(r, axis))
        curvature = 1 / r.z - (0 if r.lens is None else 1 / r.lens)
        lit = r.span(axis).lit
        steps.append(lit * d * abs(curvature) / r.wavelength)
        nearest = max(nearest, lit * d / r.wavelength)
    step = max(steps, default=0.0)
    warning = ""
    if step > 1:
        warning = (
            f"The chirp of fresnel-1fft at z = {r.z:g} m is aliased over the lit width (without a "
            f"lens, below {nearest:.4g} m). Use {argument('method', 'auto')}, or set the width of "
            f"the light by {argument('support')}."
        )
    out_grid = derived_grid(r.grid.shape, (pitches[0], pitches[1]), r.grid.origin)
    valid = (nearest, math.inf)
    grid = r.out_grid or out_grid
    description = _separable(r, "fresnel-1fft", lines, "chirp", step, valid, warning, grid)
    refused = bool(warning) and r.out_grid is not None and exceeds_energy(r)
    return replace(description, is_refused=refused)


def many_steps(r: Request) -> Description:
    """Describe single-DFT steps of dz = N dx^2/lam, with constant pitch, and a shorter step by H.

    A cos^2 taper over a fraction ``border`` of half the window absorbs light after each step, which
    would wrap around. Thesis, section 2.3.1; each axis has its own dz.
    """
    reach, count = absorbed_distance(r), steps(r)
    if count > LIMIT_STEPS:
        raise SamplingError(
            f"fresnel-multistep is limited to {LIMIT_STEPS:,} steps, but z = {r.z:g} m requires "
            f"{count:,}; use {argument('method', 'fresnel-ir')}, or 'auto'."
        )
    maps, counts = [], []
    for axis, n in enumerate(r.grid.shape):
        lines = [identity(1)] if n == 1 else _steps(r, axis)
        counts.append(len(lines) - 1)
        maps.append(tuple(lines))
    length = max(lines[0].length for lines in maps)
    warning = ""
    if abs(r.z) >= reach:
        warning = (
            f"fresnel-multistep takes {count} steps to z = {r.z:g} m; from {reach:.4g} m on, light "
            f"that left the window returns. Use {argument('method', 'fresnel-ir')} or 'auto', a "
            "larger pad or a border."
        )
    return Description(
        request=r,
        method="fresnel-multistep",
        into=Separable(maps[0], maps[1]),
        kind="separable",
        route=f"{counts[0]} and {counts[1]} single-FFT steps in y and x, window of {length}",
        sampled="chirp",
        phase_step=1.0 if max(counts) else 0.0,
        valid=(0.0, reach),
        warning=warning,
    )


def steps(r: Request) -> int:
    """Return the number of full steps of fresnel-multistep along the axis with more steps."""
    return max((math.floor(abs(r.z) / dz + STEP_TOLERANCE) for dz in _step_lengths(r)), default=0)


def absorbed_distance(r: Request) -> float:
    """Return the distance in metres at which light that left the window starts to return.

    It is infinite for a periodic window, without padding and border.
    """
    if r.pad == 1 and r.border == 0:
        return math.inf
    limit = MAX_ABSORBED_STEPS if r.border > 0 else 1
    return min(((limit + 1) * dz for dz in _step_lengths(r)), default=math.inf)


def _step_lengths(r: Request) -> list[float]:
    """Return dz = N dx^2/lam of each axis in metres."""
    return [
        even_length(r.grid.shape[a], r.pad) * r.grid.pitch[a] ** 2 / r.wavelength for a in r.axes
    ]


def paraxial(length: int, d: float, z: float, r: Request) -> np.ndarray:
    """Return Fresnel's transfer function at the frequencies of an FFT, complex128, (length,)."""
    f = np.fft.fftfreq(length, d)
    return phasor(-r.wavelength * z * f**2 / 2)


def _steps(r: Request, axis: int) -> list[Line]:
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    length = even_length(n, r.pad)
    dz = length * d * d / r.wavelength
    count = math.floor(abs(r.z) / dz + STEP_TOLERANCE)
    rest = math.copysign(max(0.0, abs(r.z) - count * dz), r.z)
    taper = border_taper(length, r.border)

    def step(samples: int) -> Line:
        offset = length // 2 - samples // 2
        pre, post = (
            phasor(math.copysign(1, r.z) * x**2 / (2 * r.wavelength * dz))
            for x in ((np.arange(m) - m // 2) * d for m in (samples, length))
        )
        post = post * taper * (_constant(r, dz) * d)
        return _dft(samples, length, length, offset, r.z, pre, post)

    lines = [step(n)] if count else []
    if count > 1:
        lines += [step(length)] * (count - 1)
    lines.append(convolution(length if count else n, n, paraxial(length, d, rest, r)))
    return lines


def even_length(n: int, pad: float) -> int:
    """Return the even window of multi-step propagation, without primes above 7 for pad != 1."""
    length = round(pad * n)
    length += length % 2
    while pad != 1 and smooth_length(length) != length:
        length += 2
    return length


def border_taper(length: int, border: float) -> np.ndarray:
    """Return cos^2 from 1 to 0 over the outermost fraction ``border`` of each half window."""
    half = length / 2
    depth = np.abs(np.arange(length) - length // 2) - (1 - border) * half
    if border == 0:
        return np.ones(length)
    return np.cos(np.pi / 2 * np.clip(depth / (border * half), 0, 1)) ** 2


def _fused(r: Request, axis: int, length: int) -> Line:
    """Return the single step of an axis, with the lens in its first chirp."""
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    out = (np.arange(n) - n // 2) * (r.wavelength * abs(r.z) / (length * d))
    post = phasor(out**2 / (2 * r.wavelength * r.z)) * (_constant(r) * d)
    return _dft(n, n, length, 0, r.z, phasor(_curved(r, axis)), post)


def _onto(r: Request, axis: int) -> Line:
    """Return the single step of an axis to any output grid."""
    n, m = r.grid.shape[axis], r.target.shape[axis]
    d, out_d = r.grid.pitch[axis], r.target.pitch[axis]
    offset = r.target.origin[axis] - r.grid.origin[axis]
    x, out = ((np.arange(k) - k // 2) * p for k, p in ((n, d), (m, out_d)))
    turns = 1 / (r.wavelength * r.z)
    pre = phasor(_curved(r, axis)) * phasor(-offset * turns * x)
    post = phasor((offset + out) ** 2 * turns / 2) * (_constant(r) * d)
    return chirp_z(n, m, -d * out_d * turns, pre=pre, post=post)


def _curved(r: Request, axis: int) -> np.ndarray:
    """Return the turns of the first chirp, including the lens."""
    n, d, origin = r.grid.shape[axis], r.grid.pitch[axis], r.grid.origin[axis]
    x = (np.arange(n) - n // 2) * d
    turns = x**2 / r.z if r.lens is None else x**2 / r.z - (x + origin) ** 2 / r.lens
    if r.lens is not None and origin == 0:
        turns = x**2 * (1 / r.z - 1 / r.lens)
    return turns / (2 * r.wavelength)


def _dft(
    n: int, m: int, length: int, offset: int, z: float, pre: np.ndarray, post: np.ndarray
) -> Line:
    """Return post[k] sum_j pre[j] u[j] exp(-+2 pi i (j - n//2)(k - m//2)/length), + for z < 0."""
    sign = math.copysign(1, z)
    j, k = np.arange(n), np.arange(m)
    middle = offset + n // 2
    pre = pre * phasor(sign * ((offset + j) * (m // 2) % length) / length)
    post = post * phasor(sign * (middle * (k - m // 2) % length) / length)
    if z < 0:
        return Line(n, m, length, "inverse", offset=offset, pre=pre, post=post * length)
    return Line(n, m, length, "forward", offset=offset, pre=pre, post=post)


def _constant(r: Request, dz: float | None = None) -> complex:
    """Return 1/sqrt(i lam z), the factor of an axis, or of a step of +-dz."""
    z = r.z if dz is None else math.copysign(dz, r.z)
    return complex(1 / np.sqrt(1j * r.wavelength * z))


def _separable(
    r: Request,
    method: str,
    lines: list[Line],
    sampled: str,
    step: float,
    valid: tuple[float, float],
    warning: str,
    out_grid: Grid | None = None,
) -> Description:
    return Description(
        request=r,
        method=method,
        own_grid=out_grid,
        into=Separable.of(lines),
        kind="separable",
        route=f"each axis by itself, window {lines[0].length} x {lines[1].length}",
        sampled=sampled,
        phase_step=step,
        valid=valid,
        warning=warning,
    )
