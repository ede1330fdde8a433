"""The twins of coherent, partially coherent and incoherent light against printed numbers.

Figures and set-ups are those of section 9 of the design reference unless a comment says more.
"""

from __future__ import annotations

import numpy as np
import pytest
import reference_abbe as abbe
import reference_coherence as light
import reference_masks as masks
from tolerance import relative_max, snr_db

pytestmark = pytest.mark.nightly

LAM = 550e-9
WINDOW, DX, CELLS = 256, 2e-6, 32
CELL = WINDOW // CELLS  # samples
NEAR = (CELL * DX) ** 2 / LAM  # p^2/lam
LAG = np.rint(np.fft.fftfreq(WINDOW) * WINDOW)


def snapshots(count, seed=1, **settings):
    rng = np.random.default_rng(seed)
    make = {"pitch": DX, "wavelength": LAM} | settings
    return [masks.random_mask(rng, WINDOW, CELLS, **make) for _ in range(count)]


def rms(values):
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


@pytest.mark.parametrize(("kernel", "law"), [("square", "triangle"), ("gaussian", "gaussian")])
def test_degree_of_a_field_mask_is_the_autocorrelation_of_its_kernel(kernel, law):
    mu = masks.periodic_degree(snapshots(40, kernel=kernel, distance=NEAR))
    expected = getattr(masks, law)(LAG[:, None], LAG[None, :], CELL)
    assert rms(mu - expected) < 0.006  # printed: .002-.006 with 40 masks


@pytest.mark.parametrize("kernel", ["square", "gaussian"])
def test_degree_does_not_depend_on_the_distance(kernel):
    near, far = (
        masks.periodic_degree(snapshots(2, kernel=kernel, distance=d)) for d in (0, 8 * NEAR)
    )
    np.testing.assert_allclose(far, near, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kernel", ["square", "gaussian"])
def test_a_mask_has_unit_power_over_the_ensemble(kernel):
    power = np.mean([np.mean(np.abs(u) ** 2) for u in snapshots(20, kernel=kernel)])
    assert power == pytest.approx(1, abs=0.01)  # 20480 cells: 1/sqrt is .007


def test_square_cells_hold_their_source():
    sources = np.arange(9.0).reshape(3, 3)
    expected = np.array([[1, 2, 0, 0], [4, 5, 3, 3], [4, 5, 3, 3], [7, 8, 6, 6]])
    # 4 samples, cells of 4/3: sample i is in the cell floor(3 (i + shift)/4), taken modulo 3
    got = masks.square_cells(sources, 4, np.array([0.5, 2.0]))
    np.testing.assert_array_equal(got, expected)


def test_gaussian_cells_are_the_sum_of_gaussians():
    sources, size = np.exp(1j * np.arange(9.0).reshape(3, 3) ** 2), 30
    shift = np.array([1.3, 4.6])
    d = [np.arange(size)[None, :] + s - size / 3 * np.arange(3)[:, None] for s in shift]
    y, x = (
        sum(np.exp(-((v + size * k) ** 2) / (2 * (masks.SIGMA * 10) ** 2)) for k in range(-2, 3))
        for v in d
    )
    expected = y.T @ sources @ x
    got = masks.gaussian_cells(sources, size, shift)
    # The Gaussian is cut at Nyquist, where its spectrum is exp(-2 (pi sg/2)^2) = 1e-39.
    scale = expected[3, 5] / got[3, 5]
    assert scale.imag == pytest.approx(0, abs=1e-10)
    assert relative_max(expected, got * scale) < 1e-9


def test_power_spectrum_is_the_transform_of_the_degree():
    line = masks.mask_power(WINDOW, CELLS)
    triangle = masks.triangle(0, LAG, CELL)
    np.testing.assert_allclose(np.fft.fft(line), triangle, rtol=0, atol=1e-14)
    bell = np.fft.fft(masks.mask_power(WINDOW, CELLS, "gaussian"))
    np.testing.assert_allclose(bell, masks.gaussian(0, LAG, CELL), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("distance", "expected"),
    [(0, 0.0), (0.1, 0.62), (0.25, 0.81), (0.5, 1.03), (1, 0.79), (2, 0.944), (4, 0.985), (8, 1)],
)
def test_speckle_grows_with_the_distance(distance, expected):
    values = [masks.contrast(np.abs(u) ** 2) for u in snapshots(4, distance=distance * NEAR)]
    # One mask of 1024 cells scatters by .02 or so.
    assert np.mean(values) == pytest.approx(expected, abs=0.03)


def test_phase_only_law():
    expected = [0.07864, 0.23836, 0.40630, 0.59194, 0.82044]
    np.testing.assert_allclose(masks.phase_only([0.1, 0.3, 0.5, 0.7, 0.9]), expected, atol=6e-6)
    mu = masks.periodic_degree(snapshots(40, kind="phase", distance=4 * NEAR))
    kept = masks.triangle(LAG[:, None], LAG[None, :], CELL)
    near = np.ix_(np.abs(LAG) <= CELL, np.abs(LAG) <= CELL)
    assert rms((mu - masks.phase_only(kept))[near]) < 0.006
    assert rms((mu - kept)[near]) > 0.03


def test_jitter_removes_the_lattice():
    left = {}
    for jitter in (False, True):
        rng, total = np.random.default_rng(4), 0.0
        for _ in range(400):
            # p = 16 samples; 4 p^2/lam with DX for the pitch
            u = masks.random_mask(
                rng, 64, 4, pitch=DX, wavelength=LAM, distance=16 * NEAR, jitter=jitter
            )
            total = total + np.abs(u) ** 2
        left[jitter] = masks.contrast(total)
    assert left[True] < 1.2 / 20  # 1.2/sqrt M
    assert left[False] > 0.2


def extended(points, shape="disc", side=2e-3, count=400):
    rng = np.random.default_rng(6)
    optics = {"pitch": 4e-6, "source": side, "distance": 0.1, "wavelength": LAM, "shape": shape}
    return [masks.extended_snapshot(rng, 96, points, **optics) for _ in range(count)]


@pytest.mark.nightly
def test_van_cittert_zernike_disc():
    fields, lag = extended(200), np.arange(48)
    mu, expected = masks.window_degree(fields), masks.disc_degree(lag * 4e-6, 2e-3, 0.1, LAM)
    for line in (mu[0, :48], mu[:48, 0]):
        assert rms(line - expected) < 0.01
        assert np.max(np.abs(line - expected)) < 0.02
    mean = np.mean([np.abs(u) ** 2 for u in fields], axis=0)
    assert 0.85 < masks.contrast(mean) * 20 < 1.15
    zero = 1.2197 * LAM * 0.1 / 2e-3
    assert zero == pytest.approx(33.54e-6, abs=5e-9)
    # the slope .21 times pi times the rounding 5e-5 of 1.2197
    assert masks.disc_degree(zero, 2e-3, 0.1, LAM) == pytest.approx(0, abs=4e-5)


def test_van_cittert_zernike_square():
    mu, lag = masks.window_degree(extended(200, "square", count=200)), np.arange(24)
    expected = masks.square_degree(lag[:, None] * 4e-6, lag[None, :] * 4e-6, 2e-3, 0.1, LAM)
    assert rms(mu[:24, :24] - expected) < 0.02
    # sinc at (1, 0) differs from the disc: the test tells the shapes apart
    assert rms(expected[0] - masks.disc_degree(lag * 4e-6, 2e-3, 0.1, LAM)) > 0.05


def test_extended_snapshot_is_the_sum_of_fresnel_spheres():
    z, d, n, side, points = 0.1, 4e-6, 7, 1e-3, 5
    optics = {"pitch": d, "source": side, "distance": z, "wavelength": LAM, "shape": "square"}
    got = masks.extended_snapshot(np.random.default_rng(3), n, points, **optics)
    rng = np.random.default_rng(3)
    sy, sx = rng.uniform(-side / 2, side / 2, (2, points))
    phase = rng.uniform(-np.pi, np.pi, points)
    x = (np.arange(n) - 3) * d
    ry, rx = x[:, None, None] - sy, x[None, :, None] - sx
    waves = np.exp(1j * (phase + np.pi * (ry**2 + rx**2) / (LAM * z))).sum(-1)
    curved = np.exp(1j * np.pi * (x[:, None] ** 2 + x[None, :] ** 2) / (LAM * z))
    assert relative_max(waves / np.sqrt(points), got * curved) < 1e-10


@pytest.mark.nightly
def test_young_fringes_show_the_degree_of_coherence():
    fields = snapshots(60, distance=4 * NEAR)
    phase = np.linspace(0, 2 * np.pi, 721)
    for lag in (0, 1, 3, 5, 7, 9):
        pairs = np.stack([np.stack([u, np.roll(u, -lag, 1)], -1).reshape(-1, 2) for u in fields])
        pairs = pairs[:, ::37].reshape(-1, 2)
        expected = float(masks.triangle(0, lag, CELL))
        fringes = masks.young_fringes(pairs, phase[:-1:40])
        assert masks.visibility(fringes) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("mu", [0.0, 0.3, 0.6j, 0.5 - 0.5j, 1.0])
def test_closed_fringes_have_the_visibility_of_mu(mu):
    fringes = masks.closed_fringes(mu, np.linspace(0, 2 * np.pi, 3601))
    assert masks.visibility(fringes) == pytest.approx(abs(mu), abs=1e-5)
    assert fringes[:-1].mean() == pytest.approx(2)


def test_young_fringes_of_known_pairs_follow_the_closed_form():
    # u2 conj u1 = exp(.7i) in every pair: mu has phase .7 and full contrast
    start = np.exp(1j * np.arange(5.0))
    pairs = np.stack([start, start * np.exp(0.7j)], -1)
    phase = np.linspace(0, 6, 50)
    expected = masks.closed_fringes(np.exp(0.7j), phase)
    np.testing.assert_allclose(masks.young_fringes(pairs, phase), expected, atol=1e-12)


FC = 13636 * 10e-6  # cycles a sample of 10 um


def test_target_and_its_coherent_limit():
    target = abbe.three_bar_target()
    assert target.mean() == pytest.approx(0.04715, abs=5e-6)
    assert target.max() == 1
    incoherent = abbe.incoherent_image(target, FC)
    assert snr_db(incoherent, abbe.coherent_image(target, FC)) == pytest.approx(8.7, abs=0.05)


def test_target_in_the_light_of_small_cells():
    # 22.25 dB is the limit of the printed row 3.2 8.5 14.1 18.6 20.6 dB, which still rises.
    target, power = abbe.three_bar_target(), masks.mask_power(256, 128)
    lag = np.rint(np.fft.fftfreq(256) * 256)
    mu = masks.triangle(lag[:, None], lag[None, :], 2)
    exact = abbe.correlation_image(target, mu, FC)
    assert snr_db(abbe.incoherent_image(target, FC), exact) == pytest.approx(22.25, abs=0.01)
    assert abbe.clear_transmission(power, FC) == pytest.approx(0.2126, abs=5e-4)
    rng, total, count = np.random.default_rng(5), 0.0, 25
    for _ in range(count):
        u = masks.random_mask(
            rng, 256, 128, pitch=10e-6, wavelength=LAM, distance=4 * (20e-6) ** 2 / LAM
        )
        total = total + abbe.coherent_image(u * target, FC)
    error = np.linalg.norm(total / count - exact) / np.linalg.norm(exact)
    assert 0.7 < error * np.sqrt(count) < 1.15
    assert snr_db(abbe.incoherent_image(target, FC), total) == pytest.approx(14.1, abs=1)


@pytest.mark.parametrize("cells", [4, 12, 24])
def test_abbe_agrees_with_the_sum_over_lags(cells):
    n, target = 48, np.zeros((48, 48))
    target[10:13, 5:30], target[20:40, 30:34], target[25, 7:12] = 1, 0.5, 0.7
    lag = np.rint(np.fft.fftfreq(n) * n)
    mu = masks.triangle(lag[:, None], lag[None, :], n / cells)
    power = masks.mask_power(n, cells)
    expected = abbe.correlation_image(target, mu, 0.11)
    assert relative_max(expected, abbe.abbe_image(target, power, 0.11)) < 1e-13
    clear = abbe.abbe_image(np.ones((n, n)), power, 0.11)
    np.testing.assert_allclose(clear, abbe.clear_transmission(power, 0.11), rtol=1e-12)


def test_abbe_ends_at_the_coherent_and_the_incoherent_image():
    n, target = 40, np.zeros((40, 40))
    target[8:20, 11:17], target[25:27, 5:9] = 1, 0.6
    point, even = np.eye(1, n)[0], np.full(n, 1 / n)
    coherent = abbe.abbe_image(target, point, 0.12)
    assert relative_max(abbe.coherent_image(target, 0.12), coherent) < 1e-12
    incoherent = abbe.abbe_image(target, even, 0.12) / abbe.clear_transmission(even, 0.12)
    assert relative_max(abbe.incoherent_image(target**2, 0.12), incoherent) < 1e-12


@pytest.mark.parametrize(
    ("cells", "kind", "expected"),
    # Printed c1 of phase masks; field masks .98, measured with 300 snapshots of this set-up.
    [(8, "phase", 0.284), (32, "phase", 0.538), (128, "phase", 0.934), (32, "field", 0.98)],
)
def test_contrast_of_one_clear_snapshot(cells, kind, expected):
    rng, found = np.random.default_rng(8), []
    far = 4 * (2.56e-3 / cells) ** 2 / LAM
    optics = {"pitch": 10e-6, "wavelength": LAM, "distance": far, "kind": kind}
    for _ in range(10):
        u = masks.random_mask(rng, 256, cells, **optics)
        found.append(masks.contrast(abbe.coherent_image(u, FC)))
    assert np.mean(found) == pytest.approx(expected, rel=0.04)


def test_edges_in_closed_form():
    np.testing.assert_allclose(
        abbe.coherent_edge([0, 0.25, 0.5, 0.10614], 1), [0.25, 0.87671, 1.18699, 0.5], atol=6e-6
    )
    np.testing.assert_allclose(
        abbe.incoherent_edge([0, 0.25, 0.5, 1], 1), [0.5, 0.845445, 0.939089, 0.968396], atol=6e-7
    )
    for shape, slope in (("circle", 1.69765), ("slit", 2.0)):
        rise = np.diff(abbe.incoherent_edge([-1e-4, 1e-4], 1, shape))[0] / 2e-4
        assert rise == pytest.approx(slope, abs=1e-5)
    # ends of the printed 10-90 widths .6664, .5348: the incoherent edge is odd about 1/2
    for shape, width in (("circle", 0.6664), ("slit", 0.5348)):
        assert abbe.incoherent_edge(width / 2, 1, shape) == pytest.approx(0.9, abs=1e-4)


def test_edges_through_a_sampled_pupil():
    coherent, incoherent = abbe.filtered_edge(512, 1 / 16)
    assert coherent[256] == pytest.approx(0.25, abs=5e-6)
    assert incoherent[256] == pytest.approx(0.5, abs=5e-6)
    x = np.arange(-64, 65)  # |fc x| <= 4; further out the other edge of the window is seen
    got = slice(192, 321)
    assert np.max(np.abs(coherent[got] - abbe.coherent_edge(x, 1 / 16))) < 3.45e-3
    assert np.max(np.abs(incoherent[got] - abbe.incoherent_edge(x, 1 / 16))) < 1.6e-3


@pytest.mark.parametrize(
    ("iota", "edge", "peak", "passed"),
    [
        (0.1, 0.254, 1.167, 0.97),
        (0.25, 0.262, 1.143, 0.92),
        (0.5, 0.270, 1.104, 0.84),
        (1, 0.334, 0.997, 0.68),
        (2, 0.411, 0.994, 0.27),
        (4, 0.451, 0.993, 0.085),
    ],
)
def test_partially_coherent_edge(iota, edge, peak, passed):
    image, transmission = abbe.partial_edge(iota)
    assert image[256] == pytest.approx(edge, abs=6e-4)
    assert image[256:].max() == pytest.approx(peak, abs=8e-4)
    assert transmission == pytest.approx(passed, abs=0.005)


def test_partial_edge_is_the_two_dimensional_abbe_sum():
    n, samples, iota = 64, 8, 0.8
    power = np.sinc(0.61 / iota * samples * np.fft.fftfreq(n)) ** 2
    power /= power.sum()
    target = np.tile(abbe.half_plane(n), (n, 1))
    full = abbe.abbe_image(target, power, 1 / samples)
    image, passed = abbe.partial_edge(iota, n, samples)
    assert passed == pytest.approx(abbe.clear_transmission(power, 1 / samples), rel=1e-12)
    assert relative_max(np.tile(image, (n, 1)), full / passed) < 1e-12


def test_gratings_end_at_the_cut_offs():
    n, fc = 512, 1 / 16
    lines = [29, 35, 48, 61, 67]  # .91, 1.09, 1.5, 1.91, 2.09 of fc
    expected = [0.444, 0.340, 0.143, 0.010, 0]
    np.testing.assert_allclose(abbe.otf(n, fc)[0, lines], expected, rtol=0, atol=5e-4)
    closed = abbe.closed_otf(np.array(lines) / n, fc)
    # 32 samples to fc: the sampled circle has the area of the true one to .3 %
    np.testing.assert_allclose(closed, expected, rtol=0, atol=3e-3)
    for k, seen in ((29, 1), (35, 0)):
        bars = 0.5 + 0.5 * np.cos(2 * np.pi * k * np.arange(n) / n)
        image = abbe.coherent_image(np.tile(bars, (n, 1)), fc)[0]
        assert masks.visibility(image) == pytest.approx(seen, abs=1e-9)


def test_coherence_lengths():
    for name, factor, length in (
        ("goodman", 0.6643, 6.698e-6),
        ("fwhm", 0.8825, 8.899e-6),
        ("oct", 0.4413, 4.449e-6),
    ):
        exact = light.COHERENCE_LENGTHS[name]
        assert exact == pytest.approx(factor, abs=6e-5)
        assert exact * LAM**2 / 30e-9 == pytest.approx(length, abs=1.1e-9)
    path = np.linspace(-40e-6, 40e-6, 4001)
    gamma = light.gaussian_gamma(path, LAM, 30e-9)
    step = path[1] - path[0]
    assert np.sum(gamma**2) * step == pytest.approx(6.698e-6, abs=1e-9)
    assert light.gaussian_gamma(8.8985e-6 / 2, LAM, 30e-9) == pytest.approx(0.5, abs=2e-4)


@pytest.mark.parametrize(
    ("n", "half", "low", "high"),
    [(15, 2, 3e-4, 3.2e-4), (21, 2, 1e-6, 1.2e-6), (9, 1.5, 0.19, 0.21)],
)
def test_sampled_gamma(n, half, low, high):
    path = np.linspace(0, 3 * 6.698e-6, 2001)
    samples = light.gaussian_samples(n, LAM, 30e-9, half)
    got = np.abs(light.sampled_gamma(path, *samples, centre=light.C / LAM))
    error = np.max(np.abs(got - light.gaussian_gamma(path, LAM, 30e-9)))
    assert low < error < high


def test_rectangular_gamma_is_the_limit_of_even_samples():
    path, centre = np.linspace(0, 30e-6, 200), light.C / LAM
    n, width = 4000, light.frequency_width(LAM, 30e-9)
    even = centre + width * ((np.arange(n) + 0.5) / n - 0.5)
    got = np.abs(light.sampled_gamma(path, even, np.full(n, 1 / n), centre=centre))
    np.testing.assert_allclose(got, light.rectangular_gamma(path, LAM, 30e-9), atol=1e-6)


@pytest.mark.parametrize(("n", "printed"), [(3, 7e-4), (5, 4e-5), (9, 6e-7)])
def test_polychromatic_airy(n, printed):
    radius = np.linspace(0, 30 * 1.2197 * LAM, 4001)

    def image(count, half):
        samples = light.gaussian_samples(count, LAM, 30e-9, half)
        return light.polychromatic_airy(radius, *samples, centre=light.C / LAM, f_number=1)

    reference = image(401, 3)
    error = np.linalg.norm(image(n, 1.5) - reference) / np.linalg.norm(reference)
    assert error == pytest.approx(printed, rel=0.05)
