"""Wavelengths by which sources are exposed, and the energy of each behind each colour filter.

How many: the image of a point by a pupil is the Airy pattern, whose width follows the wavelength;
its sum over n wavelengths is compared with that over many, which costs no simulation. In the raw
image the patterns of main lens and lenslets multiply, and a blur has fringes between rays of a few
wavelengths' difference, so that `MARGIN` times less is allowed there than in the raw image.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.cameras.optics.color_filters import ColorFilterArray
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.cameras.scenes.scene_sources import PicturePlane, Source
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.spectrum.lineshapes import C
from clplen.wave.spectrum.spectral_quadrature import Signal
from clplen.wave.spectrum.spectrum import Spectrum

Values = np.ndarray[Any, np.dtype[np.float64]]

TOLERANCE = 1e-3  # L2, of the raw image of a point from that by MOST wavelengths
MARGIN = 4.0
MOST = 41  # wavelengths
RINGS = 20.0  # of the Airy pattern that are compared, in units of lam_mean/NA
PLACES = 1200


@dataclass(frozen=True)
class SpectralLine:
    """One wavelength by which a source is exposed.

    Attributes
    ----------
    wavelength : float
        In metres.
    weights : numpy.ndarray
        Signal of a unit of energy of each channel of the source behind each filter, shape
        (channels, filters); one filter where there are none. Some may be below 0.
    """

    wavelength: float
    weights: Values


def filters_of(optics: WaveOptics) -> ColorFilterArray | None:
    """The colour filters of a camera's pixels."""
    return None if optics.pixels is None else optics.pixels.filters


def has_spectrum(source: Source) -> bool:
    """Whether a source has light of its own wavelengths."""
    own = source.spectra if isinstance(source, PicturePlane) else source.spectrum
    return own is not None


def spectral_lines(
    optics: WaveOptics, source: Source, coherence: Coherence | None
) -> list[SpectralLine]:
    """The wavelengths by which a self-luminous source is exposed.

    Parameters
    ----------
    optics : WaveOptics
        Its wavelength is that of sources without a spectrum, and the reference of filters.
    source : PointSources or PicturePlane
    coherence : Coherence or None
        Its spectrum is that of sources without one; its ``wavelengths`` say how many.

    Returns
    -------
    list of SpectralLine

    Raises
    ------
    ValueError
        If no filter sees the light of a channel.
    """
    spectra, filters = _spectra_of(source, coherence, optics.wavelength), filters_of(optics)
    if filters is None:
        signal = Signal.of(spectra, lambda lam: np.ones((len(lam), 1)), ())
    else:
        signal = filters.signal(spectra, optics.wavelength)
        _require_signal(signal, spectra, filters)
    given = None if coherence is None else coherence.wavelengths
    wavelengths, weights = signal.rule(wavelengths_needed(signal) if given is None else given)
    return [SpectralLine(float(lam), w) for lam, w in zip(wavelengths, weights, strict=True)]


def wavelengths_needed(signal: Signal, *, tolerance: float = TOLERANCE) -> int:
    """Fewest wavelengths by which the raw image of a point is right to a tolerance.

    Parameters
    ----------
    signal : Signal
    tolerance : float
        L2 difference from the raw image by 41 wavelengths, relative, of the colour filter that is
        worst. Of the Airy pattern a quarter of it is allowed.

    Returns
    -------
    int
        1 to 41.
    """
    total = signal.masses.sum(axis=1)
    behind = Signal(signal.nu, total[:, None, total.sum(axis=0) > 0])
    mean = float(behind.nu @ behind.masses.sum(axis=(1, 2)) / behind.masses.sum())
    expected = _airy(behind, MOST, mean)
    norms = np.linalg.norm(expected, axis=1)
    for n in range(1, MOST):
        apart = np.linalg.norm(_airy(behind, n, mean) - expected, axis=1)
        if (apart <= tolerance / MARGIN * norms).all():
            return n
    return MOST


def energies_by_pixel(
    filters: ColorFilterArray | None, powers: Values, line: SpectralLine
) -> Values:
    """The signal that points send to the pixels of a tile.

    Parameters
    ----------
    filters : ColorFilterArray or None
    powers : numpy.ndarray
        Energy of each point and channel, shape (n, channels).
    line : SpectralLine

    Returns
    -------
    numpy.ndarray
        Shape (n,) where all pixels are alike, else (n, ty, tx).
    """
    found = powers @ line.weights
    if filters is None or filters.mosaic is None:
        return np.asarray(found[:, 0])
    return np.asarray(found[:, filters.index])


def add_by_tile(image: Values, picture: Values, tile: Values) -> None:
    """Add a picture times factors that repeat from pixel (0, 0) on to an image."""
    down, across = tile.shape
    for y, x in np.ndindex(down, across):
        image[y::down, x::across] += tile[y, x] * picture[y::down, x::across]


def _spectra_of(
    source: Source, coherence: Coherence | None, wavelength: float
) -> Sequence[Spectrum]:
    """One a channel."""
    if isinstance(source, PicturePlane):
        if source.spectra is not None:
            return source.spectra
    elif source.spectrum is not None:
        return [source.spectrum]
    if coherence is not None and coherence.spectrum is not None:
        return [coherence.spectrum]
    return [Spectrum.monochromatic(wavelength)]


def _require_signal(
    signal: Signal, spectra: Sequence[Spectrum], filters: ColorFilterArray
) -> None:
    for number, (total, spectrum) in enumerate(zip(signal.totals, spectra, strict=True)):
        if total.sum() > 0:
            continue
        lit = [curve.wavelengths for curve in filters.sensitivities]
        low, high = min(lam[0] for lam in lit), max(lam[-1] for lam in lit)
        which = f"channel {number} of the picture" if len(spectra) > 1 else "this source"
        raise ValueError(
            f"No filter sees the light of {which}, about {spectrum.centre * 1e9:.4g} nm: the "
            f"sensitivities reach from {low * 1e9:.4g} to {high * 1e9:.4g} nm."
        )


def _airy(signal: Signal, n: int, mean: float) -> Values:
    """Airy patterns behind each filter by n wavelengths, times sqrt(r), shape (filters, places)."""
    from scipy import special  # a slow import

    wavelengths, weights = signal.rule(n)
    r = RINGS * (np.arange(PLACES) + 0.5) / PLACES
    wider = C / wavelengths[:, None] / mean
    v = math.pi * r * wider
    patterns = wider**2 * (2 * special.j1(v) / v) ** 2 * np.sqrt(r)
    return np.asarray(weights.sum(axis=1).T @ patterns)
