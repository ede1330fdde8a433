"""The sampled Rayleigh-Sommerfeld kernel as physics: large grids, plane waves, apertures."""

import numpy as np
import reference
import reference_sommerfeld
from tolerance import err_db, relative_max

from clplen.wave.propagation.transfer_function import impulse_response

LAM = 550e-9


def sampled(shape, pitch, z, device, wavelength=LAM):
    """The kernel as plans form it."""
    return device.download(impulse_response(shape, pitch, z, wavelength, device, "tables"))


def test_rows_of_the_kernel_of_a_large_grid(device):
    for z in [0.24, 0.5, 0.01]:
        # The first and the outermost rows of 3030 samples of 6.6 um, doubled, as a window of three
        # rows 3030 samples apart. Rk = 10.4, 1.16, 3.6e4 turns.
        shape, pitch = (3, 6060), (3030 * 6.6e-6, 6.6e-6)
        expected = reference_sommerfeld.impulse_response(shape, pitch, z, LAM)
        got = sampled(shape, pitch, z, device)
        for row in range(3):  # each against its own maximum
            assert relative_max(expected[row], got[row]) <= 3e-7
        assert err_db(expected, got) >= 120


def test_convolution_is_the_direct_sum(device, precise):
    for z in [8e-3, -8e-3]:
        for shape in [(11, 14), (13, 12), (9, 1), (1, 8)]:
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
