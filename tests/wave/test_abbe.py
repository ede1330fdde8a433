"""Abbe's sum by both routes against float64 twins, its limits, and partially coherent edges."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen import Field, Grid
from clplen.errors import ShapeError
from clplen.wave.coherence.abbe import abbe_cost, abbe_image, incoherent_image
from clplen.wave.systems.pupil_filter import Pupil

LAM = 550e-9
ROUTES = ["points", "lags"]
GRID = Grid((15, 22), (3e-6, 4e-6), origin=(1e-6, -7e-6))


def on(device, u, grid=GRID):
    return Field.from_array(u, grid, wavelength=LAM, device=device)


def scene(shape, seed=0):
    """A complex object, brighter on one side, and a lopsided source with holes."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    u *= np.linspace(0.2, 1, shape[0])[:, None] * np.linspace(1, 0.3, shape[1])
    source = rng.random(shape) ** 4
    source[source < 0.05] = 0
    return u, source / source.sum()


def twin(u, H, source):
    """The sum over all source points in float64, without any crop."""
    spectrum, total = np.fft.fft2(u), np.zeros(u.shape)
    for y, x in np.argwhere(source > 0):
        lit = np.roll(spectrum, (y, x), (0, 1))
        total += source[y, x] * np.abs(np.fft.ifft2(lit * H)) ** 2
    return total


def aberrated(grid, fc):
    """A transfer function without any symmetry, away from the middle of the spectrum."""
    pupil = Pupil.of_cutoff(fc, LAM, path=lambda v, u: 2e-7 * (v**3 - 0.5 * u * v + 0.2 * u**2))
    return np.roll(pupil.transfer(grid, LAM), (1, -2), (0, 1))


def test_both_routes_are_the_sum_over_the_source(device, precise):
    for route in ROUTES:
        for fc in [2.5e4, 9e4]:
            for shape in [(15, 22), (23, 31), (1, 17), (19, 1), (16, 16)]:
                grid = Grid(shape, (3e-6, 4e-6), origin=(1e-6, -7e-6))
                u, source = scene(shape)
                H = aberrated(grid, fc)
                expected = twin(u, H, source)
                for one, allowed in (
                    (device, 3e-6),
                    (precise, 1e-13),
                ):  # some 25 units of round-off; 450
                    image, terms, dropped = abbe_image(on(one, u, grid), H, source, route=route)
                    assert image.to_numpy().dtype == one.real
                    assert relative_max(expected, image.to_numpy()) <= allowed
                    assert terms == (
                        np.count_nonzero(source) if route == "points" else pairs(shape)
                    )
                    assert dropped <= (0 if route == "points" else 1e-11)


def pairs(shape):
    """Pairs of opposite displacements, those that are their own opposite counted once."""
    return (int(np.prod(shape)) + int(np.prod([2 - n % 2 for n in shape]))) // 2


def test_a_source_everywhere_is_incoherent_light(device):
    for fc in [3e4, 9e4]:
        u, _ = scene(GRID.shape)
        H, even = aberrated(GRID, fc), np.full(GRID.shape, 1 / u.size)
        expected = twin(u, H, even)
        lamp = incoherent_image(on(device, u), H).to_numpy()
        assert relative_max(expected, lamp) <= 1e-6
        scrambled = u * np.exp(1j * np.arange(u.size).reshape(u.shape) ** 2)
        assert relative_max(expected, incoherent_image(on(device, scrambled), H).to_numpy()) <= 1e-6
        for route in (*ROUTES, "auto"):
            image, terms, _ = abbe_image(on(device, u), H, even, route=route)
            assert relative_max(expected, image.to_numpy()) <= 1e-6
            assert terms == (u.size if route == "points" else 1)


def test_source_points_whose_light_misses_the_pupil_are_skipped(device):
    grid = Grid((32, 48), 4e-6)
    u = 1 + np.exp(2j * np.pi * (5 * np.arange(32)[:, None] / 32 + 0 * np.arange(48)))
    narrow = np.zeros(grid.shape)
    narrow[0, 0] = narrow[1, 1] = 1
    even = np.full(grid.shape, 1 / u.size)
    image, terms, dropped = abbe_image(on(device, u, grid), narrow, even, route="points")
    assert terms == 4  # two orders, of f = 0 and 5, through two samples of the pupil
    assert dropped == 0
    assert relative_max(twin(u, narrow, even), image.to_numpy()) <= 1e-6


def test_tolerance_leaves_out_the_weakest(device):
    for route in ROUTES:
        u, source = scene(GRID.shape)
        H = Pupil.of_cutoff(6e4, LAM).transfer(GRID, LAM)
        whole = abbe_image(on(device, u), H, source, route=route)
        image, terms, dropped = abbe_image(on(device, u), H, source, tolerance=0.1, route=route)
        assert terms < whole.terms
        assert 0.05 < dropped <= 0.1
        error = np.abs(image.to_numpy() - whole.intensity.to_numpy()).max()
        light = np.abs(u).max() ** 2 * (
            np.mean(np.abs(H) ** 2) if route == "lags" else H.sum().real
        )
        assert 0 < error <= 0.1 * light
        if route == "points":
            kept = np.sort(source.ravel())[::-1][:terms]
            assert 1 - kept.sum() == pytest.approx(dropped)


def test_cost_is_that_of_the_cheaper_route():
    grid = Grid((64, 96), 4e-6)
    H = Pupil.of_cutoff(2e4, LAM).transfer(grid, LAM)
    one, even = np.zeros(grid.shape), np.full(grid.shape, 1 / 6144)
    one[0, 3] = 1
    for source, cheap in ((one, "points"), (even, "lags")):
        costs = {route: abbe_cost(grid, H, source, route=route) for route in ROUTES}
        assert min(costs, key=costs.get) == cheap
        assert abbe_cost(grid, H, source) == costs[cheap]
        assert max(costs.values()) > 100 * costs[cheap]
    # lower bounds: the transforms of one window of 2 (2 r + 1) - 1 samples, of two of the grid
    assert abbe_cost(grid, H, one) >= 5 * 19 * 31 * np.log2(19 * 31)
    assert abbe_cost(grid, H, even) >= 2 * 5 * 6144 * np.log2(6144)


# Bad input


def test_bad_input(device):
    for change, error, words in [
        ({"transfer": np.ones((15, 21))}, ShapeError, r"transfer must have .* got \(15, 21\)"),
        ({"transfer": np.full((15, 22), np.nan)}, ValueError, "finite at every frequency"),
        ({"transfer": np.zeros((15, 22))}, ValueError, "must not be 0 at every frequency"),
        ({"source": np.ones(22)}, ShapeError, r"source must have .* got \(22,\)"),
        ({"source": np.ones((15, 22))}, ValueError, "a sum of 330; divide it by its sum"),
        ({"source": np.eye(15, 22) - 14 / 330}, ValueError, "a minimum of -0.0424"),
        ({"tolerance": -0.1}, ValueError, "tolerance must be at least 0 and below 1"),
        ({"tolerance": 1}, ValueError, "tolerance must be at least 0 and below 1"),
        ({"route": "best"}, ValueError, "'auto', 'points' or 'lags', got 'best'"),
    ]:
        given = {"transfer": np.ones(GRID.shape), "source": np.full(GRID.shape, 1 / 330)} | change
        transfer, source = given.pop("transfer"), given.pop("source")
        with pytest.raises(error, match=words):
            abbe_image(on(device, np.ones(GRID.shape)), transfer, source, **given)


def test_one_field_at_a_time(device):
    batch = on(device, np.ones((2, *GRID.shape)))
    with pytest.raises(ShapeError, match="must be a single field"):
        incoherent_image(batch, np.ones(GRID.shape))
    with pytest.raises(TypeError, match="got ndarray"):
        incoherent_image(np.ones(GRID.shape), np.ones(GRID.shape))


def test_thousands_of_terms_keep_their_precision(device):
    grid = Grid((64, 63), (3e-6, 2e-6))
    rng = np.random.default_rng(4)
    u = rng.random(grid.shape) > 0.5
    source = rng.random(grid.shape)
    source /= source.sum()
    H = Pupil.of_cutoff(6e4, LAM).transfer(grid, LAM)
    expected = twin(u, H, source)
    for route in ROUTES:
        image, terms, _ = abbe_image(on(device, u, grid), H, source, route=route)
        assert terms >= 2000
        assert relative_max(expected, image.to_numpy()) <= 2e-6
