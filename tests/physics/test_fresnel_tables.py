"""Fresnel methods against closed forms and reference values."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from fields import field_of, step
from reference_closed import gaussian_paraxial, lens_focus
from reference_elements import circle_coverage
from reference_optics import radius_squared
from setups import LAM, gaussian_fresnel, slit_fresnel
from tolerance import err_db, relative_max, snr_db

from clplen import propagate

pytestmark = pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")

DX = 6.6e-6
slit = lru_cache(slit_fresnel)


def random_field(shape, seed=0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


# One transform ----------------------------------------------------------------------------------


def test_gaussian_by_one_transform(device, precise):
    """At dz of y, exp(-36) of the beam at the rims: 7e-15 of the field is rounding."""
    for sign in [1, -1]:
        for shape in [(255, 200)]:
            pitch = (DX, 7.1e-6)
            z, waist = sign * shape[0] * DX**2 / LAM, 1.1e-4
            u = np.exp(-radius_squared(shape, pitch) / waist**2)
            for dev, worst in ((precise, 7e-15), (device, 1e-6)):
                got = propagate(field_of(u, pitch, dev), z, method="fresnel-1fft", pad=1)
                own = [LAM * abs(z) / (n * d) for n, d in zip(shape, pitch, strict=True)]
                assert got.grid.pitch == pytest.approx(own, rel=1e-14, abs=0)
                r = np.sqrt(radius_squared(shape, own))
                exact = gaussian_paraxial(r, z, waist=waist, wavelength=LAM)
                assert err_db(exact, got.to_numpy()) >= -20 * np.log10(worst)


def test_there_and_back_by_one_transform(device, precise):
    """Chirps of up to 900 turns at the rims of the far grid, each rounded to 1e-16 of itself."""
    for z in [0.02, -0.3]:
        for shape in [(31, 20), (1, 50)]:
            u, pitch = random_field(shape), (5e-6, 6e-6)
            for dev, worst in ((precise, 1e-12), (device, 2e-6)):
                there = propagate(field_of(u, pitch, dev), z, method="fresnel-1fft", pad=1)
                back = propagate(there, -z, method="fresnel-1fft", pad=1)
                assert back.grid.pitch == pytest.approx(pitch, rel=1e-14, abs=0)
                assert relative_max(u, back.to_numpy()) <= worst


def test_lens_fused_with_the_step(device, precise):
    """At z = f only the pupil is sampled: Airy's formula for every f, half of f_min too.

    The printed 71.5 dB are those of 9 x 9 points a rim cell; exact coverage reaches 73.6.
    """
    for times in [0.5, 3]:
        n, d, diameter = 256, 4e-6, 0.8e-3
        f = times * diameter * d / LAM
        u = circle_coverage((n, n), d, diameter)
        for dev in (device, precise):
            got = propagate(field_of(u, d, dev), f, method="fresnel-1fft", pad=1, lens=f)
            r = np.sqrt(radius_squared((n, n), got.grid.pitch))
            exact, got = lens_focus(r, f=f, diameter=diameter, wavelength=LAM), got.to_numpy()
            inner, part = r < 6 * 1.22 * LAM * f / diameter, (slice(64, 192),) * 2
            assert 71 <= snr_db(exact[inner], got[inner]) <= 74
            assert snr_db(exact, got) == pytest.approx(35.6, abs=0.5)
            assert snr_db(exact[part], got[part]) == pytest.approx(45.9, abs=0.5)
            assert err_db(exact[inner], got[inner]) >= 70


# Many steps -------------------------------------------------------------------------------------

STEPS = {  # z: pad 1, pad 1 t=.2, pad 2, pad 2 t=.2, pad 2 t=.4, pad 4 t=.4, TF, IR
    1: (35, 35, 36, 36, 36, 36, 36, 35),
    4: (28, 31, 44, 47, 51, 55, 44, 55),
    8: (23, 30, 33, 36, 45, 63, 33, 64),
    16: (19, 28, 27, 37, 54, 54, 27, 73),
    64: (13, 23, 20, 52, 85, 88, 20, 91),
}
WAYS = [
    {"method": "fresnel-multistep", "pad": pad, "border": border}
    for pad, border in ((1, 0), (1, 0.2), (2, 0), (2, 0.2), (2, 0.4), (4, 0.4))
] + [{"method": "fresnel-tf"}, {"method": "fresnel-ir"}]


def test_slit_in_many_steps(device, precise):
    for z in STEPS:
        a = slit(z)
        for dev in (device, precise):
            got = [err_db(a.exact, step(a.u, a.pitch, a.z, dev, **way)) for way in WAYS]
            assert got == pytest.approx(STEPS[z], abs=1)
        if z == 64:  # the default border
            for dev in (device, precise):
                got = step(a.u.T, a.pitch, a.z, dev, method="fresnel-multistep")
                assert err_db(a.exact.T, got) >= 80


def test_gaussian_in_many_steps(device, precise):
    for z in [1, -3.7]:
        a = gaussian_fresnel(abs(z))
        exact = a.exact if z > 0 else a.exact.conj()
        for dev, floor in ((precise, 280), (device, 120)):
            got = step(a.u, a.pitch, np.copysign(a.z, z), dev, method="fresnel-multistep")
            assert err_db(exact, got) >= floor


def test_one_step_of_even_length_is_the_transfer_function(device, precise):
    """Discrete Gauss sum: dz = N dx^2/lam by one transform is the circular step by H."""
    for n in [256, 3030]:
        u, z = random_field((1, n)), n * DX**2 / LAM
        for dev, worst in ((precise, 1e-12), (device, 3e-6)):
            whole = step(u, DX, z, dev, method="fresnel-tf", pad=1)
            one = propagate(field_of(u, DX, dev), z, method="fresnel-1fft", pad=1)
            assert one.grid.pitch[1] == pytest.approx(DX, rel=1e-14, abs=0)
            many = step(u, DX, z, dev, method="fresnel-multistep", pad=1, border=0)
            assert relative_max(whole, one.to_numpy()) <= worst
            assert relative_max(whole, many) <= worst


def test_many_steps_of_an_odd_length_take_an_even_window(precise):
    """255 samples in a periodic window of 256, where one step is the transfer function."""
    n, u = 255, random_field((1, 255))
    z = (n + 1) * DX**2 / LAM
    window = np.append(np.zeros((1, 1)), u, axis=1)  # sample 127 on sample 128
    whole = step(window, DX, z, precise, method="fresnel-tf", pad=1)
    many = step(u, DX, z, precise, method="fresnel-multistep", pad=1, border=0)
    assert relative_max(whole[:, 1:], many) <= 1e-12


def test_each_axis_has_its_own_steps(device, precise):
    """Rectangular, dy != dx, off-centre: one step and a rest in y, two and a rest in x."""
    shape, pitch, waist = (64, 37), (5e-6, 6e-6), 40e-6
    z, centre = 2.4 * 80 * pitch[1] ** 2 / LAM, (9e-6, -14e-6)
    r2 = radius_squared(shape, pitch, centre)
    exact = gaussian_paraxial(np.sqrt(r2), z, waist=waist, wavelength=LAM)
    for dev in (device, precise):
        for way in ({"method": "fresnel-multistep", "border": 0}, {"method": "fresnel-tf"}):
            assert err_db(exact, step(np.exp(-r2 / waist**2), pitch, z, dev, **way)) >= 60


# Convolutions -----------------------------------------------------------------------------------
