"""float64 twins of the propagators: Rayleigh-Sommerfeld convolution and the Fresnel methods.

The corrected angular spectrum is in reference_corrected, the plain and the band-limited one in
reference_optics. Conventions as there: fields [y, x], carrier exp(ikz) dropped, an axis of length 1
is one along which nothing changes. Nothing here imports the package under test.
"""

from __future__ import annotations

import numpy as np
from reference_optics import (
    Complex,
    Pair,
    Real,
    axis,
    centred_slice,
    padded_length,
    pair,
    smooth_length,
)
from scipy.signal import fftconvolve
from scipy.special import hankel1e

# Rayleigh-Sommerfeld --------------------------------------------------------------------------


def sommerfeld(u: Complex, pitch: Pair, z: float, *, wavelength: float) -> Complex:
    """Linear convolution of u (ny, nx) with the sampled RS-I kernel times the cell.

    2-D: z/(2 pi r^2) (1/r - ik) exp(ik(r-z)); an axis of length 1: line sources,
    (ikz/2r) H1(kr) (Goodman, Introduction to Fourier Optics, eq. 3-41; Abramowitz & Stegun 9.1).
    z < 0: the conjugate.
    """
    if z == 0:
        return np.array(u, dtype=np.complex128)
    steps = zip(u.shape, pair(pitch), strict=True)
    y, x = (np.arange(1 - n, n) * d for n, d in steps)
    rho2 = y[:, None] ** 2 + x[None, :] ** 2
    cell = float(np.prod([d for n, d in zip(u.shape, pair(pitch), strict=True) if n > 1]))
    if u.shape == (1, 1):
        return np.array(u, dtype=np.complex128)
    form = line_kernel if 1 in u.shape else point_kernel
    kernel = form(rho2, abs(z), 2 * np.pi / wavelength) * cell
    return fftconvolve(kernel if z > 0 else kernel.conj(), u, mode="valid")


def point_kernel(rho2: Real, z: float, k: float) -> Complex:
    """RS-I impulse response of a point, carrier dropped."""
    r = np.sqrt(rho2 + z**2)
    return z / (2 * np.pi * r**2) * (1 / r - 1j * k) * np.exp(1j * k * rho2 / (r + z))


def line_kernel(rho2: Real, z: float, k: float) -> Complex:
    """RS-I impulse response of a line, carrier dropped."""
    r = np.sqrt(rho2 + z**2)
    return 0.5j * k * z / r * hankel1e(1, k * r) * np.exp(1j * k * rho2 / (r + z))


# Fresnel convolutions -------------------------------------------------------------------------


def fresnel_tf(u: Complex, pitch: Pair, z: float, *, wavelength: float, pad: float = 2) -> Complex:
    """Circular convolution on the padded window by H = exp(-i pi lam z f^2)."""
    return per_axis(
        u, pitch, lambda v, d: convolve(v, tf_axis(padded_length(len(v), pad), d, z, wavelength))
    )


def fresnel_ir(u: Complex, pitch: Pair, z: float, *, wavelength: float, pad: float = 2) -> Complex:
    """Circular convolution on the padded window by h = exp(i pi x^2/(lam z)) dx/sqrt(i lam z)."""
    if z == 0:
        return np.array(u, dtype=np.complex128)
    return per_axis(
        u, pitch, lambda v, d: convolve(v, ir_axis(padded_length(len(v), pad), d, z, wavelength))
    )


def tf_axis(n: int, d: float, z: float, wavelength: float) -> Complex:
    """The transfer function of one axis in FFT order."""
    return np.exp(-1j * np.pi * wavelength * z * np.fft.fftfreq(n, d) ** 2)


def ir_axis(n: int, d: float, z: float, wavelength: float) -> Complex:
    """Transform of the sampled impulse response of one axis, in FFT order."""
    h = np.exp(1j * np.pi * axis(n, d) ** 2 / (wavelength * z)) * constant(d, z, wavelength)
    return np.fft.fft(np.fft.ifftshift(h))


def constant(d: float, z: float, wavelength: float) -> complex:
    """dx/sqrt(i lam z) with the root of positive real part, so that -z gives the conjugate."""
    return d / np.sqrt(1j * wavelength * z)


def convolve(v: Complex, h: Complex) -> Complex:
    """Columns of v (n, m) times the transfer function h of the padded length, then cropped."""
    part = centred_slice(len(v), len(h))
    return np.fft.ifft(np.fft.fft(embed(v, len(h)), axis=0) * h[:, None], axis=0)[part]


def embed(v: Complex, length: int) -> Complex:
    """v (n, m) with zeros around its first axis, sample n//2 on sample length//2."""
    window = np.zeros((length, v.shape[1]), dtype=np.complex128)
    window[centred_slice(len(v), length)] = v
    return window


def per_axis(u, pitch: Pair, step) -> Complex:
    """Apply step(columns, pitch) along both axes of u (ny, nx), skipping an axis of length 1."""
    dy, dx = pair(pitch)
    u = np.asarray(u, dtype=np.complex128)
    if u.shape[0] > 1:
        u = step(u, dy)
    return step(u.T, dx).T if u.shape[1] > 1 else u


# Fresnel by single FFTs -----------------------------------------------------------------------


def fresnel_1fft(
    u: Complex,
    pitch: Pair,
    z: float,
    *,
    wavelength: float,
    pad: float = 1,
    lens: float | None = None,
) -> tuple[Complex, tuple[float, float]]:
    """One FFT on each axis; returns the field and its pitch lam |z|/(L dx), L = round(pad N).

    U2 = dx/sqrt(i lam z) exp(i pi x'^2/(lam z)) FFT{U1 exp(i pi x^2/(lam z))} (Goodman, eq. 4-17);
    z < 0 takes the inverse FFT. lens: focal length of a thin lens in the input plane, whose chirp
    is added to the input chirp: (1/z - 1/f). The output has the N samples about the centre.
    """
    if z == 0:
        raise ValueError("z = 0 has pitch 0: a single-FFT step needs z != 0")
    power = 1 / z - (0.0 if lens is None else 1 / lens)

    def step(v: Complex, d: float) -> Complex:
        whole = one_fft(embed(v, round(pad * len(v))), d, z, wavelength, power)
        return whole[centred_slice(len(v), len(whole))]

    out = [
        wavelength * abs(z) / (round(pad * n) * d) if n > 1 else d
        for n, d in zip(u.shape, pair(pitch), strict=True)
    ]
    return per_axis(u, pitch, step), (out[0], out[1])


def one_fft(v: Complex, d: float, z: float, wavelength: float, power: float) -> Complex:
    """The step along the first axis of v (n, m); power (1/m) is that of the input chirp."""
    n = len(v)
    chirp_in = np.exp(1j * np.pi * power / wavelength * axis(n, d) ** 2)
    chirp_out = np.exp(1j * np.pi / (wavelength * z) * axis(n, wavelength * z / (n * d)) ** 2)
    start = np.fft.ifftshift(v * chirp_in[:, None], axes=0)
    spectrum = np.fft.fft(start, axis=0) if z > 0 else n * np.fft.ifft(start, axis=0)
    scale = constant(d, z, wavelength) * chirp_out
    return np.fft.fftshift(spectrum, axes=0) * scale[:, None]


def fresnel_multistep(
    u: Complex, pitch: Pair, z: float, *, wavelength: float, pad: float = 2, border: float = 0.4
) -> Complex:
    """Single-FFT steps of dz = N' dx^2/lam on each axis, N' even, and a TF step for the rest.

    After every step a cos^2 taper over the fraction `border` of the half window absorbs what
    reaches the edge. Below dz there is the TF step alone.
    """
    if z < 0:
        forward = fresnel_multistep(
            np.conj(u), pitch, -z, wavelength=wavelength, pad=pad, border=border
        )
        return forward.conj()

    def steps(v: Complex, d: float) -> Complex:
        length = even_length(len(v), pad)
        dz = length * d**2 / wavelength
        m = int(np.floor(z / dz * (1 + 1e-12)))
        window, edge = embed(v, length), taper(length, border)
        for _ in range(m):
            window = edge[:, None] * one_fft(window, d, dz, wavelength, 1 / dz)
        rest = tf_axis(length, d, z - m * dz, wavelength)
        return convolve(window, rest)[centred_slice(len(v), length)]

    return per_axis(u, pitch, steps)


def even_length(n: int, pad: float) -> int:
    """Even padded length: n or n + 1 for pad=1, else 7-smooth and >= round(pad n)."""
    if pad == 1:
        return n + n % 2
    return 2 * smooth_length((round(pad * n) + 1) // 2)


def taper(n: int, border: float) -> Real:
    """1 inside, cos^2 to 0 over the outer fraction `border` of the half window."""
    if border == 0:
        return np.ones(n)
    t = np.abs(axis(n, 1.0)) / (n / 2)
    return np.cos(np.pi / 2 * np.clip((t - (1 - border)) / border, 0, 1)) ** 2
