"""Extended sources: van Cittert and Zernike, snapshots, spectra, bad input."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen.errors import SamplingError, SamplingWarning
from clplen.wave.coherence.degree import DegreeEstimator
from clplen.wave.coherence.extended_source import ExtendedSource
from clplen.wave.coherence.spatial_models import uniform
from clplen.wave.field.field import Grid

WAVELENGTH = 550e-9
SNAPSHOTS = 400
# section 9.1: first zero of the disc at 33.54 um
WINDOW = Grid((96, 96), 4e-6)
# no symmetry: a flip of an axis or a swap of the two shows in mu
LETTER = np.array([[0.0, 2.0, 1.0, 0.0], [5.0, 0.5, 0.0, 0.0], [0.0, 0.0, 3.0, 0.2]])


def snapshots(source, grid, device, count, seed=11):
    for index in range(count):
        yield source.field(grid, wavelength=WAVELENGTH, device=device, seed=seed, index=index)


def estimated(source, device):
    estimator = DegreeEstimator(WINDOW, reach=(48, 48))
    for field in snapshots(source, WINDOW, device, SNAPSHOTS):
        estimator.add(field)
    return estimator


def check_degree(estimator, source, lags):
    """Section 9.1: rms <= .01 and max <= .02 over 48 lags."""
    dy, dx = lags
    expected = source.degree(4e-6 * dy, 4e-6 * dx, wavelength=WAVELENGTH)
    wrong = np.abs(estimator.degree(dy, dx) - expected)
    assert np.sqrt(np.mean(wrong**2)) <= 0.01
    assert wrong.max() <= 0.02


def test_snapshots_have_the_degree_of_their_source(device):
    lags = np.arange(1, 49)
    for shape in ("circular", "square"):
        source = ExtendedSource(2e-3, 0.1, shape=shape, points=200)
        check_degree(estimated(source, device), source, (0 * lags, lags))
    # bright parts on a sixth of the area: 4 mm for speckles as small as those of the disc
    source = ExtendedSource(4e-3, 0.1, picture=LETTER, points=250)
    estimator = estimated(source, device)
    for axis in ((0 * lags, lags), (lags, 0 * lags), (lags, lags), (lags, -lags)):
        check_degree(estimator, source, axis)
    # the pictures that a flip would make are far from it
    for other in (LETTER[::-1], LETTER[:, ::-1], LETTER[::-1, ::-1]):
        flipped = ExtendedSource(4e-3, 0.1, picture=other)
        with pytest.raises(AssertionError):
            check_degree(estimator, flipped, (lags, lags))


def test_degree_of_a_picture_is_its_sum():
    source = ExtendedSource(2e-3, 0.1, picture=LETTER)
    fine = 40  # points along a pixel: midpoint rule, error (pi/40)^2/24 of the highest fringe
    cell = 2e-3 / 4 / fine
    p = np.kron(LETTER, np.ones((fine, fine)))
    y, x = ((np.arange(n) - (n - 1) / 2) * cell for n in p.shape)
    for dy, dx in ((0.0, 11e-6), (7e-6, 0.0), (-9e-6, 13e-6), (30e-6, 21e-6)):
        wave = np.exp(-2j * np.pi * (dy * y[:, None] + dx * x) / (WAVELENGTH * 0.1))
        expected = np.sum(p * wave) / p.sum()
        got = source.degree(dy, dx, wavelength=WAVELENGTH)
        assert got == pytest.approx(expected, abs=2e-4)


# Snapshots


def test_one_point_is_a_fresnel_wave(device, precise):
    """A lit pixel: the wave's slopes name a place in that pixel, and the rest follows."""
    for shape in [(24, 35), (31, 18)]:
        grid = Grid(shape, (5e-6, 4e-6), origin=(0.4e-3, -0.3e-3))
        picture = np.zeros((3, 4))
        picture[0, 3] = 2
        size, d = 2e-3, 0.1
        plain, curved = (
            ExtendedSource(size, d, picture=picture, points=1, curved=c) for c in (False, True)
        )
        for index in range(5):
            settings = {"wavelength": WAVELENGTH, "seed": 5, "index": index}
            u = plain.field(grid, device=precise, **settings).to_numpy()
            step_y, step_x = u[1, 0] / u[0, 0], u[0, 1] / u[0, 0]
            s_y = -np.angle(step_y) / (2 * np.pi * 5e-6) * WAVELENGTH * d
            s_x = -np.angle(step_x) / (2 * np.pi * 4e-6) * WAVELENGTH * d
            assert -0.75e-3 <= s_y <= -0.25e-3  # row 0 of three: smallest y
            assert 0.5e-3 <= s_x <= 1e-3
            r2 = (grid.y[:, None] - s_y) ** 2 + (grid.x - s_x) ** 2
            fresnel = np.exp(1j * np.pi * r2 / (WAVELENGTH * d))
            v = curved.field(grid, device=precise, **settings).to_numpy()
            assert relative_max(fresnel * v[0, 0] / fresnel[0, 0], v) <= 1e-9
            # rounding of tables and products
            single = curved.field(grid, device=device, **settings).to_numpy()
            assert relative_max(v, single.astype(np.complex128)) <= 6e-7


def test_devices_and_precisions_agree(device, precise):
    grid = Grid((37, 50), (5e-6, 4e-6), origin=(1e-3, -2e-3))
    for source in (
        ExtendedSource(2e-3, 0.1),
        ExtendedSource(2e-3, 0.1, shape="square"),
        ExtendedSource(2e-3, 0.1, picture=LETTER, points=77),
    ):
        settings = {"wavelength": WAVELENGTH, "seed": 2**40 + 3, "index": 6}
        u = source.field(grid, device=precise, **settings).to_numpy()
        # sums of 400 rounded products
        single = source.field(grid, device=device, **settings).to_numpy()
        assert relative_max(u, single.astype(np.complex128)) <= 1e-6
    # the last one, by its points: what every device makes
    draws = uniform(2**40 + 3, 6, 2, 77)
    cells = np.searchsorted(np.cumsum(LETTER), draws[:, 3] * LETTER.sum(), side="right")
    y = (cells // 4 - 1.5 + draws[:, 0]) * 0.5e-3
    x = (cells % 4 - 2 + draws[:, 1]) * 0.5e-3
    turns = -(np.multiply.outer(grid.y, y)[:, None] + np.multiply.outer(grid.x, x))
    turns = turns / (WAVELENGTH * 0.1) + draws[:, 2]
    assert relative_max(np.exp(2j * np.pi * turns).sum(-1) / np.sqrt(77), u) <= 1e-11


def test_a_dark_pixel_sends_no_point():
    """The first pixel is dark: not even a draw of 0 falls into it, nor one below 1 off the end."""
    source = ExtendedSource(4e-3, 0.1, picture=LETTER)
    draws = np.array([[0.25, 0.5, 0, 0.0], [0.25, 0.5, 0, 1 - 2**-32]])
    # (row - 1.5, column - 2) pixels of 1 mm
    np.testing.assert_allclose(source._positions(draws), [(-1.25e-3, -0.5e-3), (0.75e-3, 1.5e-3)])


# Spectra


def test_spectrum_is_the_source_on_the_lattice():
    for source in [
        ExtendedSource(2e-3, 0.1),
        ExtendedSource(1.7e-3, 0.1, shape="square"),
        ExtendedSource(2e-3, 0.1, picture=LETTER),
    ]:
        grid = Grid((41, 52), (9e-6, 7e-6))
        got = source.power_spectrum(grid, wavelength=WAVELENGTH)
        assert got.shape == grid.shape
        assert got.min() >= 0
        assert got.sum() == pytest.approx(1, abs=1e-12)
        # points of the source counted in the lattice's cells
        n = 600 if source.picture is None else 150
        place = (np.arange(n) + 0.5) / n - 0.5
        if source.picture is not None:
            p = np.kron(LETTER, np.ones((n, n)))
            y, x = ((np.arange(m) + 0.5 - m / 2) * source.size / 4 / n for m in p.shape)
        else:
            y = x = place * source.size
            p = np.ones((n, n))
            if source.shape == "circular":
                p = (y[:, None] ** 2 + x**2 <= source.size**2 / 4).astype(float)
        rows, columns = (
            np.rint(-s / (WAVELENGTH * 0.1) * m * d).astype(int) % m
            for s, m, d in zip((y, x), grid.shape, grid.pitch, strict=True)
        )
        counted = np.zeros(grid.shape)
        np.add.at(counted, (rows[:, None], columns[None, :]), p / p.sum())
        # counting misses half a point along each rim of a cell, one in 40: .02 of a cell
        np.testing.assert_allclose(got, counted, atol=0.05 * got.max())
        # and its transform is mu, smoothed over a cell: times sinc(lag/W), aliases aside
        lags = np.arange(-5, 6)
        smooth = np.sinc(lags / 41)[:, None] * np.sinc(lags / 52)
        expected = smooth * source.degree(lags[:, None] * 9e-6, lags * 7e-6, wavelength=WAVELENGTH)
        wave = [np.exp(2j * np.pi * np.multiply.outer(lags, np.arange(m)) / m) for m in grid.shape]
        np.testing.assert_allclose(wave[0] @ got @ wave[1].T, expected, atol=0.01)


def test_spectrum_of_a_line_is_the_projection():
    for picture in [None, LETTER]:
        source = ExtendedSource(2e-3, 0.1, picture=picture)
        plane = source.power_spectrum(Grid((40, 33), 7e-6), wavelength=WAVELENGTH)
        line = source.power_spectrum(Grid((1, 33), 7e-6), wavelength=WAVELENGTH)
        np.testing.assert_allclose(line[0], plane.sum(axis=0), atol=1e-12)
        line = source.power_spectrum(Grid((40, 1), 7e-6), wavelength=WAVELENGTH)
        np.testing.assert_allclose(line[:, 0], plane.sum(axis=1), atol=1e-12)


def test_areas_and_angles():
    disc, square = (ExtendedSource(2e-3, 0.1, shape=shape) for shape in ("circular", "square"))
    assert disc.coherence_area(WAVELENGTH) == pytest.approx(4 * 55e-9**2 / (np.pi * 4e-6))
    assert square.coherence_area(WAVELENGTH) == pytest.approx(55e-9**2 / 4e-6)
    half = ExtendedSource(2e-3, 0.1, picture=[[1, 1], [0, 0]])
    assert half.coherence_area(WAVELENGTH) == pytest.approx(55e-9**2 / 2e-6)
    # sum of abs(mu)^2 over a fine lattice of lags; sinc^2 beyond 14 lobes left out: 1.4 %
    lags = np.arange(-400, 400) * 4e-6
    letter = ExtendedSource(2e-3, 0.1, picture=LETTER)
    mu = letter.degree(lags[:, None], lags, wavelength=WAVELENGTH)
    area = np.sum(np.abs(mu) ** 2) * 4e-6**2
    assert letter.coherence_area(WAVELENGTH) == pytest.approx(area, rel=0.02)
    assert disc.half_angle(WAVELENGTH) == pytest.approx(0.01)
    assert letter.half_angle() == pytest.approx(0.01)
    tall = ExtendedSource(2e-3, 0.1, picture=LETTER.T)
    assert tall.half_angle() == pytest.approx(0.01 * 4 / 3)


# Bad input


def test_what_is_no_source():
    for args, more, words in [
        ((0, 0.1), {}, "size must be positive"),
        ((-1e-3, 0.1), {}, "size must be positive"),
        ((float("nan"), 0.1), {}, "size must be positive"),
        ((1e-3, 0), {}, "distance must be positive"),
        ((1e-3, float("inf")), {}, "distance must be positive"),
        ((1e-3, "1"), {}, "distance must be positive"),
        ((1e-3, 0.1), {"shape": "ring"}, "'circular' or 'square'"),
        ((1e-3, 0.1), {"points": 0}, "at least 1"),
        ((1e-3, 0.1), {"points": 2.5}, "an integer"),
        ((1e-3, 0.1), {"points": True}, "an integer"),
        ((1e-3, 0.1), {"picture": []}, "2-D array"),
        ((1e-3, 0.1), {"picture": np.ones((2, 2, 3))}, "2-D array"),
        ((1e-3, 0.1), {"picture": np.zeros((2, 0))}, "2-D array"),
        ((1e-3, 0.1), {"picture": [[1, -1]]}, "not negative"),
        ((1e-3, 0.1), {"picture": [[1, np.nan]]}, "finite"),
        ((1e-3, 0.1), {"picture": [[0, 0]]}, "above 0"),
    ]:
        with pytest.raises(ValueError, match=words):
            ExtendedSource(*args, **more)


def test_a_grid_too_coarse():
    source = ExtendedSource(2e-3, 0.1, picture=np.ones((2, 1)))  # 4 mm along y
    source.check(Grid((8, 8), (13.7e-6, 27.4e-6)), wavelength=WAVELENGTH)
    source.check(Grid((1, 8), (50e-6, 27.4e-6)), wavelength=WAVELENGTH)
    too_coarse = Grid((8, 8), (14e-6, 20e-6))
    for ask in (source.check, source.power_spectrum):
        with pytest.raises(
            SamplingError, match=r"along y .* at most 13.75 um .* 4 mm .* got 14 um"
        ):
            ask(too_coarse, wavelength=WAVELENGTH)
    with pytest.raises(SamplingError, match=r"along x .* at most 27.5 um .* 2 mm .* got 28 um"):
        source.check(Grid((8, 8), (10e-6, 28e-6)), wavelength=WAVELENGTH)


def test_a_curvature_too_coarse():
    source = ExtendedSource(1e-3, 0.1, curved=True)
    source.check(Grid((1, 64), 20e-6), wavelength=WAVELENGTH)
    # edge at 64 x 20 um: lam d/(2 (1.28 mm + .5 mm))
    with pytest.warns(SamplingWarning, match=r"along x: use a pitch of at most 15.4494 um"):
        source.check(Grid((1, 128), 20e-6), wavelength=WAVELENGTH)
    with pytest.raises(ValueError, match="focal length -100 mm"):
        source.power_spectrum(Grid((1, 64), 20e-6), wavelength=WAVELENGTH)
