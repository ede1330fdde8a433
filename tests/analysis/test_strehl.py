"""Strehl ratios of wavefronts, and of the point spread functions that they make."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clplen.analysis.point.psf import PSF, strehl_of_rms, wavefront_rms, wavefront_strehl
from clplen.errors import ShapeError
from clplen.wave.elements.hard_apertures import disc_coverage
from clplen.wave.elements.zernike import noll, zernike
from clplen.wave.field.field import Grid

GRID = Grid((61, 61), 1.0)
RADIUS = 28.0
DISC = disc_coverage(GRID, RADIUS, (0.0, 0.0))


def wavefront(j: int, rms: float) -> np.ndarray:
    """A Zernike polynomial with that rms over the disc in radians."""
    y, x = np.meshgrid(GRID.y, GRID.x, indexing="ij")
    rho = np.minimum(np.hypot(y, x) / RADIUS, 1)
    return rms * zernike(*noll(j), rho, np.arctan2(y, x))


def psf(phase: np.ndarray) -> PSF:
    """The image of a point through the pupil, 4 samples for lam F/D or so."""
    n = 244
    amplitude = np.fft.fftshift(np.fft.fft2(DISC * np.exp(1j * phase), (n, n)))
    return PSF(np.abs(amplitude) ** 2, 1e-6)


@pytest.mark.parametrize(("j", "rms"), [(4, 0.1), (7, 0.5), (11, 0.5)])
def test_low_zernike_terms_have_mahajan_s_strehl_ratio(j: int, rms: float) -> None:
    phase = wavefront(j, rms)
    assert wavefront_rms(phase, weight=DISC) == pytest.approx(rms, rel=5e-3)  # pixels of the disc
    exact = wavefront_strehl(phase, weight=DISC)
    assert exact == pytest.approx(strehl_of_rms(rms), abs=0.01)
    # The peak of a comatic image of .5 rad lies beside the centre, and is hardly higher.
    assert psf(phase).strehl(psf(0 * phase)) == pytest.approx(exact, abs=0.004)
    assert psf(phase).strehl(psf(0 * phase)) >= exact - 1e-6


def test_defocus_has_its_closed_form() -> None:
    # sinc^2 of the phase's range over 2 pi (Born and Wolf 1999, section 8.8.2), range 2 sqrt(3) rms
    for rms in (0.4, 1.0, 1.6):
        exact = np.sinc(2 * math.sqrt(3) * rms / (2 * np.pi)) ** 2
        assert wavefront_strehl(wavefront(4, rms), weight=DISC) == pytest.approx(exact, abs=4e-3)


def test_tilt_moves_the_peak_and_piston_does_nothing() -> None:
    assert psf(wavefront(2, 1.3)).strehl(psf(0 * DISC)) == pytest.approx(1, abs=1e-3)
    assert wavefront_strehl(wavefront(2, 1.3), weight=DISC) < 0.4
    assert wavefront_strehl(DISC + 5, weight=DISC > 0.999) == pytest.approx(1)
    assert wavefront_rms(0 * DISC + 5) == pytest.approx(0, abs=1e-12)


def test_weights_count() -> None:
    phase, weight = np.array([[0.0, 2.0, 9.0]]), np.array([[3.0, 1.0, 0.0]])
    assert wavefront_rms(phase, weight=weight) == pytest.approx(math.sqrt(0.75))
    expected = abs(3 + np.exp(2j)) ** 2 / 16
    assert wavefront_strehl(phase, weight=weight) == pytest.approx(expected)


def test_bad_input_is_told() -> None:
    with pytest.raises(ShapeError, match="weight must have"):
        wavefront_rms(DISC, weight=DISC[1:])
    for weight in (0 * DISC, -DISC, DISC * np.nan):
        with pytest.raises(ValueError, match="must not be negative nor all 0"):
            wavefront_strehl(DISC, weight=weight)
    with pytest.raises(ValueError, match="not negative"):
        strehl_of_rms([0.1, -0.1])
