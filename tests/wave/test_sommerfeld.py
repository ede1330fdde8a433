"""The sampled Rayleigh-Sommerfeld kernel as physics: large grids, plane waves, apertures."""

import numpy as np
import pytest
import reference
import reference_sommerfeld
from tolerance import err_db, relative_max

from clplen.wave.propagation.transfer_function import impulse_response

LAM = 550e-9


def sampled(shape, pitch, z, device, wavelength=LAM):
    """The kernel as plans form it."""
    return device.download(impulse_response(shape, pitch, z, wavelength, device, "tables"))


@pytest.mark.parametrize("z", [0.24, 0.5, 0.01])
def test_rows_of_the_kernel_of_a_large_grid(device, z):
    # 3030 samples of 6.6 um, doubled: its first and its outermost rows, as a window of three rows
    # 3030 samples apart. Rk = 10.4, 1.16, 3.6e4 turns.
    shape, pitch = (3, 6060), (3030 * 6.6e-6, 6.6e-6)
    expected = reference_sommerfeld.impulse_response(shape, pitch, z, LAM)
    got = sampled(shape, pitch, z, device)
    for row in range(3):  # each against its own maximum
        assert relative_max(expected[row], got[row]) <= 3e-7
    assert err_db(expected, got) >= 120


def test_double_rows_of_the_kernel_of_a_large_grid(precise):
    shape, pitch = (3, 6060), (3030 * 6.6e-6, 6.6e-6)
    expected = reference_sommerfeld.impulse_response(shape, pitch, 0.24, LAM)
    # 2.9e3 turns at the corner, from r known to 1e-16
    assert relative_max(expected, sampled(shape, pitch, 0.24, precise)) <= 1e-11


def test_the_spectrum_is_the_transfer_function(precise):
    # The window delivers frequencies up to 0.96 and 0.91 of Nyquist; the rest, cut off at its edge,
    # is a ripple of about sqrt(lam z)/W = 0.05 there and a fifth of that far inside.
    shape, pitch, z = (360, 420), (5e-6, 4.5e-6), 17e-3
    spectrum = np.fft.fft2(sampled(shape, pitch, z, precise))
    expected = reference.transfer_function(shape, pitch, z, LAM)
    inner = np.ix_(*(np.abs(np.fft.fftfreq(n)) < 0.1 for n in shape))
    assert np.abs(spectrum[inner] - expected[inner]).max() <= 0.015


@pytest.mark.parametrize("z", [8e-3, -8e-3])
@pytest.mark.parametrize("shape", [(11, 14), (13, 12), (9, 1), (1, 8)])
def test_convolution_is_the_direct_sum(device, precise, shape, z):
    pitch = (6.6e-6, 5e-6)
    rng = np.random.default_rng(3)
    u = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    window = tuple(n if n == 1 else 2 * n for n in shape)
    if 1 in shape:
        n, d = max(shape), pitch[0] if shape[1] == 1 else pitch[1]
        h = reference_sommerfeld.line_response(2 * n, d, z, LAM)
        i = np.arange(n)
        expected = (h[i[:, None] - i] @ u.ravel()).reshape(shape)
    else:
        expected = reference.rayleigh_sommerfeld(u, pitch, z, LAM)
    for one, tolerance in ((device, 4e-7), (precise, 1e-11)):
        h = sampled(window, pitch, z, one).astype(complex)
        got = np.fft.ifft2(np.fft.fft2(u, window) * np.fft.fft2(h))[: shape[0], : shape[1]]
        assert relative_max(expected, got) <= tolerance


def test_slit_far_away_in_one_dimension(device):
    # Set-up A of the field tests at z = 64 S: a slit of half the window, edge samples of weight 1/2
    n, d = 1024, 2 * LAM
    x = reference.axis(n, d)
    u = (np.abs(x) < n * d / 4) + 0.5 * (np.abs(x) == n * d / 4)
    z = 64 * n * d
    h = sampled((1, 2 * n), (d, d), z, device).astype(complex)[0]
    got = np.fft.ifft(np.fft.fft(u, 2 * n) * np.fft.fft(h))[:n]
    expected = reference.slit_exact(x, z, width=n * d / 2, wavelength=LAM)
    # design value 83.25 dB: the sampled edge
    assert err_db(expected, got) == pytest.approx(83.25, abs=0.5)
