"""The Fresnel twins and the 2f system against closed forms and the printed values."""

from __future__ import annotations

import numpy as np
import pytest
from reference_closed import gaussian_paraxial, lens_focus
from reference_elements import circle_coverage
from reference_optics import axis, centred_slice, propagate, radius_squared
from reference_propagation import (
    even_length,
    fresnel_1fft,
    fresnel_ir,
    fresnel_multistep,
    fresnel_tf,
)
from setups import (
    LAM,
    gaussian_fresnel,
    rectangle,
    rectangle_exact,
    slit_fresnel,
    two_f,
)
from tolerance import err_db, relative_max, snr_db

pytestmark = pytest.mark.nightly

LIGHT = {"wavelength": LAM}
DX = 6.6e-6


def near(printed: float) -> object:
    """A printed figure: they have one or two decimals, half a decibel is the acceptance."""
    return pytest.approx(printed, abs=0.5)


def random_field(shape, seed: int = 0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


# Fresnel by one FFT ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("z", "full", "half"),
    [(10, 15.6, 25.4), (20, 26.1, 33.8), (40, 28.0, 36.9), (80, 28.5, 38.1), (500, 28.7, 38.5)],
)
def test_rectangle_by_one_fft(z, full, half):
    u, size = rectangle()
    got, pitch = fresnel_1fft(u, DX, z * 1e-3, **LIGHT)
    assert pitch == pytest.approx((LAM * z * 1e-3 / (512 * DX),) * 2, rel=1e-14)
    exact = rectangle_exact(u.shape, pitch, z * 1e-3, size=size)
    part = (slice(128, 384),) * 2
    assert snr_db(exact, got) == near(full)
    assert snr_db(exact[part], got[part]) == near(half)
    assert err_db(exact[part], got[part]) > half - 0.6  # no constant is lost


@pytest.mark.parametrize("shape", [(60, 45), (45, 64)])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("pad", [1, 2])
def test_gaussian_by_one_fft(shape, sign, pad):
    d, z, waist = (5e-6, 6e-6), sign * 60 * 30e-12 / LAM, 28e-6
    r2 = radius_squared(shape, d, (4e-6, -7e-6))
    got, pitch = fresnel_1fft(np.exp(-r2 / waist**2) + 0j, d, z, pad=pad, **LIGHT)
    r = np.sqrt(radius_squared(shape, pitch, (4e-6, -7e-6)))
    exact = gaussian_paraxial(r, z, waist=waist, wavelength=LAM)
    assert err_db(exact, got) > 140  # the beam is exp(-16) at the nearest rim
    back, again = fresnel_1fft(got, pitch, -z, pad=1, **LIGHT)
    if pad == 1:
        assert again == pytest.approx(d)
        assert relative_max(np.exp(-r2 / waist**2) + 0j, back) < 1e-13


def test_lens_fused_with_the_step():
    """At z = f only the pupil is sampled: Airy's formula for every f, half of f_min included.

    The printed 71.5 dB is that of 9 x 9 points a rim cell; exact coverage reaches 73.6.
    """
    n, d, diameter = 256, 4e-6, 0.8e-3
    u = circle_coverage((n, n), d, diameter) + 0j
    for f in (0.5 * diameter * d / LAM, 20e-3):
        got, pitch = fresnel_1fft(u, d, f, lens=f, **LIGHT)
        r = np.sqrt(radius_squared((n, n), pitch))
        exact = lens_focus(r, f=f, diameter=diameter, wavelength=LAM)
        inner, part = r < 6 * 1.22 * LAM * f / diameter, (slice(64, 192),) * 2
        assert snr_db(exact[inner], got[inner]) == near(73.5)
        assert snr_db(exact, got) == near(35.6)
        assert snr_db(exact[part], got[part]) == near(45.9)
        assert err_db(exact[inner], got[inner]) > 70


def test_one_fft_refuses_z_zero():
    with pytest.raises(ValueError, match="z = 0"):
        fresnel_1fft(np.ones((4, 4), complex), 1e-6, 0.0, **LIGHT)


# Fresnel in many steps --------------------------------------------------------------------------

STEPS = {  # z: pad 1, pad 1 t=.2, pad 2, pad 2 t=.2, pad 2 t=.4, pad 4 t=.4, TF, IR
    1: (35, 35, 36, 36, 36, 36, 36, 35),
    4: (28, 31, 44, 47, 51, 55, 44, 55),
    8: (23, 30, 33, 36, 45, 63, 33, 64),
    16: (19, 28, 27, 37, 54, 54, 27, 73),
    64: (13, 23, 20, 52, 85, 88, 20, 91),
}
BORDERS = ((1, 0), (1, 0.2), (2, 0), (2, 0.2), (2, 0.4), (4, 0.4))


@pytest.mark.parametrize("z", STEPS)
def test_slit_in_many_steps(z):
    a = slit_fresnel(z)
    step = (a.u, a.pitch, a.z)
    got = [fresnel_multistep(*step, pad=pad, border=t, **LIGHT) for pad, t in BORDERS]
    got += [fresnel_tf(*step, **LIGHT), fresnel_ir(*step, **LIGHT)]
    for field, printed in zip(got, STEPS[z], strict=True):
        assert err_db(a.exact, field) == pytest.approx(printed, abs=0.6)  # printed without decimals


@pytest.mark.parametrize("z", [1, 4, 8])
def test_gaussian_in_many_steps(z):
    a = gaussian_fresnel(z)
    there = fresnel_multistep(a.u, a.pitch, a.z, **LIGHT)
    assert err_db(a.exact, there) > 280
    assert err_db(a.u, fresnel_multistep(a.exact, a.pitch, -a.z, **LIGHT)) > 280


def test_many_steps_have_their_own_length_on_each_axis():
    """Rectangular grid, dy != dx: three steps and a rest in y, two and a rest in x."""
    assert [even_length(n, 2) for n in (64, 37, 11)] == [128, 80, 24]
    assert [even_length(n, 1) for n in (64, 37)] == [64, 38]
    shape, d, waist = (64, 37), (4e-6, 6e-6), 40e-6
    z = 2.25 * 80 * d[1] ** 2 / LAM
    r2 = radius_squared(shape, d)
    exact = gaussian_paraxial(np.sqrt(r2), z, waist=waist, wavelength=LAM)
    got = fresnel_multistep(np.exp(-r2 / waist**2) + 0j, d, z, border=0, **LIGHT)
    plain = fresnel_tf(np.exp(-r2 / waist**2) + 0j, d, z, **LIGHT)
    assert err_db(exact, got) > 75
    assert err_db(plain, got) > 75


@pytest.mark.parametrize("n", [256, 1000, 3030])
def test_one_step_of_even_length_is_the_transfer_function(n):
    u, z = random_field((1, n)), n * DX**2 / LAM
    got, pitch = fresnel_1fft(u, DX, z, **LIGHT)
    assert pitch == pytest.approx((DX, DX))
    assert relative_max(fresnel_tf(u, DX, z, pad=1, **LIGHT), got) < 1e-12


def test_one_step_of_odd_length_is_not():
    n = 255
    z = n * DX**2 / LAM
    u = random_field((1, n))
    whole = fresnel_tf(u, DX, z, pad=1, **LIGHT)
    got = fresnel_1fft(u, DX, z, **LIGHT)[0]
    assert err_db(whole, got) == pytest.approx(0, abs=1.5)
    u = np.exp(-((axis(n, 1.0) / 8) ** 2))[None] + 0j
    compact = fresnel_tf(u, DX, z, pad=1, **LIGHT)
    assert relative_max(compact, fresnel_1fft(u, DX, z, **LIGHT)[0]) < 1e-14


# Fresnel convolutions --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("z", "ratio", "tf", "ir"),
    [
        (10, 0.12, 23.0, 0.3),
        (40, 0.49, 28.5, 27.8),
        (80, 0.99, 38.0, 38.0),
        (160, 1.97, 37.4, 47.3),
        (500, 6.2, 21.3, 62.1),
        (2000, 24.7, 13.4, 80.5),
    ],
)
def test_rectangle_on_both_sides_of_the_critical_distance(z, ratio, tf, ir):
    """The printed z/z_c are roundings of z = 10, 40, 80, 160, 500 and 2000 mm."""
    u, size = rectangle()
    assert z * 1e-3 / (1024 * DX**2 / LAM) == pytest.approx(ratio, rel=0.03, abs=0)
    exact = rectangle_exact(u.shape, DX, z * 1e-3, size=size)
    assert snr_db(exact, fresnel_tf(u, DX, z * 1e-3, **LIGHT)) == near(tf)
    assert snr_db(exact, fresnel_ir(u, DX, z * 1e-3, **LIGHT)) == near(ir)


@pytest.mark.parametrize("sign", [1, -1])
def test_both_convolutions_on_a_rectangular_grid(sign):
    """At the critical distance of y; that of x is 1.3 times longer. Odd, dy != dx, off-centre."""
    shape, d, waist = (61, 50), (5e-6, 6.3e-6), 30e-6
    r2 = radius_squared(shape, d, (11e-6, -17e-6))
    u, z = np.exp(-r2 / waist**2) + 0j, sign * 126 * d[0] ** 2 / LAM
    exact = gaussian_paraxial(np.sqrt(r2), z, waist=waist, wavelength=LAM)
    for step in (fresnel_tf, fresnel_ir):
        assert err_db(exact, step(u, d, z, **LIGHT)) > 90
        assert err_db(exact, step(u, d[::-1], z, **LIGHT)) < 30


# The 2f system ----------------------------------------------------------------------------------


def test_point_through_the_2f_system():
    """Figures of the design for a 9 x 9 sub-sampled pupil: exact coverage gains up to 2 dB."""
    a = two_f()
    n = a.u.shape[0]
    core = np.sqrt(radius_squared(a.u.shape, a.pitch)) < 0.5e-3
    steps = {
        "multi-step": (lambda u, z: fresnel_multistep(u, a.pitch, z, **LIGHT), 50.7, 78.5),
        "fresnel-ir": (lambda u, z: fresnel_ir(u, a.pitch, z, **LIGHT), 55.9, 81.5),
        "as": (lambda u, z: padded(u, a.pitch, z, "as"), 41.5, 61.6),
        "blas": (lambda u, z: padded(u, a.pitch, z, "blas"), 52.1, 63.5),
    }
    for step, full, inner in steps.values():
        got = step(step(a.u, a.z1) * a.lens, a.z2)
        assert snr_db(a.image, got) == near(full)
        assert inner - 0.2 < snr_db(a.image[core], got[core]) < inner + 2
        peak = np.abs(got[n // 2, n // 2] / a.image[n // 2, n // 2]) ** 2
        assert peak == pytest.approx(1, abs=2e-4)


def padded(u, pitch, z, method):
    """Exactly twice the length, as the figures want it."""
    part = (centred_slice(len(u), 2 * len(u)),) * 2
    window = np.zeros((2 * len(u),) * 2, complex)
    window[part] = u
    return propagate(window, pitch, z, LAM, method=method, pad=1, workers=2)[part]
