"""Every method of propagation against its float64 twin and against exact waves."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import reference
from fields import LAM, band_limited, field_of, go
from reference_corrected import corrected
from reference_propagation import (
    fresnel_1fft,
    fresnel_ir,
    fresnel_multistep,
    fresnel_tf,
    sommerfeld,
)
from tolerance import err_db

from clplen import Grid, Propagator, SamplingWarning, propagate

SINGLE, DOUBLE = 120, 250  # dB; rounding of two transforms is 130-140 and 290-310
# Phases of up to 1e5 turns (RS kernel, chirps) are known to 1e5 eps in float64.
GRIDS = [
    Grid((16, 22), (6.6e-6, 5e-6), origin=(3e-6, -7e-6)),
    Grid((17, 31), (2e-6, 3e-6)),
    Grid((1, 64), 2e-6),
    Grid((29, 1), 4e-6),
]


def twin(method: str, u: np.ndarray, grid: Grid, z: float, pad: float) -> np.ndarray:
    """The float64 result of a method that keeps the number of samples."""
    if method in ("as", "blas"):
        return reference.propagate(u, grid.pitch, z, LAM, method=method, pad=pad)
    if method == "rs":
        return sommerfeld(u, grid.pitch, z, wavelength=LAM)
    if method == "fresnel-1fft":
        return fresnel_1fft(u, grid.pitch, z, wavelength=LAM, pad=pad)[0]
    steps = {
        "fresnel-tf": fresnel_tf,
        "fresnel-ir": fresnel_ir,
        "fresnel-multistep": fresnel_multistep,
    }
    return steps[method](u, grid.pitch, z, wavelength=LAM, pad=pad)


@pytest.mark.parametrize(
    "method",
    ["as", "blas", "rs", "fresnel-tf", "fresnel-ir", "fresnel-1fft", "fresnel-multistep"],
)
def test_against_twin(device, precise, method):
    for grid in GRIDS:
        u = band_limited(grid.shape, 1)
        for pad in (2,) if method == "rs" else (1, 1.5):
            for z in (-3e-4, 4e-3):
                expected = twin(method, u, grid, z, pad)
                for where, least in ((device, SINGLE), (precise, DOUBLE)):
                    assert err_db(expected, go(u, grid, z, where, method=method, pad=pad)) >= least


def compact(grid: Grid, seed: int, tilt: float = 0.3) -> np.ndarray:
    """Three Gaussian beams, off-centre and tilted, 1e-15 at the edges and at Nyquist."""
    rng = np.random.default_rng(seed)
    u = np.zeros(grid.shape, complex)
    for amplitude in (1, 0.7j, -0.5 + 0.2j):
        beams = []
        for n, d in zip(grid.shape, grid.pitch, strict=True):
            x = (np.arange(n) - n // 2) * d
            waist, centre = d * math.sqrt(n / math.pi), rng.uniform(-1, 1) * n * d / 16
            f = tilt * rng.uniform(-1, 1) / (2 * d)
            beams.append(np.exp(-(((x - centre) / waist) ** 2) + 2j * np.pi * f * x))
        y, x = (np.ones(1) if b.size == 1 else b for b in beams)
        u += amplitude * np.multiply.outer(y, x)
    return u


COMPACT = [
    Grid((53, 72), (3e-6, 2e-6)),
    Grid((64, 47), (2e-6, 4e-6), origin=(4e-6, -3e-5)),
    Grid((1, 91), (1e-6, 2e-6)),
    Grid((81, 1), 3e-6),
]


def test_on_the_fields_own_grid(device, precise):
    for grid in COMPACT:
        for z in [2e-4, -5e-3, 0.7]:
            # Far away the window sees frequencies near 0 alone: steeper beams would leave it dark.
            u = compact(grid, 2, tilt=0.3 if abs(z) < 0.01 else 0.02)
            wide, usual = (
                corrected(u, grid.pitch, z, wavelength=LAM, guard=guard, steepness=steepness)
                for guard, steepness in ((8, 5), (6, 4))
            )
            assert err_db(wide, go(u, grid, z, precise, method="cblas", guard=8)) >= 190
            # The two windows, of 7-smooth or exact length, differ by the guard's own error: 180 dB.
            assert err_db(usual, go(u, grid, z, precise, method="cblas", guard=6)) >= 170
            # Without a word the guard is 6, and 8 where 6 would let go of 150 dB.
            assert err_db(wide, go(u, grid, z, precise, method="cblas")) >= 170
            for method in ("cblas", "auto"):
                assert err_db(wide, go(u, grid, z, device, method=method)) >= SINGLE
            # "rs" is better than a guard of 6 far away, "as" equal to it near.
            assert err_db(wide, go(u, grid, z, precise)) >= 170


def others(grid: Grid) -> list[Grid]:
    """Output grids of another pitch, size and centre; the last one aligned and larger."""
    (ny, nx), (dy, dx), (oy, ox) = grid.shape, grid.pitch, grid.origin
    sizes = [(ny, 33, ny + 21), (nx, 18, nx + 10)]
    y, x = ([1] * 3 if n == 1 else list(m) for n, m in zip((ny, nx), sizes, strict=True))
    pitches = [(0.71 * dy, 1.3 * dx), (2.1 * dy, 0.37 * dx), (dy, dx)]
    origins = [(oy, ox), (oy - 1.7 * dy, ox + 9.3 * dx), (oy, ox)]
    return [
        Grid((m, k), pitch, origin=origin)
        for m, k, pitch, origin in zip(y, x, pitches, origins, strict=True)
    ]


def test_onto_another_grid(device, precise):
    for grid in COMPACT:
        for z in [3e-4, -0.02]:
            u = compact(grid, 3)
            for out in others(grid):
                expected = corrected(
                    u,
                    grid.pitch,
                    z,
                    wavelength=LAM,
                    guard=8,
                    steepness=5,
                    out_shape=out.shape,
                    out_pitch=out.pitch,
                    out_centre=tuple(a - b for a, b in zip(out.origin, grid.origin, strict=True)),
                )
                # Relative to all the light: a window beside the beam holds little of it.
                scale = np.abs(u).max()
                for method in ("auto", "cblas"):
                    for d, limit in ((device, 1e-6), (precise, 1e-9)):
                        field = propagate(field_of(u, grid, d), z, method=method, out_grid=out)
                        assert field.grid == out
                        error = np.abs(field.to_numpy() - expected).max() / scale
                        assert error <= limit, (method, out)


def test_onto_where_a_tilted_beam_goes(device):
    """Far off the axis, to the other side for z < 0."""
    for z in [0.02, -0.02]:
        grid, f = Grid((1, 120), (1e-6, 3e-6)), 1e5
        u = np.exp(-((grid.x / 3e-5) ** 2) + 2j * np.pi * f * grid.x)[None]
        centre = z * math.tan(math.asin(LAM * f))
        out = Grid((1, 150), (1e-6, 4e-6), origin=(0, centre))
        expected = corrected(
            u, grid.pitch, z, wavelength=LAM, guard=8, steepness=5,
            out_shape=out.shape, out_pitch=out.pitch, out_centre=out.origin,
        )  # fmt: skip
        got = go(u, grid, z, device, out_grid=out)
        assert err_db(expected, got) >= SINGLE
        power = np.abs(got[0]) ** 2.0
        assert abs((power * out.x).sum() / power.sum() - centre) < 2e-6  # the lobe's own asymmetry
        assert power.sum() * 4e-6 == pytest.approx((np.abs(u) ** 2).sum() * 3e-6, rel=1e-3)


def test_light_at_the_nyquist_frequency_counts_once(device):
    """Near, the band ends on both Nyquist frequencies: one and the same wave, half of it each."""
    for grid in [Grid((1, 40), 2e-6), Grid((20, 60), (3e-6, 2e-6))]:
        rng = np.random.default_rng(1)
        u = rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape)
        out = Grid(grid.shape, tuple(0.7 * d for d in grid.pitch), origin=(0, 1e-6))
        expected = corrected(
            u, grid.pitch, 1e-6, wavelength=LAM, out_shape=out.shape, out_pitch=out.pitch,
            out_centre=out.origin,
        )  # fmt: skip
        assert err_db(expected, go(u, grid, 1e-6, device, out_grid=out)) >= SINGLE


def test_a_hard_edge_where_geometry_says(device):
    """guard = 0: plain transforms of the padded window, |f| <= f_geo."""
    for pad in [1, 2]:
        grid, z, support = Grid((20, 33), (4e-6, 3e-6)), 2e-3, (3e-5, 5e-5)
        u = band_limited(grid.shape, 4)
        shape = [reference.padded_length(n, pad) for n in grid.shape]
        window = np.zeros(shape, complex)
        part = tuple(
            slice(L // 2 - n // 2, L // 2 - n // 2 + n)
            for n, L in zip(grid.shape, shape, strict=True)
        )
        window[part] = u
        spectrum = np.fft.fft2(window) * reference.transfer_function(shape, grid.pitch, z, LAM)
        for axis, (L, d, lit, all_of_it) in enumerate(
            zip(shape, grid.pitch, support, grid.extent, strict=True)
        ):
            displacement = (lit + all_of_it) / 2
            limit = displacement / (LAM * math.hypot(displacement, z))
            outside = np.abs(np.fft.fftfreq(L, d)) > limit
            assert outside.any()
            spectrum[(outside, slice(None)) if axis == 0 else (slice(None), outside)] = 0
        expected = np.fft.ifft2(spectrum)[part]
        options = {"method": "cblas", "guard": 0, "pad": pad, "support": support}
        assert err_db(expected, go(u, grid, z, device, **options)) >= SINGLE


def test_border_of_many_steps(device, precise):
    for border in [0, 0.7]:
        for z in [5e-3, -9e-3]:
            grid = Grid((15, 24), (5e-6, 4e-6))  # 32 and 48 samples: dz = 1.45 and 1.4 mm
            u = band_limited(grid.shape, 6)
            expected = fresnel_multistep(u, grid.pitch, z, wavelength=LAM, border=border)
            for d, least in ((device, SINGLE), (precise, DOUBLE)):
                got = go(u, grid, z, d, method="fresnel-multistep", border=border)
                assert err_db(expected, got) >= least


def test_one_transform_and_its_pitch(device, precise):
    for lens in [None, -5e-3, 1.1e-3]:
        for z in [1.1e-3, -1.6e-3]:
            grid = Grid((27, 40), (4e-6, 3e-6))
            u = band_limited(grid.shape, 7)
            for pad in (1, 1.3):
                expected, pitch = fresnel_1fft(u, grid.pitch, z, wavelength=LAM, pad=pad, lens=lens)
                for d, least in ((device, SINGLE), (precise, DOUBLE)):
                    options = {"method": "fresnel-1fft", "pad": pad, "lens": lens}
                    assert err_db(expected, go(u, grid, z, d, **options)) >= least
                made = quiet_plan(grid, z, device, **options)
                np.testing.assert_allclose(made.out_grid.pitch, pitch, rtol=1e-13)
                assert made.out_grid.shape == grid.shape


def test_a_lens_stands_on_the_axis_and_not_on_the_window(precise):
    """A window beside the axis sees the lens tilted, as a sampled lens before the step."""
    grid, z, f = Grid((40, 51), (4e-6, 3e-6), origin=(3e-5, -2e-5)), 4e-3, 7e-3
    u = band_limited(grid.shape, 8)
    r2 = grid.y[:, None] ** 2 + grid.x**2
    bent = u * np.exp(-1j * np.pi * r2 / (LAM * f))
    expected = go(bent, grid, z, precise, method="fresnel-1fft")
    got = go(u, grid, z, precise, method="fresnel-1fft", lens=f)
    assert err_db(expected, got) >= DOUBLE


# Exact waves ----------------------------------------------------------------------------------


def test_evanescent_waves_decay_and_do_not_return(device):
    grid = Grid((3, 40), LAM / 6)
    f = 12 / (40 * LAM / 6)  # 1.8/lam
    wave = np.broadcast_to(np.exp(2j * np.pi * f * grid.x), grid.shape)
    for z in (0.05 * LAM, 0.2 * LAM, 0.5 * LAM):
        decay = np.exp(-2 * np.pi * z / LAM * math.sqrt((LAM * f) ** 2 - 1))
        expected = wave * decay * np.exp(-2j * np.pi * z / LAM)
        assert err_db(expected, go(wave, grid, z, device, method="as", pad=1)) >= SINGLE
        assert np.abs(go(wave, grid, -z, device, method="as", pad=1)).max() <= 1e-6


def test_evanescent_waves_reach_every_output_grid(device):
    """On the field's samples and on five times finer ones, against a window 64 times wider."""
    for z in [0.05 * LAM, 0.1 * LAM]:
        grid, fine = Grid((1, 48), 0.15e-6), Grid((1, 231), 0.03e-6)
        u = band_limited(grid.shape, 4) * np.exp(-((grid.x / 1.2e-6) ** 2))
        propagating = np.fft.ifft(np.fft.fft(u) * (np.abs(grid.fx) * LAM <= 1))
        assert err_db(u, propagating) < 5  # most of it is evanescent
        expected = reference.propagate(u, grid.pitch, z, LAM, pad=64)
        # Grazing waves come back from the edges of a window of twice the grid: 50 dB.
        for method in ("auto", "cblas"):
            assert err_db(expected, go(u, grid, z, device, method=method)) >= 45
            got = go(u, grid, z, device, method=method, out_grid=fine)
            # Fine sample 115 + 5 k is sample 24 + k.
            assert err_db(expected[:, 1:], got[:, ::5][:, :47]) >= 45


# Single precision -----------------------------------------------------------------------------


def quiet_plan(grid: Grid, z: float, device, **options) -> Propagator:
    """A plan, whatever the warnings about its sampling."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        return Propagator(grid, z, wavelength=LAM, device=device, **options)


def test_resampled_at_z_zero(precise):
    """The field's own Fourier sum, at other places."""
    grid, out = Grid((53, 64), (3e-6, 2e-6)), Grid((40, 31), (1.7e-6, 3.1e-6), origin=(2e-6, -1e-6))
    got = go(compact(grid, 5), grid, 0.0, precise, out_grid=out)
    fine = corrected(
        compact(grid, 5), grid.pitch, 1e-12, wavelength=LAM, out_shape=out.shape,
        out_pitch=out.pitch, out_centre=out.origin,
    )  # fmt: skip
    assert err_db(fine, got) >= 90  # over 1e-12 m the phase changes by 2e-6 turns
