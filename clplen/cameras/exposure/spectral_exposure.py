"""Wavelengths that expose sources, and their energy behind each colour filter.

The number of wavelengths follows from a one-dimensional camera (cylindrical_twin.py), without a
simulation of the camera itself. Its images of a point at TWIN_WAVELENGTHS wavelengths give the
difference between raw images by n and by MAX_WAVELENGTHS wavelengths, averaged over positions
beside a lenslet's middle. The raw image of a point by n wavelengths is then right to 1e-3 (claims
"color"), except for points in the middle of an f/2 lenslet, with up to 1.6e-3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.cameras.exposure.cylindrical_twin import point_images
from clplen.cameras.optics.color_filters import ColorFilterArray, signal_of
from clplen.cameras.optics.ray_optics import check_in_view
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.cameras.scenes.scene_sources import PicturePlane, Source
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.spectrum.lineshapes import C
from clplen.wave.spectrum.spectral_quadrature import Signal
from clplen.wave.spectrum.spectrum import Spectrum

Values = np.ndarray[Any, np.dtype[np.float64]]

POINT_TOLERANCE = 1e-3  # maximum L2 error of a point's raw image, relative to MAX_WAVELENGTHS
PICTURE_TOLERANCE = 3e-3  # maximum L2 error for points of large pictures, a minute a wavelength
MAX_EXACT_SAMPLES = 256  # luminous samples of a picture above which PICTURE_TOLERANCE applies
MAX_WAVELENGTHS = 41  # maximum number of wavelengths
TWIN_WAVELENGTHS = 48  # wavelengths between which the twin's images are interpolated


@dataclass(frozen=True)
class SpectralLine:
    """Wavelength and weights of an exposure of a source."""

    wavelength: float  # in metres
    # signal of a unit of energy of each channel behind each filter, shape (channels, filters); one
    # filter if the pixels have none. Weights may be negative
    weights: Values


def spectral_lines(
    optics: WaveOptics, source: Source, coherence: Coherence | None
) -> list[SpectralLine]:
    """Return the wavelengths that expose a self-luminous source."""
    spectra, filters = _channel_spectra(source, coherence, optics.wavelength), optics.filters
    positions = (source.corners() if isinstance(source, PicturePlane) else source).positions
    check_in_view(replace(optics, wavelength=spectra[0].centre), positions)
    if filters is None:
        signal = Signal.of(spectra, lambda lam: np.ones((len(lam), 1)), ())
    else:
        signal = signal_of(filters, spectra, optics.wavelength)
        _require_signal(signal, spectra, filters)
    count = None if coherence is None else coherence.wavelengths
    depths = positions[:, 2].tolist()
    n = count or wavelengths_needed(optics, depths, signal, tolerance=_tolerance(source))
    wavelengths, weights = signal.rule(n)
    return [SpectralLine(float(lam), w) for lam, w in zip(wavelengths, weights, strict=True)]


def _tolerance(source: Source) -> float:
    is_large = (
        isinstance(source, PicturePlane) and np.count_nonzero(source.energy) > MAX_EXACT_SAMPLES
    )
    return PICTURE_TOLERANCE if is_large else POINT_TOLERANCE


def wavelengths_needed(
    optics: WaveOptics,
    depths: Sequence[float],
    signal: Signal,
    *,
    tolerance: float = POINT_TOLERANCE,
) -> int:
    """Return the number of wavelengths that keeps a point's raw image within a tolerance."""
    low, high = signal.band
    if high - low <= 1e-9 * high:
        return 1
    blurred = [abs(1 - float(optics.array_alpha(dz))) for dz in depths]
    chosen = {min(depths), max(depths), depths[int(np.argmin(blurred))]}
    t = np.cos(np.pi * (np.arange(TWIN_WAVELENGTHS) + 0.5) / TWIN_WAVELENGTHS)
    nu = (low + high) / 2 + (high - low) / 2 * t
    images = [point_images(optics, dz, nu / C) for dz in sorted(chosen)]
    shares = _shares(optics)
    expected = [_filtered_images(signal, MAX_WAVELENGTHS, nu, image) * shares for image in images]
    for n in range(MAX_WAVELENGTHS - 1, 0, -1):
        for image, reference in zip(images, expected, strict=True):
            difference = np.linalg.norm(_filtered_images(signal, n, nu, image) * shares - reference)
            if difference > tolerance * np.linalg.norm(reference):
                return n + 1
    return 1


def _shares(optics: WaveOptics) -> Values:
    """Return square roots of the filters' fractions of the pixels, shape (filters, 1)."""
    filters = optics.filters
    if filters is None:
        return np.ones((1, 1))
    counts = np.bincount(filters.index.ravel(), minlength=len(filters.names))
    return np.asarray(np.sqrt(counts / filters.index.size)[:, None])


def _filtered_images(signal: Signal, n: int, nu: Values, images: Values) -> Values:
    """Compute images by n wavelengths behind each filter, from images at Chebyshev nodes."""
    wavelengths, weights = signal.rule(n)
    k = np.arange(len(nu))
    signs = (-1.0) ** k * np.sin(np.pi * (k + 0.5) / len(nu))  # Berrut and Trefethen 2004, eq. 5.4
    difference = C / wavelengths[:, None] - nu
    parts = signs / np.where(difference == 0, 1e-9, difference)
    at_nodes = (parts / parts.sum(axis=1, keepdims=True)) @ images
    return np.asarray(weights.sum(axis=1).T @ at_nodes)


def energies_by_pixel(
    filters: ColorFilterArray | None, powers: Values, line: SpectralLine
) -> Values:
    """Compute the signal of points on the pixels of a tile."""
    signals = powers @ line.weights
    if filters is None or filters.mosaic is None:
        return np.asarray(signals[:, 0])
    return np.asarray(signals[:, filters.index])


def add_by_tile(image: Values, picture: Values, tile: Values) -> None:
    """Add a picture to an image, times factors that repeat from pixel (0, 0) on."""
    down, across = tile.shape
    for y, x in np.ndindex(down, across):
        image[y::down, x::across] += tile[y, x] * picture[y::down, x::across]


def _channel_spectra(
    source: Source, coherence: Coherence | None, wavelength: float
) -> Sequence[Spectrum]:
    """Return a spectrum for each channel."""
    if source.spectra is not None:
        return source.spectra
    if coherence is not None and coherence.spectrum is not None:
        return [coherence.spectrum]
    return [Spectrum.monochromatic(wavelength)]


def _require_signal(signal: Signal, spectra: Sequence[Spectrum], filters: ColorFilterArray) -> None:
    for number, (total, spectrum) in enumerate(zip(signal.totals, spectra, strict=True)):
        if total.sum() > 0:
            continue
        lit = [curve.wavelengths for curve in filters.sensitivities]
        low, high = min(lam[0] for lam in lit), max(lam[-1] for lam in lit)
        which = f"channel {number} of the picture" if len(spectra) > 1 else "this source"
        raise ValueError(
            f"No colour filter transmits the light of {which}, about {spectrum.centre * 1e9:.4g} "
            f"nm: extend the sensitivities, {low * 1e9:.4g} to {high * 1e9:.4g} nm."
        )
