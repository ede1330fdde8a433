"""What every propagation obeys: plane waves, group laws, band limits, energy."""

from __future__ import annotations

import numpy as np
import pytest
from fields import field_of, step
from reference_closed import (
    gaussian_paraxial,
    talbot_distance,
    tilted_plane_wave,
)
from reference_optics import axis, blas_limit, radius_squared
from setups import LAM
from tolerance import err_db, relative_max

from clplen import Grid, Propagator, propagate

pytestmark = pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")

EXACT = ("as", "blas", "cblas", "rs", "auto")


def random_field(shape, seed=0, share=1.0) -> np.ndarray:
    """White below a share of Nyquist, with a mean."""
    rng = np.random.default_rng(seed)
    spectrum = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    inside = [np.abs(np.fft.fftfreq(n)) <= share / 2 for n in shape]
    return np.fft.ifft2(spectrum * np.multiply.outer(*inside)) * np.sqrt(np.prod(shape)) + 0.2


# Plane waves ------------------------------------------------------------------------------------


def test_tilted_plane_waves(device, precise):
    shape = (16, 21)
    for index in [(-2, 3), (2, -3), (0, 5)]:
        for z in [0.013, -0.1]:
            pitch = (3e-6, 2e-6)
            fy, fx = (i / (n * d) for i, n, d in zip(index, shape, pitch, strict=True))
            y, x = (axis(n, d) for n, d in zip(shape, pitch, strict=True))
            start, end = (
                tilted_plane_wave(y[:, None], x, t, fy=fy, fx=fx, wavelength=LAM) for t in (0, z)
            )
            got = step(start, pitch, z, precise, method="as", pad=1)
            assert np.abs(got - end).max() <= 1e-12
            assert err_db(end, step(start, pitch, z, device, method="as", pad=1)) >= 120


def test_talbot_images(device, precise):
    """Orders 0 and +-1 of period 8 lam: an image of itself at the exact distance, not the paraxial.

    The orders come back in phase with each other; the common phase of all is the carrier's.
    """
    for n in [128, 135]:
        dx, period = 0.5 * LAM, 8 * LAM
        if n % 2:
            dx = period / 15  # odd: 9 periods of 15 samples
        u = 1 + 0.5 * np.cos(2 * np.pi * axis(n, dx)[None] / period)
        exact = talbot_distance(period, LAM)
        assert exact / (2 * period**2 / LAM) == pytest.approx(0.99608, abs=1e-5)
        for dev, worst in ((precise, 1e-12), (device, 1e-6)):
            got = step(u, dx, 10 * exact, dev, method="as", pad=1)
            assert relative_max(u + 0j, got) <= worst
            paraxial = step(u, dx, 10 * 2 * period**2 / LAM, dev, method="as", pad=1)
            assert relative_max(u + 0j, paraxial) > 1e-3


# Group laws -------------------------------------------------------------------------------------


def test_group_laws_of_the_periodic_angular_spectrum(device, precise):
    """Unitary, z then -z, z1 then z2: to rounding (the phases are up to 100 turns)."""
    for shape in [(27, 20), (1, 64)]:
        pitch, u = (3e-6, 2e-6), random_field(shape, 5)
        for dev, worst in ((precise, 1e-12), (device, 1e-6)):
            start = field_of(u, pitch, dev)
            there = propagate(start, 2e-4, method="as", pad=1)
            back = propagate(there, -2e-4, method="as", pad=1).to_numpy()
            assert relative_max(u, back) <= 2 * worst
            once = propagate(start, 5e-4, method="as", pad=1).to_numpy()
            assert (
                relative_max(once, propagate(there, 3e-4, method="as", pad=1).to_numpy())
                <= 2 * worst
            )
            assert float(there.power()) == pytest.approx(float(start.power()), rel=worst, abs=0)
            assert propagate(start, 0.0) is start


# Band limits ------------------------------------------------------------------------------------


def test_band_limit(device):
    """sin(atan(W/2z))/lam on each axis, W after padding, with a hard edge (pad 1: by plane waves).

    Twice as strict, L/(lam sqrt(L^2 + 16 z^2)), and the asymptote L/(2 lam z) are in circulation.
    """
    for shape, pitch in [((40, 63), (2e-6, 1.5e-6)), ((51, 36), (1e-6, 3e-6))]:
        for pad in (2, 1):
            z = 6e-4
            plan = Propagator(
                Grid(shape, pitch), z, wavelength=LAM, method="blas", pad=pad, device=device
            )
            windows = [n * d for n, d in zip(plan.report.padded_shape, pitch, strict=True)]
            limits = [
                min(blas_limit(w, z, LAM), 0.5 / d) for w, d in zip(windows, pitch, strict=True)
            ]
            assert plan.report.band == pytest.approx(limits, rel=1e-12)
            if pad == 2:
                continue
            for which in (0, 1):
                last = int(np.floor(limits[which] * windows[which]))
                for k, passes in ((last, 1), (last + 1, 0)):
                    phase = 2 * np.pi * k * np.arange(shape[which]) / shape[which]
                    wave = np.exp(1j * phase).reshape((-1, 1) if which == 0 else (1, -1))
                    u = np.broadcast_to(wave, shape)
                    power = np.mean(np.abs(step(u, pitch, z, device, method="blas", pad=1)) ** 2)
                    assert power == pytest.approx(passes, abs=1e-5)


def test_a_whole_band_is_the_plain_angular_spectrum(device, precise):
    """cblas onto a window 4 samples aside, W = 2 N dx: its ends are +-f_nyq, a sample they share.

    Its twin is the periodic sum over 2 N samples, in which that frequency comes once.
    """
    for n in [40, 41]:
        d, z, u = 1e-6, 3e-6, random_field((1, n), 4)
        window = np.zeros((1, 2 * n), complex)
        window[:, n - n // 2 : 2 * n - n // 2] = u
        aside = Grid((1, n), d, origin=(0, 4 * d))
        for dev, worst in ((precise, 1e-12), (device, 3e-6)):
            whole = step(window, d, z, dev, method="as", pad=1)
            got = propagate(field_of(u, d, dev), z, method="cblas", out_grid=aside).to_numpy()
            assert relative_max(whole[:, n - n // 2 + 4 :][:, :n], got) <= worst


# One answer by every method ---------------------------------------------------------------------


def test_constant_phase_is_that_of_every_method(device):
    """Carrier dropped, no -i lost: a Gaussian on a grid where all methods are sampled.

    Paraxial and exact differ by pi z lam^3 f^4/4 = 2e-6 rad at f = 1/(pi w0).
    """
    n, dx, waist = 128, 10e-6, 1.2e-4
    z = n * dx**2 / LAM
    u = np.exp(-radius_squared((n, n), dx) / waist**2)
    r = np.sqrt(radius_squared((n, n), dx))
    exact = gaussian_paraxial(r, z, waist=waist, wavelength=LAM)
    fresnel = ("fresnel-tf", "fresnel-ir", "fresnel-multistep", "fresnel-1fft")
    for method in (*EXACT, *fresnel):
        pad = 1 if method == "fresnel-1fft" else 2
        got = step(u, dx, z, device, method=method, pad=pad)[n // 2, n // 2]
        assert got == pytest.approx(exact[n // 2, n // 2], rel=2e-5), method
        back = step(u, dx, -z, device, method=method, pad=pad)[n // 2, n // 2]
        assert back == pytest.approx(exact[n // 2, n // 2].conj(), rel=2e-5), method


# Energy -----------------------------------------------------------------------------------------

BUDGETS = [  # method, z: cblas by FFT of its own window, then where a step takes chirp-z
    ("as", 2e-4),
    ("blas", 8e-4),
    ("cblas", 2e-4),
    ("cblas", 4e-3),
]


def test_energy_closes(device, precise):
    """into = window + outside + cut, each by itself, and against a sum over the spectrum."""
    for method, z in BUDGETS:
        for shape in [(33, 64), (1, 90)]:
            pitch = (1.0e-6, 1.5e-6)
            u = random_field(shape, 7)
            for dev, closure in ((device, 1e-6), (precise, 1e-12)):
                field = field_of(u, pitch, dev)
                plan = Propagator(field.grid, z, wavelength=LAM, method=method, device=dev)
                if z == 4e-3:
                    assert plan.report.route.startswith("chirp-z")
                energy = plan.energy(field)
                total = np.sum(np.abs(u) ** 2) * np.prod(pitch)
                assert energy.into == pytest.approx(total, rel=closure, abs=0)
                parts = energy.window + energy.outside + energy.cut
                assert parts == pytest.approx(energy.into, rel=closure, abs=0)
                assert energy.outside > 0.05 * energy.into
                assert (energy.cut > 0.01 * energy.into) == (method == "blas" or z == 4e-3)
                arrived = np.sum(np.abs(plan(field).to_numpy().astype(complex)) ** 2) * np.prod(
                    pitch
                )
                assert energy.window == pytest.approx(arrived, rel=1e-5, abs=0)
