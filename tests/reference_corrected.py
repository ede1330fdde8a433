"""float64 twin of the corrected band-limited angular spectrum, by explicit matrix DFT.

The band that geometry can deliver to the output window, widened by a tapered guard of a few
Fresnel widths, sampled finely enough that the aliases miss the window (thesis, 2.4.3; the band
limit of Matsushima & Shimobaba 2009 made soft and sized to the geometry). Conventions as in
reference_optics; nothing here imports the package under test.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from reference_optics import Complex, Pair, Real, axis, pair
from scipy.special import erfc


class AxisPlan(NamedTuple):
    """Band [f_lo, f_hi] (1/m), window W (m) and number of frequencies of one axis."""

    f_lo: float
    f_hi: float
    window: float
    count: int


class Guard(NamedTuple):
    """Guard width in Fresnel widths, steepness of its taper, margin of the window."""

    width: float
    steepness: float
    window: float


class AxisGeometry(NamedTuple):
    """Samples and distances of one axis; w_in and w_out are widths, x0 the output's centre."""

    n: int
    pitch: float
    w_in: float
    w_out: float
    x0: float
    z: float
    wavelength: float


def corrected(
    u: Complex,
    pitch: Pair,
    z: float,
    *,
    wavelength: float,
    guard: float = 6.0,
    steepness: float = 4.0,
    window_guard: float = 3.0,
    support: Pair | None = None,
    out_shape: Sequence[int] | None = None,
    out_pitch: Pair | None = None,
    out_centre: Pair = (0.0, 0.0),
) -> Complex:
    """Propagate u (ny, nx) by z to any grid: U = A u dx, out = B (U weight H) df on each axis.

    support: width (m) that holds the input, centred; default the whole window. guard=0: hard
    edge. An axis of length 1 has frequency 0 only.
    """
    out_shape = u.shape if out_shape is None else tuple(out_shape)
    out_pitch = pair(pitch if out_pitch is None else out_pitch)
    if z == 0 and (out_shape, out_pitch, pair(out_centre)) == (u.shape, pair(pitch), (0.0, 0.0)):
        return np.array(u, dtype=np.complex128)
    if z == 0:
        raise ValueError("z = 0 keeps the grid: leave out_shape, out_pitch and out_centre out")
    guards = Guard(guard, steepness, window_guard)
    axes = geometry(u.shape, pitch, z, wavelength, support, out_shape, out_pitch, out_centre)
    (fy, wy), (fx, wx) = (frequencies(a, guards) for a in axes)
    ay, by = dft_pair(fy, axes[0], out_shape[0], out_pitch[0])
    ax, bx = dft_pair(fx, axes[1], out_shape[1], out_pitch[1])
    spectrum = ay @ u @ ax.T
    spectrum *= wy[:, None] * wx * helmholtz(fy[:, None], fx[None, :], z, wavelength)
    return by @ spectrum @ bx.T


def geometry(
    shape: Sequence[int],
    pitch: Pair,
    z: float,
    wavelength: float,
    support: Pair | None,
    out_shape: Sequence[int],
    out_pitch: Pair,
    out_centre: Pair,
) -> list[AxisGeometry]:
    """The two axes; without a support w_in is the window N dx."""
    d_in, d_out, centre = pair(pitch), pair(out_pitch), pair(out_centre)
    window = [n * d for n, d in zip(shape, d_in, strict=True)]
    w_in = window if support is None else pair(support)
    w_out = [n * d for n, d in zip(out_shape, d_out, strict=True)]
    return [
        AxisGeometry(shape[i], d_in[i], w_in[i], w_out[i], centre[i], z, wavelength)
        for i in range(2)
    ]


def displacements(a: AxisGeometry) -> tuple[float, float]:
    """Displacements the band must deliver, for z > 0; z < 0 is the mirrored problem."""
    half = (a.w_in + a.w_out) / 2
    centre = a.x0 if a.z > 0 else -a.x0
    return centre - half, centre + half


def plan_axis(a: AxisGeometry, g: Guard) -> AxisPlan:
    """Band, window and number of frequencies of one axis."""
    if a.n == 1:
        return AxisPlan(0.0, 0.0, a.pitch, 1)
    z, lam, nyquist = abs(a.z), a.wavelength, 0.5 / a.pitch
    x_min, x_max = displacements(a)
    f_lo = max(geometric(x_min, a) - g.width * fresnel_width(x_min, a), -nyquist)
    f_hi = min(geometric(x_max, a) + g.width * fresnel_width(x_max, a), nyquist)
    margin = float(np.sqrt(lam * z))
    reach = max(x_max - landing(f_lo, a), landing(f_hi, a) - x_min) + g.window * margin
    widths = a.w_in + a.w_out
    cap = 4 * (widths + abs(a.x0)) + 2 * (g.width + g.window) * margin
    length = int(np.ceil(min(max(reach, widths), cap) / a.pitch * (1 - 1e-12)))
    window = length * a.pitch
    return AxisPlan(f_lo, f_hi, window, len(lattice(f_lo, f_hi, window)))


def geometric(x: float, a: AxisGeometry) -> float:
    """Frequency of the ray that is displaced by x after |z|."""
    return float(x / (a.wavelength * np.hypot(x, a.z)))


def fresnel_width(x: float, a: AxisGeometry) -> float:
    """Fresnel width sqrt(cos^3/(lam z)) of the stationary point of displacement x."""
    cosine = abs(a.z) / np.hypot(x, a.z)
    return float(np.sqrt(cosine**3 / (a.wavelength * abs(a.z))))


def landing(f: float, a: AxisGeometry) -> float:
    """Displacement |z| tan(asin(lam f)) of the ray of frequency f; infinite if evanescent."""
    sine = a.wavelength * f
    if abs(sine) >= 1:
        return float(np.copysign(np.inf, f))
    return float(abs(a.z) * sine / np.sqrt(1 - sine**2))


def lattice(f_lo: float, f_hi: float, window: float) -> Real:
    """Integers k with f_lo <= k/window <= f_hi."""
    slack = 1e-9
    k = np.arange(np.ceil(f_lo * window - slack), np.floor(f_hi * window + slack) + 1)
    return k.astype(np.float64)


def frequencies(a: AxisGeometry, g: Guard) -> tuple[Real, Real]:
    """Frequencies of one axis and their weights: taper, halves at +-f_nyq and the step df."""
    plan = plan_axis(a, g)
    if a.n == 1:
        return np.zeros(1), np.ones(1)
    k = lattice(plan.f_lo, plan.f_hi, plan.window)
    f = k / plan.window
    weight = np.ones_like(f)
    x_min, x_max = displacements(a)
    nyquist = 0.5 / a.pitch
    for outer, x in ((plan.f_lo, x_min), (plan.f_hi, x_max)):
        if abs(outer) < nyquist and g.width > 0:
            t = np.clip((f - outer) / (geometric(x, a) - outer), 0, 1)
            weight *= np.where(t < 1, 0.5 * erfc(-(2 * t - 1) * g.steepness), 1.0)
    weight[np.abs(np.abs(f) / nyquist - 1) < 1e-9] *= 0.5
    return f, weight / plan.window


def dft_pair(f: Real, a: AxisGeometry, n_out: int, d_out: float) -> tuple[Complex, Complex]:
    """A (times dx) to the frequencies f and B back to the output samples."""
    if a.n == 1:
        return np.ones((1, 1), complex), np.ones((n_out, 1), complex)
    to = np.exp(-2j * np.pi * f[:, None] * axis(a.n, a.pitch)) * a.pitch
    return to, np.exp(2j * np.pi * axis(n_out, d_out, a.x0)[:, None] * f)


def helmholtz(fy: Real, fx: Real, z: float, wavelength: float) -> Complex:
    """exp(ikz (sqrt(1-s) - 1)); for s > 1 exp(-kz sqrt(s-1) - ikz) if z > 0, else 0."""
    s = wavelength**2 * (fy**2 + fx**2)
    turns = z / wavelength
    below, above = np.minimum(s, 1), np.maximum(s, 1)
    waves = np.exp(-2j * np.pi * turns * (below / (1 + np.sqrt(1 - below))))
    if z < 0:
        return np.where(s <= 1, waves, 0)
    decay = np.exp(-2 * np.pi * turns * np.sqrt(above - 1) - 2j * np.pi * (turns % 1.0))
    return np.where(s <= 1, waves, decay)
