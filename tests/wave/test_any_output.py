"""Onto any output grid: against the sum over all samples, Rayleigh and Sommerfeld's integral."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
import pytest
from fields import field_of
from reference_sommerfeld import sum_at
from tolerance import err_db

from clplen import Device, Grid, Propagator, SamplingError, SamplingWarning
from clplen.wave.propagation.description import Request
from clplen.wave.propagation.methods import describe
from clplen.wave.propagation.plan_report import PlanReport, report

LAM = 1e-6
SINGLE, DOUBLE = 120, 200  # dB; of the taper of a windowed kernel 1e-12 is left


def points_of(grid: Grid, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Indices (y, x) of some samples, with those of the middle, where it is bright, and corners."""
    rng = np.random.default_rng(grid.shape[0])
    iy, ix = (rng.integers(0, n, count) for n in grid.shape)
    middle = [(n // 2 + np.arange(-2, 3)) % n for n in grid.shape]
    my, mx = (place.ravel() for place in np.meshgrid(*middle))
    (ny, nx) = grid.shape
    return (
        np.concatenate([iy, my, [0, 0, ny - 1, ny - 1]]),
        np.concatenate([ix, mx, [0, nx - 1, 0, nx - 1]]),
    )


def error_of(
    u: np.ndarray,
    grid: Grid,
    z: float,
    out: Grid,
    devices: Sequence[Device],
    wavelength: float = LAM,
    **options: object,
) -> list[float]:
    """err_db of each device's result at some output points."""
    iy, ix = points_of(out)
    points = list(zip(out.y[iy], out.x[ix], strict=True))
    expected = sum_at(u, grid.pitch, z, wavelength, points, origin=grid.origin)
    errors = []
    for device in devices:
        plan = Propagator(grid, z, wavelength=wavelength, device=device, out_grid=out, **options)
        got = plan(field_of(u, grid, device, wavelength)).to_numpy()[iy, ix]
        errors.append(err_db(expected, got))
    return errors


def spot(grid: Grid, waist: float, sines: tuple[float, float] = (0, 0)) -> np.ndarray:
    """A Gaussian beam beside the middle, tilted to the direction cosines (y, x)."""
    y, x = grid.y[:, None] - grid.origin[0], grid.x[None] - grid.origin[1]
    if grid.shape[0] == 1:
        y = np.zeros((1, 1))
    tilt = np.exp(2j * np.pi / LAM * (sines[0] * y + sines[1] * x))
    return np.exp(-(((y - 0.3e-6) ** 2 + (x + 0.2e-6) ** 2) / waist**2)) * tilt


# Samples below half a wavelength: waves that graze the plane --------------------------------------


def moved(grid: Grid) -> list[Grid]:
    """By a nanometre, to another pitch and beside the axis, to another size."""
    (dy, dx), (oy, ox) = grid.pitch, grid.origin
    (ny, nx) = grid.shape
    still = ny == 1
    return [
        Grid(grid.shape, grid.pitch, origin=(oy, ox + 1e-9)),
        Grid((1 if still else 33, 47), (1.9 * dy, 2.3 * dx), origin=(oy + 4e-6, ox - 3e-6)),
        Grid((1 if still else ny + 12, nx - 7), grid.pitch, origin=grid.origin),
    ]


def test_fine_samples_onto_other_grids(device, precise):
    for grid in [
        Grid((61, 48), (LAM / 6, LAM / 5)),
        Grid((37, 53), (0.3 * LAM, 0.22 * LAM), origin=(2e-6, -5e-6)),
        Grid((41, 44), 0.49 * LAM),
        Grid((1, 83), (LAM, LAM / 6)),
    ]:
        for z in [11e-6, -40e-6]:
            u = spot(grid, 0.35e-6 if grid.pitch[1] < 0.3 * LAM else 0.8e-6, (0.3, -0.2))
            if grid.shape[0] == 1:
                u = spot(grid, 0.35e-6, (0, -0.2))
            for out in moved(grid):
                single, double = error_of(u, grid, z, out, (device, precise))
                assert (single >= SINGLE, double >= DOUBLE) == (True, True), (single, double, out)


def test_the_phase_of_a_windowed_kernel_may_be_chosen(device):
    grid, out = Grid((52, 61), 0.3 * LAM), Grid((40, 33), 0.8 * LAM, origin=(0, 2e-6))
    for phase in ("twofloat", *(["fp64"] if device.has_fp64 else [])):
        (single,) = error_of(spot(grid, 0.8e-6), grid, 2e-5, out, [device], phase=phase)
        assert single >= SINGLE


def report_of(grid: Grid, z: float, out: Grid | None = None, method: str = "auto") -> PlanReport:
    return report(describe(Request(grid, z, LAM, method, out_grid=out)), "tables")


def test_a_report_says_where_grazing_waves_come_back(device):
    grid = Grid((40, 50), LAM / 6)
    out = Grid((40, 50), LAM / 6, origin=(0, 1e-9))
    made = report_of(grid, 4e-5, out)
    assert (made.method, made.aliases_miss) == ("rs", True)
    assert made.why.endswith("waves that graze the plane leave every window")
    own = report_of(grid, 4e-5, out, "cblas")
    assert (own.method, own.aliases_miss) == ("cblas", False)
    assert "its aliases miss the output" not in str(own)
    assert "use method='auto' or 'rs'" in own.warning
    with pytest.warns(SamplingWarning, match="graze the plane leave the window of cblas"):
        Propagator(grid, 4e-5, wavelength=LAM, method="cblas", device=device, out_grid=out)
    # Within three samples evanescent waves count, in a window of their own.
    assert not report_of(grid, 0.2e-6, out).aliases_miss
    coarse = Grid((40, 50), 2 * LAM)
    assert report_of(coarse, 4e-3, Grid((40, 50), 1.9 * LAM)).aliases_miss


# Off both axes ------------------------------------------------------------------------------------


def test_onto_a_window_off_both_axes(device, precise):
    """A ray that moves sideways along y has a lower frequency along x: x/(lam r), not the ray's in
    the plane of x and z."""
    for z in [1e-3, -1e-3]:
        for slope in [0.3, 0.6]:
            grid = Grid((112, 120), 0.6 * LAM)
            sine = slope / math.sqrt(1 + 2 * slope**2) * math.copysign(1, z)
            u = spot(grid, 6e-6, (sine, sine))
            out = Grid((41, 37), 2.5e-6, origin=(slope * abs(z), slope * abs(z)))
            single, double = error_of(u, grid, z, out, (device, precise))
            assert (single >= SINGLE, double >= 170) == (True, True), (single, double)


# Many samples: into the band by a padded transform ----------------------------------------------


def test_into_the_band_by_a_padded_transform(device, precise):
    for grid, out in [
        (Grid((1, 601), 4 * LAM), Grid((1, 77), 1.3 * LAM, origin=(0, 500 * LAM))),
        (
            Grid((590, 24), (3 * LAM, 5 * LAM)),
            Grid((51, 30), (7 * LAM, 3 * LAM), origin=(-2e-4, 5e-5)),
        ),
        (Grid((37, 601), (4 * LAM, 3.5 * LAM), origin=(1e-4, -3e-4)), Grid((20, 101), 2 * LAM)),
    ]:
        for z in [0.05, -0.03]:
            y, x = grid.y[:, None] - grid.origin[0], grid.x[None] - grid.origin[1]
            u = np.exp(-((x / grid.extent[1]) ** 2 + (y / grid.extent[0]) ** 2) * 40)
            u = u * np.exp(0.02j * x / LAM - 0.01j * y / LAM)
            made = describe(Request(grid, z, LAM, "cblas", out_grid=out, guard=8))
            assert "forward" in {line.kind for line in (*made.into.y, *made.into.x)}
            single, double = error_of(u, grid, z, out, (device, precise), method="cblas", guard=8)
            assert (single >= SINGLE, double >= 190) == (True, True), (single, double)


# Single precision in the dark ---------------------------------------------------------------------


def test_the_error_of_single_precision_is_that_of_all_the_light(device, precise):
    """130 dB below all of it (docs/accuracy.md), whatever share of it the window holds."""
    for beside, of_window in [(0.0, SINGLE), (6.0, 60)]:
        grid, z = Grid((90, 107), (3 * LAM, 2.5 * LAM)), 2e-3
        waist = 2e-5
        u = np.exp(-((grid.y[:, None] / waist) ** 2) - (grid.x / waist) ** 2) + 0j
        spread = waist * math.hypot(1, LAM * z / (math.pi * waist**2))
        out = Grid((40, 51), 2e-6, origin=(0, beside * spread / 2))
        one, two = (
            Propagator(grid, z, wavelength=LAM, device=d, out_grid=out)(field_of(u, grid, d, LAM))
            for d in (device, precise)
        )
        error = np.linalg.norm(one.to_numpy() - two.to_numpy())
        there = np.linalg.norm(two.to_numpy())
        share = float(two.power()) / (np.linalg.norm(u) ** 2 * math.prod(grid.pitch))
        assert -20 * math.log10(error / (there / math.sqrt(share))) >= 130
        assert -20 * math.log10(error / there) >= of_window
        assert (share > 0.01) == (beside == 0)


def test_a_kernel_near_the_plane_is_refused_before_it_is_made(device):
    """By the bytes and the seconds it would take; auto does without."""
    for z in [2.5e-7, 1e-12, -1e-9]:
        grid, out = (
            Grid((3, 100), (1.1e-6, 2.7e-6)),
            Grid((100, 7), (1.2e-6, 2.6e-6), origin=(1e-6, 0)),
        )
        with pytest.raises(
            SamplingError, match=r"samples, .*B in complex64 .* s; use method='auto'"
        ):
            Propagator(grid, z, wavelength=5.1e-7, method="rs", device=device, out_grid=out)
        assert Propagator(grid, z, wavelength=5.1e-7, device=device, out_grid=out).method == "cblas"


def test_a_kernel_of_one_sample_is_refused(device):
    """dx^2 > lam z along an axis: more light would come out than goes in."""
    for method, out in [("rs", None), ("fresnel-ir", None), ("fresnel-1fft", Grid((9, 12), 5e-6))]:
        for pitch in [(4e-6, 3e-6), (1e-7, 4e-6)]:
            for pad in [1, 2]:
                near, far = (share * 4e-6**2 / LAM for share in (0.99, 1.01))
                options = {
                    "wavelength": LAM,
                    "method": method,
                    "pad": pad,
                    "out_grid": out,
                    "device": device,
                }
                with pytest.raises(SamplingError, match="is aliased"):
                    Propagator(Grid((21, 32), pitch[::-1]), -near, **options)
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    Propagator(Grid((21, 32), pitch[::-1]), -far, **options)


def test_the_kernel_onto_another_grid_by_name(device, precise):
    """rs on coarser samples: off the axis, odd and rectangular."""
    for z in [2e-4, -1e-3]:
        grid = Grid((45, 38), (1.3e-6, 1.1e-6), origin=(1e-5, 3e-6))
        out = Grid((29, 50), (2.7e-6, 0.9e-6), origin=(2e-5, -1.5e-5))
        u = spot(grid, 5e-6, (0.02, -0.05))
        single, double = error_of(u, grid, z, out, (device, precise), method="rs")
        assert (single >= SINGLE, double >= DOUBLE) == (True, True), (single, double)
