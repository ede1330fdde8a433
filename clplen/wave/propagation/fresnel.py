"""Propagations in the paraxial approximation: separable, each axis by itself."""

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
    outshines,
    padded_length,
)

WHOLE = 1e-9  # of a step: rounding that makes no further one
LIMIT_STEPS = 10**5
MOST_STEPS = 32  # that a border was seen to absorb; later what it lets back outshines the field


def transfer_function(r: Request) -> Description:
    """H = exp(-i pi lam z f^2), sampled up to z_c = W dx/lam (Goodman 2005, eq. 4-20)."""
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
            f"Fresnel's transfer function at z = {r.z:g} m is aliased: it is sampled up to "
            f"{critical:.4g} m. Use {argument('method', 'fresnel-ir')}, or 'auto'."
        )
    return _separable(r, "fresnel-tf", lines, "transfer function", step, (0.0, critical), warning)


def distance_slopes(
    into: Separable, pitch: tuple[float, float], wavelength: float
) -> list[Separable]:
    """The terms whose sum is the derivative of convolutions with exp(-i pi lam z f^2) by z."""
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
    """h = exp(i pi x^2/(lam z))/sqrt(i lam z), sampled from z_c = W dx/lam on.

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
    step, refused = critical / abs(r.z), outshines(r)
    warning = ""
    if step > 1 and (r.pad != 1 or refused):
        warning = (
            f"Fresnel's impulse response at z = {r.z:g} m is aliased: it is sampled from "
            f"{critical:.4g} m on. Use {argument('method', 'fresnel-tf')}, or 'auto'."
        )
    made = _separable(r, "fresnel-ir", lines, "kernel", step, (critical, math.inf), warning)
    return replace(made, is_refused=refused)


def one_step(r: Request) -> Description:
    """A single DFT between chirps (Goodman 2005, eq. 4-17); the output pitch is lam z/(L dx).

    Onto another grid a chirp-z transform takes the DFT's place. A thin lens right before, ``lens``,
    is joined to the first chirp before it is sampled.
    """
    if r.z == 0:
        raise SamplingError(
            "The output pitch of fresnel-1fft, lam z/(L dx), would be 0 at z = 0: use another "
            "method."
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
            f"The chirp of fresnel-1fft at z = {r.z:g} m is aliased over the lit width: without a "
            f"lens it is sampled from {nearest:.4g} m on. Use {argument('method', 'auto')}, or "
            f"name the width that carries light by {argument('support')}."
        )
    out_grid = derived_grid(r.grid.shape, (pitches[0], pitches[1]), r.grid.origin)
    valid = (nearest, math.inf)
    made = r.out_grid or out_grid
    described = _separable(r, "fresnel-1fft", lines, "chirp", step, valid, warning, made)
    refused = bool(warning) and r.out_grid is not None and outshines(r)
    return replace(described, is_refused=refused)


def many_steps(r: Request) -> Description:
    """Single-DFT steps of dz = N dx^2/lam, which keep the pitch, then a shorter one by H.

    After each step a cos^2 taper over a fraction ``border`` of half the window absorbs what would
    wrap around. Thesis, section 2.3.1; each axis has its own dz.
    """
    reach, count = absorbed_distance(r), steps(r)
    if count > LIMIT_STEPS:
        raise SamplingError(
            f"fresnel-multistep would take {count:,} steps to z = {r.z:g} m, at most "
            f"{LIMIT_STEPS:,} are done: use {argument('method', 'fresnel-ir')}, or 'auto'."
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
            f"{count} steps to z = {r.z:g} m: from {reach:.4g} m on light that left the window "
            f"comes back in fresnel-multistep. Use {argument('method', 'fresnel-ir')} or 'auto', a "
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
    """Whole steps of fresnel-multistep along the axis that needs more."""
    return max((math.floor(abs(r.z) / dz + WHOLE) for dz in _step_lengths(r)), default=0)


def absorbed_distance(r: Request) -> float:
    """Distance in metres from which light that left the window comes back in fresnel-multistep.

    Without padding and border it is wanted there: the window is periodic.
    """
    if r.pad == 1 and r.border == 0:
        return math.inf
    most = MOST_STEPS if r.border > 0 else 1
    return min(((most + 1) * dz for dz in _step_lengths(r)), default=math.inf)


def _step_lengths(r: Request) -> list[float]:
    """dz = N dx^2/lam of each axis, in metres."""
    return [
        even_length(r.grid.shape[a], r.pad) * r.grid.pitch[a] ** 2 / r.wavelength for a in r.axes
    ]


def paraxial(length: int, d: float, z: float, r: Request) -> np.ndarray:
    """Fresnel's transfer function on the frequencies of an FFT, complex128, shape (length,)."""
    f = np.fft.fftfreq(length, d)
    return phasor(-r.wavelength * z * f**2 / 2)


def _steps(r: Request, axis: int) -> list[Line]:
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    length = even_length(n, r.pad)
    dz = length * d * d / r.wavelength
    count = math.floor(abs(r.z) / dz + WHOLE)
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
    """Window of a multi-step propagation: even, for pad other than 1 without primes above 7."""
    length = round(pad * n)
    length += length % 2
    while pad != 1 and smooth_length(length) != length:
        length += 2
    return length


def border_taper(length: int, border: float) -> np.ndarray:
    """cos^2 from 1 to 0 over the outermost fraction ``border`` of each half window."""
    half = length / 2
    depth = np.abs(np.arange(length) - length // 2) - (1 - border) * half
    if border == 0:
        return np.ones(length)
    return np.cos(np.pi / 2 * np.clip(depth / (border * half), 0, 1)) ** 2


def _fused(r: Request, axis: int, length: int) -> Line:
    """The one step of an axis, with the lens in its first chirp."""
    n, d = r.grid.shape[axis], r.grid.pitch[axis]
    out = (np.arange(n) - n // 2) * (r.wavelength * abs(r.z) / (length * d))
    post = phasor(out**2 / (2 * r.wavelength * r.z)) * (_constant(r) * d)
    return _dft(n, n, length, 0, r.z, phasor(_curved(r, axis)), post)


def _onto(r: Request, axis: int) -> Line:
    """The one step of an axis onto any output grid."""
    n, m = r.grid.shape[axis], r.target.shape[axis]
    d, out_d = r.grid.pitch[axis], r.target.pitch[axis]
    offset = r.target.origin[axis] - r.grid.origin[axis]
    x, out = ((np.arange(k) - k // 2) * p for k, p in ((n, d), (m, out_d)))
    turns = 1 / (r.wavelength * r.z)
    pre = phasor(_curved(r, axis)) * phasor(-offset * turns * x)
    post = phasor((offset + out) ** 2 * turns / 2) * (_constant(r) * d)
    return chirp_z(n, m, -d * out_d * turns, pre=pre, post=post)


def _curved(r: Request, axis: int) -> np.ndarray:
    """Turns of the first chirp, with the lens in it."""
    n, d, origin = r.grid.shape[axis], r.grid.pitch[axis], r.grid.origin[axis]
    x = (np.arange(n) - n // 2) * d
    turns = x**2 / r.z if r.lens is None else x**2 / r.z - (x + origin) ** 2 / r.lens
    if r.lens is not None and origin == 0:
        turns = x**2 * (1 / r.z - 1 / r.lens)
    return turns / (2 * r.wavelength)


def _dft(
    n: int, m: int, length: int, offset: int, z: float, pre: np.ndarray, post: np.ndarray
) -> Line:
    """post[k] sum_j pre[j] u[j] exp(-+2 pi i (j - n//2)(k - m//2)/length), + for z < 0."""
    sign = math.copysign(1, z)
    j, k = np.arange(n), np.arange(m)
    middle = offset + n // 2
    pre = pre * phasor(sign * ((offset + j) * (m // 2) % length) / length)
    post = post * phasor(sign * (middle * (k - m // 2) % length) / length)
    if z < 0:
        return Line(n, m, length, "inverse", offset=offset, pre=pre, post=post * length)
    return Line(n, m, length, "forward", offset=offset, pre=pre, post=post)


def _constant(r: Request, dz: float | None = None) -> complex:
    """1/sqrt(i lam z), the factor of one axis; of a step of +-dz where one is given."""
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
