"""One step between any two grids: against the sum over all samples, and where auto takes it."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from fields import band_limited, field_of, go, staying
from reference_sommerfeld import sum_at
from tolerance import err_db

from clplen import Device, Grid, Propagator, SamplingError, propagate
from clplen.wave.propagation.description import Description, Request
from clplen.wave.propagation.methods import describe
from clplen.wave.propagation.one_step import TOLERANCE, Series, best_series

LAM = 633e-9
SINGLE, DOUBLE = 120, 175  # dB; the error's bound is 1e-9 of the field's norm


def expected_at(u: np.ndarray, grid: Grid, z: float, out: Grid, wavelength: float = LAM):
    """Indices (y, x) of some output samples, and the sum over all input samples there."""
    rng = np.random.default_rng(out.shape[1])
    iy, ix = (np.append(rng.integers(0, n, 60), [0, n - 1, n // 2]) for n in out.shape)
    points = list(zip(out.y[iy], out.x[ix], strict=True))
    return iy, ix, sum_at(u, grid.pitch, z, wavelength, points, origin=grid.origin)


FAR = [  # input, distance, output
    (Grid((64, 61), 1e-5), 1000.0, Grid((60, 64), 0.16)),
    (Grid((61, 64), 1e-5), 100.0, Grid((64, 60), 0.016)),
    (Grid((47, 90), (1e-5, 8e-6)), -100.0, Grid((51, 37), (0.01, 0.006), origin=(0.3, -0.5))),
    (Grid((90, 43), 1.2e-5, origin=(3e-4, -1e-4)), 40.0, Grid((33, 64), 4e-3, origin=(0.1, 0.4))),
    (Grid((1, 97), (1e-6, 1e-5)), 50.0, Grid((1, 60), (1.0, 0.02), origin=(0.0, -0.3))),
    (Grid((83, 1), 9e-6), -70.0, Grid((41, 1), (0.03, 1.0))),
]
FOCUS = [  # a small output: about it the series is shorter
    (Grid((160, 151), 2e-5), 0.8, Grid((40, 33), 1.1e-6, origin=(3e-5, -2e-5))),
    (Grid((1, 200), 2e-5), -0.6, Grid((1, 41), 1.5e-6)),
]


def test_far_away_by_name_and_by_auto(device, precise):
    for grid, z, out in FAR:
        u = band_limited(grid.shape, 3, share=0.5)
        iy, ix, expected = expected_at(u, grid, z, out)
        for method in ("one-step", "auto"):
            for one, least in ((device, SINGLE), (precise, DOUBLE)):
                made = Propagator(grid, z, wavelength=LAM, device=one, out_grid=out, method=method)
                # Of lines there is so little to do that several transforms take longer to start.
                assert made.method == "one-step" or (method == "auto" and 1 in grid.shape)
                assert made.report.warning == ""
                if made.method == "cblas":
                    least = min(least, 150)  # dB, of its guard so far away
                got = made(field_of(u, grid, one, LAM)).to_numpy()
                assert err_db(expected, got[iy, ix]) >= least


def test_into_a_focus(device, precise):
    """The phase of a lens on the input; the series is about the output."""
    for grid, z, out in FOCUS:
        y, x = grid.y[:, None] * (grid.shape[0] > 1), grid.x[None]
        lens = np.exp(-1j * np.pi * (x**2 + y**2) / (LAM * z))
        u = band_limited(grid.shape, 4, share=0.01, mean=1.0) * lens
        iy, ix, expected = expected_at(u, grid, z, out)
        for one, least in ((device, SINGLE), (precise, DOUBLE)):
            made = Propagator(grid, z, wavelength=LAM, device=one, out_grid=out, method="one-step")
            assert not made.description.factor.series.inward
            got = made(field_of(u, grid, one, LAM)).to_numpy()
            assert err_db(expected, got[iy, ix]) >= least


def auto(grid: Grid, z: float, out: Grid, **options: object) -> Description:
    return describe(Request(grid, z, LAM, "auto", out_grid=out, **options))


@pytest.mark.thorough
def test_auto_takes_it_only_where_it_is_exact_and_less_work():
    grid = Grid((64, 60), 4e-6)
    seen = set()
    for z in np.geomspace(1e-3, 1e3, 40):
        for out in (
            Grid((64, 50), 4.1e-6),
            Grid((30, 33), max(4e-6, z / 3000), origin=(0, z / 50)),
        ):
            made, by_name = auto(grid, z, out), best_series(Request(grid, z, LAM, out_grid=out))
            exact = by_name.bound[1] <= TOLERANCE
            assert exact or made.method != "one-step"
            seen.add((exact, made.method))
    assert {(True, "one-step"), (False, "cblas")} <= seen
    # The band of the output ends at the Nyquist frequency: images would come, and cblas is dark.
    wide = Grid((64, 60), 0.1 * LAM / 4e-6 / 60)
    assert auto(grid, 0.1, wide).method == "cblas"
    with pytest.raises(SamplingError, match=r"limited to .* frequencies .* method='one-step'"):
        auto(grid, 300.0, Grid((64, 60), 300 * LAM / 4e-6 / 60))
    assert auto(grid, 100.0, Grid((30, 33), 0.02), guard=0).method == "cblas"


def test_it_says_from_where_it_is_exact():
    grid, out = Grid((64, 60), 4e-6), Grid((64, 50), 2e-6, origin=(1e-3, 0))
    near = describe(Request(grid, 0.03, LAM, "one-step", out_grid=out))
    start = near.valid[0]
    assert f"from {start:.4g} m on the error is below 1e-9" in near.warning
    for z, warned in ((0.999 * start, True), (1.001 * start, False), (-1.001 * start, False)):
        assert bool(describe(Request(grid, z, LAM, "one-step", out_grid=out)).warning) == warned


def test_batches_plans_and_arrays_that_stay(device, monkeypatch):
    grid, z, out = FAR[2]
    u = np.stack([band_limited(grid.shape, seed, share=0.4) for seed in (1, 2, 3)])
    options = {"method": "one-step", "out_grid": out}
    whole = go(u, grid, z, device, **options)
    for one, each in zip(u, whole, strict=True):
        assert err_db(each, go(one, grid, z, device, **options)) >= 130
    other = staying(device, monkeypatch)
    assert err_db(whole, go(u, grid, z, other, **options)) >= 130
    plan = Propagator(grid, z, wavelength=550e-9, device=device, **options)
    again = pickle.loads(pickle.dumps(plan.description))
    assert again.why == plan.why
    held = plan.nbytes
    assert held >= len(plan.description.terms) * math.prod(out.shape) * device.complex.itemsize
    field = field_of(u[0], grid, device)
    both = propagate(field, [z, 2 * z], out_grid=out, method="one-step").to_numpy()
    assert err_db(whole[0], both[0]) >= 130


# Fresnel's integral onto any grid -----------------------------------------------------------------


def test_one_transform_onto_another_grid(device, precise):
    """Goodman (2005), eq. 4-17, as plain matrix products."""
    for lens in [None, 3e-3, -8e-3]:
        for z in [2.5e-3, -4e-3]:
            grid = Grid((33, 46), (4e-6, 3e-6), origin=(2e-5, -1e-5))
            out = Grid((29, 40), (1.7e-6, 2.2e-6), origin=(-3e-5, 4e-5))
            u = band_limited(grid.shape, 6)
            y, x = (
                np.sqrt(1 / (1j * LAM * z)) * d
                * np.exp(1j * np.pi * (b[:, None] - a) ** 2 / (LAM * z))
                * (1 if lens is None else np.exp(-1j * np.pi * a**2 / (LAM * lens)))
                for a, b, d in ((grid.y, out.y, grid.pitch[0]), (grid.x, out.x, grid.pitch[1]))
            )  # fmt: skip
            expected = y @ u @ x.T
            for one, least in ((device, SINGLE), (precise, 250)):
                options = {
                    "method": "fresnel-1fft",
                    "lens": lens,
                    "out_grid": out,
                    "wavelength": LAM,
                }
                got = propagate_at(u, grid, z, one, **options)
                assert err_db(expected, got) >= least


def propagate_at(
    u: np.ndarray, grid: Grid, z: float, device: Device, *, wavelength: float, **options: object
) -> np.ndarray:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return propagate(field_of(u, grid, device, wavelength), z, **options).to_numpy()


# The series itself --------------------------------------------------------------------------------


def test_the_polynomial_is_the_path_and_the_amplitude_to_the_fourth_power():
    """What is left over falls with the fifth power of t: 32 times less at half of it."""
    for side in [1, -1]:
        for lines in [False, True]:
            grid = Grid((1 if lines else 64, 80), (2.0 * LAM, 1.5 * LAM))
            out = Grid(
                (1 if lines else 50, 40), 3 * LAM, origin=(0 if lines else 90 * LAM, -70 * LAM)
            )
            series = Series(Request(grid, side * 200 * LAM, LAM, "one-step", out_grid=out), True)
            rng = np.random.default_rng(8)
            d = rng.uniform(-40, 40, (2, 30)) * LAM * [[not lines], [1]]
            t = rng.uniform(-1, 1, (2, 30)) * np.array(series.halves)[:, None]
            k = 2 * np.pi / LAM * side
            (cy, cx), (sy, sx), (by, bx), (hy, hx) = (
                series.middle, series.slopes, series.bends, series.halves,
            )  # fmt: skip
            far = np.sqrt((cy + d[0]) ** 2 + (cx + d[1]) ** 2 + (200 * LAM) ** 2)
            parts = series.polynomial(*d)
            left = []
            for scale in (0.1, 0.05):
                y, x = scale * t
                near = np.sqrt((cy + d[0] - y) ** 2 + (cx + d[1] - x) ** 2 + (200 * LAM) ** 2)
                main = (
                    -(sy * y + sx * x) - by * d[0] * y - bx * d[1] * x + (by * y**2 + bx * x**2) / 2
                )
                exact = 1j * k * (near - far - main) - (1.5 if lines else 2) * np.log(near / far)
                made = sum(v * (y / (hy or 1)) ** a * (x / hx) ** b for (a, b), v in parts.items())
                left.append(np.abs(made - exact))
            ratio = left[0].sum() / left[1].sum()
            assert 25 < ratio < 40
            assert left[0].max() < 2e-4


def test_a_series_that_does_not_converge_is_refused(device):
    """1e17 to 1e25 times the light came back, and NaN."""
    for grid, wavelength, z in [
        (Grid((31, 100), (8e-6, 4.3e-7)), 6.1e-7, 2.9e-5),
        (Grid((64, 48), (2.26e-5, 1.25e-6), origin=(2.9e-6, 2.3e-6)), 1.46e-6, -1.9e-5),
        (Grid((1, 200), 2e-6), LAM, 1e-5),
    ]:
        with pytest.raises(
            SamplingError, match=r"does not converge in one-step .* Use method='auto'"
        ):
            Propagator(grid, z, wavelength=wavelength, method="one-step", device=device)
        field = field_of(np.ones(grid.shape), grid, device, wavelength)
        assert 0 < propagate(field, z).power() <= field.power() * 1.01
