"""One-dimensional camera that predicts how a point's image changes with the wavelength, in ms.

Main lens, lenslets and pixels are cut along a row of lenslets and continued along its columns
(cylindrical lenses). Blur, both diffraction patterns, light that crosses into neighbouring
lenslets, and the average over a pixel then have the sizes of the camera itself.
Waves are those of Fresnel's approximation (Goodman 2005, section 4.2).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.compute.fft.lines import smooth_length

Values = np.ndarray[Any, np.dtype[np.float64]]
Complex = np.ndarray[Any, np.dtype[np.complex128]]

MAX_BLUR_LENSLETS = 8.0  # maximum blur in lenslets; a wider blur is cut at the same curvature
MARGIN_PITCHES = 3.0  # margin around the blur, in lenslet pitches
MARGIN_RINGS = 10.0  # further margin for diffraction, in lam z2/D
OFFSETS = (0.0, 0.25, 0.5)  # positions of the lenslets under the blur, in pitches
OVERSAMPLING = 1.5  # oversampling over Nyquist's rate
MIN_SAMPLES_PER_PIXEL = 4  # minimum samples a pixel


def point_images(optics: WaveOptics, dz: float, wavenumbers: Values) -> Values:
    """Compute the energy of a point on a row of pixels, for each wavelength."""
    from scipy import fft  # a slow import

    beta = float(optics.array_alpha(dz))
    z2, z3, mla = optics.array_distance, optics.sensor_distance, optics.mla
    D, bent = optics.aperture_diameter, abs(1 - beta)
    if bent * D > MAX_BLUR_LENSLETS * mla.pitch:
        D = MAX_BLUR_LENSLETS * mla.pitch / bent
    shortest, longest = 1 / wavenumbers.max(), 1 / wavenumbers.min()
    slope = max(1.0, abs(beta)) * D / (2 * z2) + mla.diameter / (2 * min(mla.focal_lengths))
    dx = min(shortest / (2 * slope * OVERSAMPLING), optics.pixel_pitch / MIN_SAMPLES_PER_PIXEL)
    half = bent * D / 2 + MARGIN_PITCHES * mla.pitch + MARGIN_RINGS * longest * z2 / D + z3 * slope
    n = smooth_length(math.ceil(2 * half / dx))
    x = (np.arange(n) - n // 2) * dx
    at_array = _array_field(wavenumbers, x, D, z2, 1 - beta)
    if not optics.field_lens:
        at_array = at_array * np.exp(1j * np.pi / z2 * wavenumbers[:, None] * x**2)
    onward = np.exp(-1j * np.pi * z3 / wavenumbers[:, None] * fft.fftfreq(n, dx) ** 2)
    pictures = []
    for offset in OFFSETS:
        distance = x - offset * mla.pitch
        distance = distance - mla.pitch * np.round(distance / mla.pitch)
        open_ = np.clip((mla.diameter / 2 - np.abs(distance)) / dx + 0.5, 0, 1)
        for focal_length in mla.focal_lengths:
            lens = np.exp(-1j * np.pi / focal_length * wavenumbers[:, None] * distance**2)
            sensor = fft.ifft(fft.fft(at_array * open_ * lens) * onward)
            pictures.append(_on_pixels(np.abs(sensor) ** 2, dx, optics.pixel_pitch))
    return np.concatenate(pictures, axis=1)


def _array_field(k: Values, x: Values, D: float, z2: float, bent: float) -> Complex:
    """Compute int exp(i pi k (bent u^2 - 2 x u)/z2) du over the pupil by Bluestein's transform."""
    from scipy import fft

    fastest = (np.abs(x).max() + abs(bent) * D / 2) / z2 * k.max()  # turns a metre
    count = math.ceil(2 * OVERSAMPLING * fastest * D) + 16
    du, n = D / count, len(x)
    dx = x[1] - x[0]
    j, m = np.arange(count) - (count - 1) / 2, np.arange(n) - n // 2
    turn = (np.pi * k * dx * du / z2)[:, None]
    pupil = np.exp(1j * (np.pi * k / z2)[:, None] * bent * (j * du) ** 2 - 1j * turn * j**2)
    length = smooth_length(count + n - 1)
    apart = np.arange(n + count - 1) - n // 2 - (count - 1) / 2
    chirp = np.exp(1j * turn * apart**2)
    sums = fft.ifft(fft.fft(pupil, length) * fft.fft(chirp, length))[:, count - 1 : count - 1 + n]
    return np.asarray(sums * np.exp(-1j * turn * m**2) * np.sqrt(k)[:, None] * du)


def _on_pixels(intensity: Values, dx: float, pitch: float) -> Values:
    """Integrate over pixels, linearly between samples of the running sum."""
    n = intensity.shape[1]
    running = np.concatenate([np.zeros((len(intensity), 1)), np.cumsum(intensity, axis=1)], axis=1)
    edges = np.arange(0.0, n, pitch / dx)
    index = np.minimum(edges.astype(int), n - 1)
    part = edges - index
    at = running[:, index] * (1 - part) + running[:, index + 1] * part
    return np.asarray(np.diff(at, axis=1) * dx)
