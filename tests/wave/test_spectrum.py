"""Spectra: coherence by closed forms and by quadrature, their samples. Host float64."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j1

from clplen.wave.spectrum.spectrum import Spectrum

C = 299792458.0
LAM, FWHM = 550e-9, 30e-9
DNU = C * FWHM / LAM**2
AIRY = 3.8317059702075125  # first zero of J1


def led():
    return Spectrum.gaussian(LAM, FWHM)


def lopsided():
    """A coarse table, dark in between, with a step at its end."""
    lam = [380e-9, 420e-9, 500e-9, 510e-9, 600e-9, 640e-9, 700e-9]
    return Spectrum.tabulated(lam, [0.0, 3.0, 1.0, 0.0, 0.0, 5.0, 2.0])


def per_wavelength(spectrum, function):
    """int of density per wavelength times a function, by another integrator over wavelength."""
    lam, values = spectrum.shape.wavelengths, spectrum.shape.values
    total = norm = 0
    for i in range(len(lam) - 1):

        def density(x, i=i):
            return np.interp(x, lam[i : i + 2], values[i : i + 2])

        ends = lam[i : i + 2]
        area = (values[i] + values[i + 1]) / 2 * (ends[1] - ends[0])
        options = {"epsabs": 1e-11 * area, "epsrel": 0, "limit": 200}
        if area:
            total += quad(
                lambda x, f=density: f(x) * function(x), *ends, **options, complex_func=True
            )[0]
        norm += area
    return total / norm


def test_coherence_lengths_of_550_30_nm():
    for definition, length in [("goodman", 6.698e-6), ("fwhm", 8.899e-6), ("oct", 4.449e-6)]:
        assert round(led().coherence_length(definition), 9) == pytest.approx(length)


def test_degree_of_a_gaussian():
    """The closed form, and its quadrature over the density; phase of the centre included."""
    path = np.array([[0.0, 1e-6, -2.3e-6], [4e-6, 9e-6, 2e-5]])
    law = np.exp(-((np.pi * DNU * path / C / (2 * np.sqrt(np.log(2)))) ** 2))
    gamma = led().gamma(path / C)
    assert gamma.shape == path.shape
    np.testing.assert_allclose(led().degree(path), law, rtol=1e-12)
    np.testing.assert_allclose(gamma, law * np.exp(-2j * np.pi * path / LAM), atol=1e-12)
    nu = C / LAM + DNU * np.linspace(-4, 4, 4001)  # falls to 5e-20
    mass = led().density(nu) * (nu[1] - nu[0])
    assert mass.sum() == pytest.approx(1, abs=1e-12)
    found = np.exp(-2j * np.pi * path[..., None] / C * nu) @ mass
    np.testing.assert_allclose(found, gamma, atol=1e-10)


def test_degree_of_a_rectangle():
    light, path = Spectrum.rectangular(LAM, FWHM), np.array([1e-6, -3e-6, 11e-6])
    assert light.density(C / LAM + DNU * np.array([-0.51, -0.49, 0.49, 0.51])) == pytest.approx(
        [0, 1 / DNU, 1 / DNU, 0]
    )
    np.testing.assert_allclose(
        light.gamma(path / C),
        np.sinc(DNU * path / C) * np.exp(-2j * np.pi * path / LAM),
        atol=1e-12,
    )
    assert light.coherence_length() == pytest.approx(LAM**2 / FWHM)
    half = 1.8954942670339809 / np.pi  # sinc(half) = 1/2
    assert light.coherence_length("fwhm") == pytest.approx(2 * half * LAM**2 / FWHM, rel=1e-9)


def test_beats_of_two_lines():
    """Equal lines beat, |gamma| = |cos(pi df tau)|; with a width the beats decay."""
    pair = [589.0e-9, 589.6e-9]
    beat = 1 / (1 / pair[0] - 1 / pair[1])
    path = np.linspace(0, 2.5 * beat, 7)
    light = Spectrum.lines(pair, [2, 2])
    np.testing.assert_allclose(light.degree(path), np.abs(np.cos(np.pi * path / beat)), atol=1e-9)
    wide = Spectrum.lines(pair, [2, 2], fwhm=0.1e-9)
    assert wide.degree(beat) == pytest.approx(
        Spectrum.gaussian(589.3e-9, 0.1e-9).degree(beat), rel=1e-3
    )
    assert light.coherence_length("fwhm") == pytest.approx(2 * beat / 3, rel=1e-9)
    assert math.isinf(light.coherence_length())
    # A weak line far off beats 50 times before the strong one's width counts.
    strong = Spectrum.lines([500e-9, 700e-9], [9, 1], fwhm=1e-9)
    fall = strong.coherence_length("fwhm") / 2
    assert fall > 50 / (1 / 500e-9 - 1 / 700e-9) * 0.9
    assert strong.degree(fall) == pytest.approx(0.5, abs=1e-9)
    assert strong.degree(np.linspace(0, 0.9999 * fall, 9999)).min() > 0.5
    close = Spectrum.lines([550e-9, 570e-9], [1, 2], fwhm=15e-9)  # they overlap
    nu = np.linspace(C / 620e-9, C / 510e-9, 20_001)
    square = (close.density(nu) ** 2).sum() * (nu[1] - nu[0])
    assert close.coherence_length() == pytest.approx(C * square, rel=1e-9)
    unequal = Spectrum.lines(pair[::-1], [1, 3])
    assert unequal.degree(beat / 2) == pytest.approx(0.5)
    mean = 0.75 / pair[0] + 0.25 / pair[1]
    assert unequal.centre == pytest.approx(1 / mean, rel=1e-12)


def test_degree_of_a_table():
    """Against an integral over wavelength; 1e-9: the adaptive integrator's 1e-11 a piece."""
    for spectrum in [lopsided(), Spectrum.white_led()]:
        for path in (0.0, 0.7e-6, -5e-6, 31e-6, -2e-4):
            expected = per_wavelength(spectrum, lambda lam, p=path: np.exp(-2j * np.pi * p / lam))
            assert abs(spectrum.gamma(path / C) - expected) < 1e-9
        frequency = per_wavelength(spectrum, lambda lam: 550e-9 / lam).real
        assert spectrum.centre == pytest.approx(550e-9 / frequency, rel=1e-9)


def test_density_of_a_table_is_per_frequency():
    """lam^2/c times that per wavelength, integral 1; int S^2 is the coherence time."""
    spectrum = lopsided()
    lam = np.array([400e-9, 450e-9, 640e-9])
    ratio = spectrum.density(C / lam) / (lam**2 * np.array([1.5, 2.25, 5.0]))
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    assert spectrum.density([C / 379e-9, C / 701e-9, C / 550e-9, 0, -1e14]).tolist() == [0] * 5
    nu = np.linspace(C / 701e-9, C / 379e-9, 400_001)
    density = spectrum.density(nu)
    # Riemann sums: the step at 700 nm leaves half a cell in doubt, 5e-6 of 1.
    assert density.sum() * (nu[1] - nu[0]) == pytest.approx(1, abs=1e-5)
    square = (density**2).sum() * (nu[1] - nu[0])
    assert spectrum.coherence_length() == pytest.approx(C * square, rel=2e-5)


def test_wide_pieces_and_narrow_ones():
    """Two points, more than an octave apart; a band of 1 pm over 0.3 and 28 turns."""
    for lam, path, tolerance in [
        ([400e-9, 900e-9], 3e-6, 1e-9),
        ([600e-9, 600.001e-9], 0.1, 2e-9),
        ([600e-9, 600.001e-9], 10.0, 1e-7),
    ]:
        spectrum = Spectrum.tabulated(lam, [1.0, 2.0])
        u = np.linspace(0, 1, 400_001)
        x = lam[0] + (lam[1] - lam[0]) * u
        mass = (1 + u) / 1.5 / (u.size - 1)
        mass[[0, -1]] /= 2
        expected = np.exp(2j * np.pi * path * (x - x[0]) / (x * x[0])) @ mass
        found = spectrum.gamma(path / C) * np.exp(2j * np.pi * (path / x[0] % 1))
        assert abs(found - expected) < tolerance


def test_error_of_gaussian_samples():
    """|gamma| within three coherence lengths: at most the limit, at least 70 % of it."""
    for n, span, limit in [(9, 1.5, 0.2), (15, 2, 3.5e-4), (21, 2, 1.5e-6)]:
        path = 3 * led().coherence_length()
        error = led().error(n, path, span=span)
        assert 0.7 * limit < error < limit
        samples = led().sample(n, span=span)
        nu = C / samples.wavelengths
        assert np.diff(nu) == pytest.approx(samples.step)
        assert nu[[0, -1]] == pytest.approx(C / LAM + span * DNU * np.array([-1, 1]))
        assert samples.weights.sum() == pytest.approx(1)
        grid = np.linspace(0, path, 3001)
        direct = np.abs(samples.weights @ np.exp(-2j * np.pi * nu[:, None] * grid / C))
        np.testing.assert_allclose(np.abs(samples.gamma(grid / C)), direct, atol=1e-12)
        near = np.array([[1e-6, -2e-6], [0, 3e-6]]) / C
        np.testing.assert_allclose(samples.gamma(near), led().gamma(near), atol=1e-4)
        assert error == pytest.approx(np.abs(direct - led().degree(grid)).max(), rel=2e-2)


def test_revival():
    samples = led().sample(9)
    assert samples.revival == pytest.approx(C / (4 * DNU / 8))
    assert abs(samples.gamma(samples.revival / C)) == pytest.approx(1)
    assert led().degree(samples.revival) < 1e-6
    fine = led().sample(400)
    assert led().error(400, 1.03 * fine.revival) > 0.999  # a peak of 9 um in a path of 1 mm
    assert led().sample(1).revival == 0
    assert led().sample(1).wavelengths == pytest.approx([LAM])
    assert math.isinf(Spectrum.mercury().sample(2).revival)


def test_needed_samples_do_not_revive():
    """1 + band (path + 1.5 l_c)/c samples: the revival is beyond the path by 1.5 l_c."""
    for spectrum, part in [
        (led(), 2),
        (Spectrum.rectangular(LAM, FWHM), 2),
        (lopsided(), 2),
        (Spectrum.mercury(fwhm=3e-9), 8),
    ]:
        path = 40e-6
        n = spectrum.needed(path)
        samples, length = spectrum.sample(n), spectrum.coherence_length()
        assert samples.revival >= path + 1.4 * length
        assert spectrum.sample(n // part).revival < path + 1.5 * length
        assert spectrum.needed(2 * path) > n
        assert spectrum.error(n, path) < 0.2 < 0.4 < spectrum.error(n // part, path)


def test_needed_of_a_gaussian_by_hand():
    """1 + 4 * .6643 * (3 + 1.5) = 12.96 within three coherence lengths."""
    assert led().needed(3 * led().coherence_length()) == 13
    assert led().needed(0.0, span=1.5) == 1 + math.ceil(3 * 0.66428 * 1.5)
    assert Spectrum.monochromatic(LAM).needed(1.0) == 1
    # Two lines, each with the samples of the wider one: 4 * 1e-9/400e-9^2 * 1e-3 + 4 * .6643 * 1.5
    assert Spectrum.lines([800e-9, 400e-9], [1, 1], fwhm=1e-9).needed(1e-3) == 2 * (1 + 29)


def test_samples_of_a_rectangle():
    samples = Spectrum.rectangular(LAM, FWHM).sample(5)
    assert (C / samples.wavelengths - C / LAM) / DNU == pytest.approx([-0.4, -0.2, 0, 0.2, 0.4])
    assert samples.weights.tolist() == [0.2] * 5
    assert samples.step == pytest.approx(DNU / 5)
    assert Spectrum.rectangular(LAM, FWHM).sample(1).revival == 0
    assert lopsided().sample(1).revival == 0


def test_lines_share_samples():
    light = Spectrum.lines([400e-9, 600e-9, 500e-9], [1, 5, 2], fwhm=1e-9)
    samples = light.sample(11)
    line = np.argmin(np.abs(samples.wavelengths[:, None] - [400e-9, 600e-9, 500e-9]), axis=1)
    assert np.bincount(line).tolist() == [3, 4, 4]
    assert np.bincount(line, samples.weights) == pytest.approx([1 / 8, 5 / 8, 2 / 8])
    # Three nodes lie sqrt(3) standard deviations apart; a FWHM is 2 sqrt(2 ln 2) of them.
    assert samples.step == pytest.approx(np.sqrt(3 / (8 * np.log(2))) * C * 1e-9 / 400e-9**2)
    sharp = Spectrum.lines([400e-9, 600e-9, 500e-9], [1, 3, 0]).sample(9)
    assert sharp.wavelengths == pytest.approx([400e-9, 600e-9])
    assert sharp.weights.tolist() == [0.25, 0.75]
    assert Spectrum.lines([400e-9, 600e-9], [1, 3]).error(1, 1e-3) == 0


def test_few_samples_of_a_gaussian():
    """Mean and width are kept, whatever the span; the errors of |gamma| are those documented."""
    for n, near, far in [
        (1, 0.325, 0.793),
        (2, 0.043, 0.292),
        (3, 0.0034, 0.127),
        (4, 2e-4, 0.029),
    ]:
        samples, length = led().sample(n, span=1.5), led().coherence_length()
        offset = (C / samples.wavelengths - C / LAM) / DNU
        assert samples.weights @ offset == pytest.approx(0, abs=1e-9)
        if n > 1:
            variance = samples.weights @ offset**2
            assert variance == pytest.approx(1 / (8 * np.log(2)), rel=1e-6)
        assert 0.9 * near < led().error(n, length / 2) < near
        assert 0.95 * far < led().error(n, length, span=1.5) < far


def test_samples_of_a_table_hold_its_power():
    """Each cell by its middle, with the power in it by quadrature; dark cells are left out."""
    spectrum, n = lopsided(), 13
    edges = np.linspace(C / 700e-9, C / 380e-9, n + 1)
    nu = np.linspace(edges[0], edges[-1], 13 * 40_000 + 1)
    density = spectrum.density((nu[1:] + nu[:-1]) / 2)
    power = density.reshape(n, -1).mean(axis=1) * (edges[1] - edges[0])
    lit = power > 1e-9
    assert lit.sum() < n
    samples = spectrum.sample(n)
    np.testing.assert_allclose(samples.weights, power[lit], atol=1e-6)
    np.testing.assert_allclose(C / samples.wavelengths, ((edges[1:] + edges[:-1]) / 2)[lit])
    assert samples.revival == pytest.approx(n / (1 / 380e-9 - 1 / 700e-9))


def airy(samples):
    """Airy pattern to 30 of its radii at 550 nm; 1/lam^2 as in the closed form."""
    v = AIRY * np.linspace(1e-9, 30, 3001)
    scale = LAM / samples.wavelengths[:, None]
    return samples.weights @ (scale * 2 * j1(v * scale) / (v * scale)) ** 2


def change(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def test_white_led():
    """Its image changes by less than 1e-3 when 9 samples become 18; its colour is that cited."""
    light = Spectrum.white_led()
    changes = [change(airy(light.sample(n)), airy(light.sample(2 * n))) for n in (9, 18, 36)]
    assert changes[0] < 1e-3
    assert changes[1] < changes[0] / 3
    assert changes[2] < changes[1] / 3
    nm, value = 1e9 * np.array(light.shape.wavelengths), np.array(light.shape.values)
    assert light.shape.wavelengths[0] == 380e-9
    x, y, z = (value @ part(nm) for part in (x_bar, y_bar, z_bar))
    # The paper states two digits; the fits of the observer are good to .005 (Wyman et al.).
    assert [x / (x + y + z), y / (x + y + z)] == pytest.approx([0.30, 0.31], abs=0.01)


def lobe(nm, centre, left, right):
    return np.exp(-(((nm - centre) * np.where(nm < centre, left, right)) ** 2) / 2)


def x_bar(nm):
    """CIE 1931 2 deg observer (Wyman, Sloan & Shirley, J. Comput. Graph. Tech. 2(2), 1 (2013))."""
    return (
        0.362 * lobe(nm, 442.0, 0.0624, 0.0374)
        + 1.056 * lobe(nm, 599.8, 0.0264, 0.0323)
        - 0.065 * lobe(nm, 501.1, 0.0490, 0.0382)
    )


def y_bar(nm):
    return 0.821 * lobe(nm, 568.8, 0.0213, 0.0247) + 0.286 * lobe(nm, 530.9, 0.0613, 0.0322)


def z_bar(nm):
    return 1.217 * lobe(nm, 437.0, 0.0845, 0.0278) + 0.681 * lobe(nm, 459.0, 0.0385, 0.0725)


def test_mercury():
    """Fraunhofer's e and the yellow pair in air are these over n = 1.000277."""
    samples = Spectrum.mercury().sample(9)
    air = 1e9 * samples.wavelengths / 1.000279
    for line in (404.6565, 435.8335, 546.0750, 576.9610, 579.0670):
        assert np.abs(air - line).min() < 2e-3
    assert samples.weights.sum() == pytest.approx(1)
    assert samples.weights.max() == pytest.approx(12000 / 32900)


def test_dark_ends_of_a_table_take_no_samples():
    """A lamp in a spectrometer's whole range: the band ends where the light does."""
    lam = np.arange(300e-9, 1100e-9, 1e-9)
    values = np.maximum(0, 1 - np.abs(lam - 550e-9) / 20.5e-9)
    narrow = np.abs(lam - 550e-9) < 21.5e-9
    assert Spectrum.tabulated(lam, values) == Spectrum.tabulated(lam[narrow], values[narrow])
    assert len(Spectrum.tabulated(lam, values).sample(9).weights) == 9
