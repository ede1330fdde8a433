"""Gratings by their orders, their area and their self-images; the axicon by its beam."""

import numpy as np
import pytest
from scipy.special import jv

from clplen import Field, Grid, SamplingError, SamplingWarning
from clplen.wave.elements.gratings import axicon, grating

LAM = 532e-9


def ones(grid, device, wavelength=LAM):
    return Field.from_array(np.ones(grid.shape), grid, wavelength=wavelength, device=device)


def orders(t, periods, axis, count=4):
    """Amplitudes of the orders -count..count of a window of whole periods, x = 0 at n//2."""
    n = t.shape[axis]
    line = np.moveaxis(t, axis, -1)
    line = np.broadcast_to(line, (*line.shape[:-1], n)).reshape(-1, n)[0]
    spectrum = np.fft.fft(np.fft.ifftshift(line)) / n
    return np.array([spectrum[periods * k % n] for k in range(-count, count + 1)])


N = np.arange(-4, 5)


def test_orders_of_a_phase_grating(device, precise):
    """i^n J_n(h), turned by the offset; 25 samples a period, aliases below 1e-17."""
    for axis, shape in [(1, (5, 100)), (0, (75, 4))]:
        for depth in [0.7, 2.0]:
            grid = Grid(shape, (4e-6, 5e-6))
            period, offset = 25 * grid.pitch[axis], 13e-6
            options = {"orientation": np.pi / 2 * (1 - axis), "depth": depth, "offset": offset}
            expected = 1j**N * jv(N, depth) * np.exp(-2j * np.pi * N * offset / period)
            for where, tolerance in ((device, 2e-7), (precise, 1e-14)):
                t = grating(ones(grid, where), period, kind="phase", **options).to_numpy()
                got = orders(t, shape[axis] // 25, axis)
                assert np.abs(got - expected).max() <= tolerance
                assert np.abs(np.abs(t) - 1).max() <= tolerance


def test_orders_of_a_sinusoidal_grating(precise):
    grid = Grid((3, 60), 5e-6)
    t = grating(ones(grid, precise), 60e-6, kind="sinusoidal", depth=0.6, offset=7e-6).to_numpy()
    expected = np.where(N == 0, 0.5, np.where(np.abs(N) == 1, 0.15, 0)).astype(complex)
    expected = expected * np.exp(-2j * np.pi * N * 7 / 60)
    assert np.abs(orders(t, 5, 1) - expected).max() <= 1e-15
    assert grating(ones(grid, precise), 60e-6, kind="sinusoidal").to_numpy().real.max() == 1


def test_orders_of_a_binary_grating(precise):
    """duty sinc(n duty) times the sinc of a cell, plus the aliases of the sampled edges."""
    for duty in [0.5, 0.3, 0.03]:
        for offset in [0, 7.3e-6]:
            grid, samples = Grid((3, 75), 5e-6), 15
            period = samples * 5e-6
            t = grating(ones(grid, precise), period, duty=duty, offset=offset).to_numpy()
            m = N[:, None] + samples * np.arange(-20000, 20001)
            each = duty * np.sinc(m * duty) * np.sinc(m / samples)
            expected = (each * np.exp(-2j * np.pi * m * offset / period)).sum(axis=1)
            assert np.abs(orders(t, 5, 1) - expected).max() <= 3e-6  # the series is cut
            assert t.mean() == pytest.approx(duty, rel=1e-12)


def test_a_blazed_grating_sends_all_light_to_plus_one(device):
    for axis, shape in ((1, (4, 60)), (0, (45, 3))):
        grid = Grid(shape, 5e-6)
        orientation = np.pi / 2 * (1 - axis)
        t = grating(ones(grid, device), 75e-6, kind="blazed", orientation=orientation).to_numpy()
        assert np.abs(orders(t, shape[axis] // 15, axis) - (N == 1)).max() <= 2e-7


def test_orders_of_a_shallow_blaze(precise):
    """exp(i a/2) sinc(a/2 pi), a = h - 2 pi n; an unweighted jump would be 10 times further off."""
    for offset in [0, 1e-6, 2.3e-6]:
        samples, depth = 50, 3.0
        grid = Grid((2, 3 * samples), 5e-6)
        options = {"kind": "blazed", "depth": depth, "offset": offset}
        t = grating(ones(grid, precise), samples * 5e-6, **options).to_numpy()
        a = depth - 2 * np.pi * N
        expected = np.exp(0.5j * a) * np.sinc(a / (2 * np.pi))
        expected = expected * np.exp(-2j * np.pi * N * offset / (samples * 5e-6))
        assert np.abs(orders(t, 3, 1) - expected).max() <= 2e-3


def test_area_weights_of_bars(precise):
    """Against 60 x 60 points a cell, which place an edge to half a point, 1/120 of a cell."""
    for orientation in [0, 0.4, np.pi / 4, np.pi / 2, 2.0, -1e-9, 3.3]:
        for pitch in [(5e-6, 4e-6), (3e-6, 11e-6)]:
            for duty in [0.35, 0.9]:
                grid, period, offset = Grid((9, 8), pitch, origin=(2e-6, 0)), 23e-6, 3e-6
                options = {"orientation": orientation, "duty": duty, "offset": offset}
                got = grating(ones(grid, precise), period, **options).to_numpy().real
                part = (np.arange(60) + 0.5) / 60 - 0.5
                y = (grid.y[:, None] + part * pitch[0]).reshape(-1, 1)
                x = (grid.x[:, None] + part * pitch[1]).reshape(1, -1)
                s = (x * np.cos(orientation) + y * np.sin(orientation) - offset) / period
                clear = np.abs(s - np.rint(s)) < duty / 2
                expected = clear.reshape(9, 60, 8, 60).mean(axis=(1, 3))
                assert ((expected > 0) & (expected < 1)).any()
                assert np.abs(got - expected).max() <= 0.02
                assert np.abs(got - expected).mean() <= 0.004


def test_orientation_turns_x_towards_y(precise):
    """Light of the order +1 of a blazed grating leaves towards (+y, +x) for 0 < angle < 90."""
    grid = Grid((64, 48), (5e-6, 5e-6))
    fy, fx = 2 / (64 * 5e-6), 3 / (48 * 5e-6)
    period = 1 / np.hypot(fy, fx)
    t = grating(ones(grid, precise), period, kind="blazed", orientation=np.arctan2(fy, fx))
    spectrum = np.abs(np.fft.fft2(t.to_numpy())) / grid.shape[0] / grid.shape[1]
    assert spectrum[2, 3] == pytest.approx(1, abs=1e-12)


def test_period_below_two_samples(device):
    light = ones(Grid((20, 24), (4e-6, 5e-6)), device)
    grating(light, 10e-6)
    grating(light, 8e-6, orientation=np.pi / 2)
    grating(light, 7.2e-6, orientation=np.pi / 4)  # 2 samples along x are 10 um / cos
    message = r"got 1\.8 along axis 1; .* at most 4\.5e-06 m"
    with pytest.raises(SamplingError, match=message):
        grating(light, 9e-6)
    with pytest.raises(SamplingError, match=r"got 1\.75 along axis 0"):
        grating(light, 7e-6, orientation=np.pi / 2)


def test_no_lines_along_an_axis_of_one_sample(device):
    light = ones(Grid((1, 20), 5e-6), device)
    grating(light, 30e-6)
    with pytest.raises(ValueError, match="along axis 0, but the field has a single sample"):
        grating(light, 30e-6, orientation=0.1)


def test_axicon_phase(device, precise):
    for angle in [4e-3, -9e-3]:
        for shape in [(40, 51), (1, 60)]:
            grid, centre = Grid(shape, (6e-6, 5e-6), origin=(3e-6, 0)), (20e-6, -31e-6)
            y = grid.y[:, None] - centre[0] if shape[0] > 1 else 0
            expected = np.exp(-2j * np.pi / LAM * angle * np.hypot(y, grid.x - centre[1]))
            for where, tolerance in ((device, 2e-7), (precise, 1e-13)):
                got = axicon(ones(grid, where), angle, centre=centre).to_numpy().reshape(shape)
                assert np.abs(got - expected).max() <= tolerance


def test_aliased_axicon(device):
    light = ones(Grid((20, 24), (4e-6, 5e-6)), device)
    axicon(light, LAM / 10e-6)
    with pytest.raises(
        SamplingError, match=r"samples of 5e-06 m; use a pitch of at most .* 2\.5e-06"
    ):
        axicon(light, LAM / 5e-6)
    with pytest.warns(SamplingWarning, match="axicon"):
        axicon(light, -LAM / 5e-6, aliasing="warn")
    axicon(light, LAM / 5e-6, aliasing="allow")
    axicon(ones(Grid((1, 24), (4e-5, 5e-6)), device), LAM / 10e-6)  # the other axis has no step


def test_what_is_no_grating_and_no_axicon(device):
    for change, message in [
        ({"period": 0}, "period of a grating must be positive"),
        ({"kind": "square"}, "'binary', 'sinusoidal', 'phase' or 'blazed', got 'square'"),
        ({"orientation": np.inf}, "orientation of a grating must be finite"),
        ({"offset": np.nan}, "offset of a grating must be finite"),
        ({"duty": 0}, "duty of a grating must lie between 0 and 1"),
        ({"duty": 1.5}, "duty of a grating must lie between 0 and 1"),
        ({"depth": 1}, "must be None for a binary grating"),
        ({"kind": "phase"}, "requires depth="),
        ({"kind": "phase", "depth": np.nan}, "depth of a grating must be finite"),
        ({"kind": "sinusoidal", "depth": 1.1}, "must be from 0 to 1"),
    ]:
        options = {"period": 4e-6} | change
        with pytest.raises(ValueError, match=message):
            grating(ones(Grid((5, 6), 1e-6), device), **options)
    for angle, options, message in [
        (np.nan, {}, "angle of an axicon must be finite"),
        (1e-3, {"centre": (np.nan, 0)}, "centre of an axicon must be finite"),
        (1e-3, {"aliasing": "no"}, "'raise', 'warn' or 'allow'"),
    ]:
        with pytest.raises(ValueError, match=message):
            axicon(ones(Grid((5, 6), 1e-6), device), angle, **options)


def test_a_slight_tilt_is_continuous(precise):
    """The trapezoid of a cell becomes a box without a step."""
    grid = Grid((7, 40), 5e-6)
    light = ones(grid, precise)
    straight = grating(light, 37e-6).to_numpy()
    for tilt in (1e-14, 1e-11, 1e-8, 1e-6):
        near = grating(light, 37e-6, orientation=tilt).to_numpy()
        assert np.abs(near - straight).max() <= 10 * tilt + 1e-14
