"""Point spread functions against the closed forms of circular and square apertures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference_closed import airy
from scipy.optimize import brentq
from scipy.special import j0, j1

from clplen.analysis.point.psf import PSF
from clplen.errors import ShapeError
from clplen.wave.field.field import Grid

UNIT = 3e-6  # lam F/D in metres; the incoherent Nyquist pitch is half of it
CENTRE = (4.1e-6, -2.7e-6)
# (shape, pitch in units, origin in metres): odd, even, prime, rectangular, dy != dx, off-centre
WINDOWS = [
    ((201, 163), (0.31, 0.42), (0.5e-6, -0.3e-6)),
    ((160, 240), (0.45, 0.23), (-1.7e-6, 0.0)),
]
Window = tuple[tuple[int, int], tuple[float, float], tuple[float, float]]


def grid_of(window: Window) -> Grid:
    shape, (dy, dx), origin = window
    return Grid(shape, (dy * UNIT, dx * UNIT), origin=origin)


def airy_psf(window: Window) -> PSF:
    """(2 J1(v)/v)^2, v = pi r/UNIT, about CENTRE; its integral is 4/pi UNIT^2."""
    grid = grid_of(window)
    r = np.hypot.outer(grid.y - CENTRE[0], grid.x - CENTRE[1]) / UNIT
    return PSF(7 * airy(np.pi * r) ** 2, grid.pitch, grid.origin)


def square_psf(window: Window) -> PSF:
    """sinc^2 along both axes; its integral is UNIT^2."""
    grid = grid_of(window)
    y, x = (np.sinc((c - m) / UNIT) ** 2 for c, m in zip((grid.y, grid.x), CENTRE, strict=True))
    return PSF(np.multiply.outer(y, x), grid.pitch, grid.origin)


def gaussian(window: Window, sigma: tuple[float, float]) -> PSF:
    grid = grid_of(window)
    lines = [
        np.exp(-((c - m) ** 2) / (2 * s**2))
        for c, m, s in zip((grid.y, grid.x), CENTRE, sigma, strict=True)
    ]
    return PSF(np.multiply.outer(*lines), grid.pitch, grid.origin)


def test_the_centroid_of_the_intensity_squared_is_the_centre() -> None:
    window = WINDOWS[0]
    for psf in (airy_psf(window), square_psf(window)):  # tails end with the window: 1e-5 of UNIT
        np.testing.assert_allclose(psf.centroid(), CENTRE, atol=1e-4 * UNIT)
    wide = gaussian(window, (1.9 * UNIT, 1.1 * UNIT))
    np.testing.assert_allclose(wide.centroid(1), CENTRE, atol=1e-9 * UNIT)
    np.testing.assert_allclose(wide.centroid(), CENTRE, atol=1e-9 * UNIT)


def test_the_peak_lies_between_samples() -> None:
    window = WINDOWS[1]
    assert airy_psf(window).peak == pytest.approx(7, rel=1e-5)  # 1/512 sample, and the window
    assert square_psf(window).peak == pytest.approx(1, rel=1e-5)
    assert airy_psf(window).values.max() < 6.97


@pytest.mark.parametrize(("window", "axis"), [(WINDOWS[0], 0), (WINDOWS[1], 1)])
def test_widths_at_half_maximum(window: Window, axis: int) -> None:
    # straight lines between 16 samples for one: 5e-4 at the coarsest pitch of .45
    assert airy_psf(window).fwhm(axis) == pytest.approx(1.028994 * UNIT, rel=6e-4)
    assert square_psf(window).fwhm(axis) == pytest.approx(0.885893 * UNIT, rel=6e-4)
    sigma = (1.9 * UNIT, 1.1 * UNIT)
    width = 2 * math.sqrt(2 * math.log(2)) * sigma[axis]
    assert gaussian(window, sigma).fwhm(axis) == pytest.approx(width, rel=2e-4)


@pytest.mark.parametrize(("axis", "oversampling"), [(0, 5), (1, 1)])
def test_profiles_and_line_spreads_of_a_gaussian(axis: int, oversampling: int) -> None:
    sigma = (1.9 * UNIT, 1.1 * UNIT)
    psf = gaussian(WINDOWS[0], sigma)
    x, line = psf.profile(axis, oversampling=oversampling)
    expected = np.exp(-((x - CENTRE[axis]) ** 2) / (2 * sigma[axis] ** 2))
    np.testing.assert_allclose(line, expected, atol=1e-9)
    assert x.size == (psf.values.shape[axis] - 1) * oversampling + 1
    again, spread = psf.line_spread(axis, oversampling=oversampling)
    np.testing.assert_array_equal(again, x)
    other = math.sqrt(2 * math.pi) * sigma[1 - axis]
    np.testing.assert_allclose(spread, other * expected, atol=1e-9 * other)
    beside = (CENTRE[0] + sigma[0], CENTRE[1] + sigma[1])
    _, lower = psf.profile(axis, centre=beside, oversampling=oversampling)
    np.testing.assert_allclose(lower, math.exp(-0.5) * expected, atol=1e-9)


def test_encircled_energy_of_airy_s_pattern() -> None:
    # 1 - J0^2 - J1^2 (Born and Wolf 1999, section 8.5, eq. 18), its tails cut by the window
    psf, total = airy_psf(WINDOWS[0]), 7 * 4 / np.pi * UNIT**2
    r = np.array([[0.0, 0.3, 0.6], [1.2197, 2.0, 6.1]])
    held = psf.encircled_energy(r * UNIT, total=total)
    v = np.pi * r
    np.testing.assert_allclose(held, 1 - j0(v) ** 2 - j1(v) ** 2, atol=3e-6)
    r = np.linspace(0, 18, 301) * UNIT
    v = np.pi * r / UNIT
    held = psf.encircled_energy(r, total=total)
    np.testing.assert_allclose(held, 1 - j0(v) ** 2 - j1(v) ** 2, atol=3e-6)
    assert np.diff(held).min() >= 0
    assert psf.energy / total == pytest.approx(0.993, abs=5e-3)
    of_window = psf.encircled_energy(UNIT)
    assert of_window == pytest.approx((1 - j0(np.pi) ** 2 - j1(np.pi) ** 2) * total / psf.energy)
    assert isinstance(of_window, float)


def integral_of(psf: PSF, r: np.ndarray, centre: tuple[float, float]) -> np.ndarray:
    """Over circles, of the Fourier interpolation: every frequency by itself."""
    spectrum = np.fft.fft2(psf.values) / psf.values.size
    fy, fx = (np.fft.fftfreq(n, d) for n, d in zip(psf.values.shape, psf.pitch, strict=True))
    y, x = centre[0] - psf.coordinates(0)[0], centre[1] - psf.coordinates(1)[0]
    at = np.real(spectrum * np.exp(2j * np.pi * (fy[:, None] * y + fx * x)))
    f = np.hypot.outer(fy, fx)
    flat = f == 0
    disc = [np.where(flat, np.pi * s**2, s * j1(2 * np.pi * s * f) / (f + flat)) for s in r]
    return np.einsum("kij,ij->k", np.array(disc), at)


def unlike_images() -> dict[str, PSF]:
    """What a point's image may be, and what it should not: as `analyse` and users bring them."""
    random = np.random.default_rng(12)
    y, x = np.mgrid[0:41, 0:37] - np.array([19.3, 18.6])[:, None, None]
    spot = np.exp(-(y**2 + x**2) / (2 * 2.1**2))
    lone = np.zeros((17, 23))
    lone[8, 11] = 1
    return {
        "noise": PSF(spot + 0.02 * random.normal(size=spot.shape), 2e-6),
        "background taken off too much": PSF(spot - 0.012, 2e-6),
        "noise alone": PSF(random.normal(size=(19, 24)) + 0.05, (2e-6, 1.3e-6)),
        "one pixel": PSF(lone, (1e-6, 3e-6)),
        "a hot pixel in the rim": PSF(
            spot + 0.4 * ((y > 15) & (y < 16) & (x > 9) & (x < 10)), 2e-6
        ),
        "photons": PSF(random.poisson(spot * 9).astype(float), (3e-6, 2e-6)),
    }


def test_shares_never_fall_and_follow_the_largest_circle() -> None:
    for name, psf in unlike_images().items():
        centre = psf.centroid()
        y, x = psf.coordinates(0), psf.coordinates(1)
        far = min(
            min(centre[0] - y[0], y[-1] - centre[0]) + psf.pitch[0] / 2,
            min(centre[1] - x[0], x[-1] - centre[1]) + psf.pitch[1] / 2,
        )
        r = np.sort(np.append(np.random.default_rng(13).uniform(0, far, 997), [0, far]))
        fine = np.linspace(0, far, 1500)
        exact = integral_of(psf, fine, centre)
        if name in ("noise alone", "one pixel", "background taken off too much"):
            assert np.diff(exact).min() < -1e-5 * psf.energy  # it would fall
        upper = np.maximum.accumulate(exact) / psf.energy
        got = psf.encircled_energy(fine, centre=centre)
        # steps of 1/16 sample may miss the top between them: E'' h^2/8
        assert np.abs(got - upper).max() <= 2e-3 * max(1, upper.max())
        assert got[0] == 0
        shares = psf.encircled_energy(r, centre=centre)
        assert np.diff(shares).min() >= 0
        few = r[:: r.size // 7]
        alone = np.array([psf.encircled_energy(one, centre=centre) for one in few])
        assert np.diff(alone).min() >= -1e-14  # sums in another order
        widths = psf.ensquared_energy(2 * r, centre=centre)
        assert np.diff(widths).min() >= 0
        assert widths[-1] >= 0.9 * shares[-1]


def test_pixels_partly_in_a_circle_count_with_that_part() -> None:
    for place in [(2.3e-6, -1.1e-6), (0.9e-6, 5.2e-6)]:
        flat = PSF(np.full((13, 22), 3.7), (2e-6, 1.4e-6))
        r = np.array([0.1, 0.77, 1.9, 3.33, 7.0]) * 1e-6
        area = flat.values.size * 2e-6 * 1.4e-6
        held = flat.encircled_energy(r, centre=place)
        np.testing.assert_allclose(held, np.pi * r**2 / area, rtol=1e-7)
        squares = flat.ensquared_energy(r, centre=place)
        np.testing.assert_allclose(squares, r**2 / area, rtol=1e-7)


def test_the_radius_holds_its_share() -> None:
    psf, total = airy_psf(WINDOWS[0]), 7 * 4 / np.pi * UNIT**2
    for share in (0.5, 0.8378):
        r = brentq(lambda r, s=share: 1 - j0(np.pi * r) ** 2 - j1(np.pi * r) ** 2 - s, 0.01, 5)
        assert psf.radius(share, total=total) == pytest.approx(r * UNIT, rel=1e-4)


def test_ensquared_energy_of_a_gaussian_and_of_a_square_aperture() -> None:
    sigma = (1.9 * UNIT, 1.1 * UNIT)
    psf = gaussian(WINDOWS[1], sigma)
    widths = np.array([0.0, 2.0, 4.7]) * UNIT
    inside = [math.erf(w / (8**0.5 * sigma[0])) * math.erf(w / (8**0.5 * sigma[1])) for w in widths]
    np.testing.assert_allclose(psf.ensquared_energy(widths), inside, atol=1e-9)
    moved = (CENTRE[0] + sigma[0], CENTRE[1])
    w = 2 * sigma[0]
    of_y = math.erf(2 / 2**0.5) / 2  # from the Gaussian's middle to 2 sigma
    of_x = math.erf(w / (8**0.5 * sigma[1]))
    assert psf.ensquared_energy(w, centre=moved) == pytest.approx(of_y * of_x, abs=1e-9)
    square = square_psf(WINDOWS[0])  # 0.9028 of a sinc^2 lies in its main lobe, per axis
    held = square.ensquared_energy(2 * UNIT, total=UNIT**2)
    assert held == pytest.approx(0.902823**2, abs=1e-5)


def test_strehl_is_the_ratio_of_peaks_of_equal_energy() -> None:
    sharp = gaussian(WINDOWS[0], (1.2 * UNIT, 0.8 * UNIT))
    blunt = gaussian(WINDOWS[1], (1.8 * UNIT, 1.0 * UNIT))
    brighter = PSF(3.7 * blunt.values, blunt.pitch, blunt.origin)
    # a Gaussian of these widths goes through half a cycle a sample with less than 1e-6
    assert brighter.strehl(sharp) == pytest.approx(1.2 * 0.8 / (1.8 * 1.0), rel=1e-5)


def test_a_window_keeps_its_coordinates() -> None:
    for shape in [(9, 12), (14, 7)]:
        psf = gaussian(WINDOWS[0], (1.9 * UNIT, 1.1 * UNIT))
        part = psf.cut(CENTRE, shape)
        assert part.values.shape == shape
        for axis in (0, 1):
            middle = part.coordinates(axis)[shape[axis] // 2]
            assert abs(middle - CENTRE[axis]) <= psf.pitch[axis] / 2
        y, x = np.meshgrid(part.coordinates(0), part.coordinates(1), indexing="ij")
        expected = np.exp(
            -((y - CENTRE[0]) ** 2) / (2 * (1.9 * UNIT) ** 2)
            - (x - CENTRE[1]) ** 2 / (2 * (1.1 * UNIT) ** 2)
        )
        np.testing.assert_allclose(part.values, expected, rtol=1e-9)


def test_bad_input_is_told() -> None:
    good, nan = np.ones((8, 8)), np.where(np.eye(8) * np.arange(8) == 5, np.nan, 1)
    psf = gaussian(WINDOWS[0], (1.9 * UNIT, 1.1 * UNIT))
    for call, error, words in (
        (lambda: PSF(np.ones((3, 9)), 1e-6), ShapeError, r"at least 4 samples .* got \(3, 9\)"),
        (lambda: PSF(np.ones((8, 8, 3)), 1e-6), ShapeError, "shape"),
        (lambda: PSF(nan, 1e-6), ValueError, "1 samples that are NaN"),
        (lambda: PSF(-good, 1e-6), ValueError, "must be positive"),
        (lambda: PSF(good * 1j, 1e-6), ValueError, r"abs\(amplitude\)"),
        (lambda: PSF(good, (1e-6, 0.0)), ValueError, "pitch must be positive"),
        (lambda: psf.fwhm(2), ValueError, "axis must be 0"),
        (lambda: PSF(good, 1e-6).fwhm(0), ValueError, "does not fall to half"),
        (lambda: psf.encircled_energy([UNIT, 1.0]), ValueError, "wider window"),
        (lambda: psf.ensquared_energy(-UNIT), ValueError, "between 0 and"),
        (lambda: psf.radius(0.5, total=1.0), ValueError, "largest circle"),
        (lambda: psf.radius(1.5), ValueError, "between 0 and 1"),
        (lambda: psf.cut((1.0, 0.0), (5, 5)), ValueError, "does not lie within"),
        (lambda: psf.profile(0, centre=(math.nan, 0.0)), ValueError, "centre must be finite"),
        (lambda: psf.profile(0, oversampling=0), ValueError, "oversampling"),
        (lambda: psf.centroid(0), ValueError, "power"),
    ):
        with pytest.raises(error, match=words):
            call()
    for place in ((0, 80), (200, 80), (100, 0), (100, 162)):  # samples at all four borders
        centre = (psf.coordinates(0)[place[0]], psf.coordinates(1)[place[1]])
        assert psf.encircled_energy(0.1 * UNIT, centre=centre) < 1e-6
        with pytest.raises(ValueError, match="wider window"):
            psf.encircled_energy(0.3 * UNIT, centre=centre)
