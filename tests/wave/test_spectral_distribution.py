"""Sampled curves over the wavelength, and the wavelengths that stand for them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clplen import Spectrum
from clplen.wave import SpectralDistribution
from clplen.wave.spectrum.lineshapes import C
from clplen.wave.spectrum.spectral_quadrature import Signal


def test_illuminants_are_those_of_the_cie() -> None:
    a, d65, e = (SpectralDistribution.illuminant(name) for name in ("A", "D65", "E"))
    # CIE 15:2004, table T.1
    lam = [380e-9, 450e-9, 600e-9, 780e-9]
    np.testing.assert_allclose(a(lam), [9.795, 33.086, 129.04, 241.68], rtol=2e-4)
    lam = [380e-9, 445e-9, 560e-9, 780e-9]
    np.testing.assert_allclose(d65(lam), [49.9755, 110.936, 100, 63.3828], rtol=1e-5)
    np.testing.assert_array_equal(e([301e-9, 555e-9, 829e-9]), 100)
    for one in (a, d65, e):
        assert one(560e-9) == pytest.approx(100)
        assert one([299e-9, 831e-9]).max() == 0


def test_a_black_body_obeys_plancks_and_wiens_laws() -> None:
    for temperature in [2856.0, 5772.0]:
        body = SpectralDistribution.blackbody(temperature)
        lam = np.array([400e-9, 555e-9, 900e-9])
        h, c, k = 6.62607015e-34, C, 1.380649e-23
        planck = lam**-5 / np.expm1(h * c / (lam * k * temperature))
        np.testing.assert_allclose(body(lam) / body(lam[0]), planck / planck[0], rtol=1e-9)
        peak = body.wavelengths[int(np.argmax(body.values))]
        assert peak == pytest.approx(min(2.897771955e-3 / temperature, 1100e-9), abs=2.6e-9)
        assert max(body.values) == 1


def test_products_integrals_and_spectra() -> None:
    light = SpectralDistribution([400e-9, 500e-9, 700e-9], [1.0, 3.0, 1.0])
    paint = SpectralDistribution([450e-9, 600e-9], [0.25, 0.75])
    both = light * paint
    assert both.wavelengths == (450e-9, 500e-9, 600e-9)
    np.testing.assert_allclose(both.values, [2 * 0.25, 3 * (0.25 + 1 / 6), 2 * 0.75])
    assert light.integral == pytest.approx(2 * 100e-9 + 2 * 200e-9)
    assert (2 * light).integral == pytest.approx(2 * light.integral)
    assert (light * 2) == (2 * light)
    spectrum = light.spectrum
    lam = np.array([430e-9, 555e-9])
    wanted = light(lam) / light.integral * lam**2 / C
    np.testing.assert_allclose(spectrum.density(C / lam), wanted, rtol=1e-12)
    led = SpectralDistribution.gaussian(625e-9, 20e-9, 0.5)
    assert led(625e-9) == pytest.approx(0.5)
    assert led([615e-9, 635e-9]) == pytest.approx(0.25, rel=1e-3)
    assert led.integral == pytest.approx(0.5 * 20e-9 * np.sqrt(np.pi / np.log(2)) / 2, rel=1e-3)


def test_what_makes_no_curve() -> None:
    for make, said in [
        (lambda: SpectralDistribution([550.0, 600.0], [1, 1]), r"metres, did you mean 550e-9\?"),
        (lambda: SpectralDistribution([4e-7, 5e-7], [1, np.nan]), "Point 1 .* is not a number"),
        (lambda: SpectralDistribution([4e-7, 5e-7], [1, -1]), "Point 1 .* is negative"),
        (lambda: SpectralDistribution([5e-7, 4e-7], [1, 1]), "wavelengths must rise"),
        (lambda: SpectralDistribution([4e-7, 5e-7], [0, 0]), "every value is 0"),
        (lambda: SpectralDistribution([4e-7, 5e-7], [1, 1, 1]), "rows of equal length"),
        (lambda: SpectralDistribution([4e-7], [1]), "at least two points"),
        (lambda: SpectralDistribution.blackbody(20), "at least 500 K"),
        (lambda: SpectralDistribution.blackbody(float("nan")), "at least 500 K"),
        (lambda: SpectralDistribution.illuminant("F2"), "'A', 'D65' or 'E', got 'F2'"),
        (lambda: SpectralDistribution.gaussian(550.0, 20e-9), r"did you mean 550e-9\?"),
        (lambda: SpectralDistribution.gaussian(550e-9, 20.0), "below half the wavelength"),
        (lambda: SpectralDistribution.gaussian(550e-9, 20e-9, 0), "above 0"),
        (lambda: -1.0 * SpectralDistribution([4e-7, 5e-7], [1, 1]), "above 0, got -1"),
        (
            lambda: (
                SpectralDistribution([4e-7, 5e-7], [1, 1])
                * SpectralDistribution([6e-7, 7e-7], [1, 1])
            ),
            "got 400 to 500 nm and 600 to 700 nm",
        ),
    ]:
        with pytest.raises(ValueError, match=said):
            make()


CURVES = (
    SpectralDistribution([440e-9, 530e-9, 610e-9], [0.0, 0.9, 0.1]),
    SpectralDistribution([400e-9, 455e-9, 480e-9, 700e-9], [0.2, 0.8, 0.3, 0.05]),
)
LIGHTS = {
    "table": SpectralDistribution.illuminant("D65").spectrum,
    "gaussian": Spectrum.gaussian(540e-9, 60e-9),
    "rectangle": Spectrum.rectangular(520e-9, 110e-9),
    "led": SpectralDistribution.gaussian(525e-9, 35e-9).spectrum,
}


def respond(lam: Any) -> Any:
    return np.stack([curve(lam) for curve in CURVES], axis=-1)


def signal_of(*lights: Spectrum) -> Signal:
    knots = sorted({lam for curve in CURVES for lam in curve.wavelengths})
    return Signal.of(lights, respond, knots)


def test_signals_are_integrals_of_light_times_sensitivity() -> None:
    for name in LIGHTS:
        light = LIGHTS[name]
        found = signal_of(light).totals[0]
        cells = 10**6  # by the midpoint rule, over the wavelengths of both curves
        lam = 400e-9 + 300e-9 * (np.arange(cells) + 0.5) / cells
        density = light.density(C / lam) * C / lam**2
        wanted = density @ respond(lam) * (300e-9 / cells)
        np.testing.assert_allclose(found, wanted, rtol=1e-5)


def test_rules_are_exact_for_polynomials_and_for_every_filters_energy() -> None:
    for name in LIGHTS:
        for n in [1, 2, 5, 9]:
            signal = signal_of(LIGHTS[name])
            lam, weights = signal.rule(n)
            assert lam.shape == (n,)
            assert (np.diff(lam) < 0).all()
            np.testing.assert_allclose(weights.sum(axis=0), signal.totals, rtol=1e-10)
            low, high = signal.band
            t, at = ((2 * nu - low - high) / (high - low) for nu in (signal.nu, C / lam))
            scale = np.abs(signal.totals).max()
            for order in range(
                2 * n
            ):  # together as Gauss, each filter as a polynomial through the nodes
                every = np.tensordot(t**order, signal.masses, (0, 0))
                found = np.tensordot(at**order, weights, (0, 0))
                assert found.sum() == pytest.approx(every.sum(), abs=1e-12 * scale)
                if order < n:
                    np.testing.assert_allclose(found, every, atol=1e-12 * scale)
            beyond = np.tensordot(at ** (2 * n), weights, (0, 0)).sum()
            wanted = np.tensordot(t ** (2 * n), signal.masses, (0, 0)).sum()
            assert abs(beyond - wanted) > 1e-11 * scale  # no more than 2 n - 1 are exact


def test_lines_take_no_more_wavelengths_than_there_are() -> None:
    mercury = Spectrum.mercury()
    lam, weights = signal_of(mercury).rule(41)
    assert len(lam) == 6
    lines = sorted((C / nu for nu in mercury.shape.centres), reverse=True)  # type: ignore[attr-defined]
    np.testing.assert_allclose(lam, lines, rtol=1e-9)
    shares = np.array(mercury.shape.powers)[np.argsort(mercury.shape.centres)]  # type: ignore[attr-defined]
    np.testing.assert_allclose(weights[:, 0], shares[:, None] * respond(lam), atol=1e-12)
    lam, weights = signal_of(Spectrum.monochromatic(500e-9)).rule(9)
    np.testing.assert_allclose(lam, [500e-9], rtol=1e-12)
    np.testing.assert_allclose(weights[0, 0], respond(500e-9), rtol=1e-12)


def test_channels_share_nodes_and_keep_their_own_energies() -> None:
    lights = (LIGHTS["led"], Spectrum.mercury(), LIGHTS["table"])
    signal = signal_of(*lights)
    lam, weights = signal.rule(12)
    assert weights.shape == (12, 3, 2)
    for n, light in enumerate(lights):
        np.testing.assert_allclose(weights[:, n].sum(axis=0), signal_of(light).totals[0], rtol=1e-9)
    assert len(lam) == 12
