"""transfer.cl and twofloat.cl: the transfer function against float64."""

import numpy as np
import reference

from clplen.wave.propagation.band import blas_limit
from clplen.wave.propagation.transfer_function import Sommerfeld, Transfer, fft_frequencies

# shape, pitch, z, wavelength
CASES = [
    ((12, 15), (6.6e-6, 5e-6), 0.24, 532e-9),
    ((31, 16), (5e-6, 6.6e-6), 1.0, 550e-9),
    ((1, 37), (5e-6, 5e-6), 0.01, 550e-9),
    ((16, 16), (0.5e-6, 0.7e-6), 1e-3, 550e-9),
    ((14, 9), (6.6e-6, 5e-6), -0.12, 532e-9),
    ((5, 76), (4e-6, 5e-6), 0.15, 550e-9),  # 39 columns: two vectors and a rest
]


def quadrant(H):
    return H[: H.shape[0] // 2 + 1, : H.shape[1] // 2 + 1]


def transfer_of(shape, pitch, z, wavelength, limits=(np.inf, np.inf)):
    """One quadrant of H, below the band limits."""
    f = tuple(fft_frequencies(n, d) for n, d in zip(shape, pitch, strict=True))
    weights = tuple((a < limit).astype(float) for a, limit in zip(f, limits, strict=True))
    return Transfer(shape, f, weights, z, wavelength)


def on_device(device, transfer, phase):
    return device.download(transfer.on_device(device, phase).values)


def phases(device):
    return ["twofloat", "fp64"] if device.has_fp64 else ["twofloat"]


def test_error_stays_below_its_bound(device):
    for shape, pitch, z, wavelength in CASES:
        for method in ["as", "blas"]:
            limits = [
                blas_limit(n, d, z, wavelength) if method == "blas" else np.inf
                for n, d in zip(shape, pitch, strict=True)
            ]
            transfer = transfer_of(shape, pitch, z, wavelength, limits)
            expected = quadrant(
                reference.transfer_function(
                    shape, pitch, z, wavelength, band="blas" if method == "blas" else None
                )
            )
            for phase in ["tables", *phases(device)]:
                got = on_device(device, transfer, phase)
                assert np.abs(got - expected).max() <= 6e-7, phase


def test_double_tables(precise):
    for shape, pitch, z, wavelength in CASES:
        transfer = transfer_of(shape, pitch, z, wavelength)
        expected = quadrant(reference.transfer_function(shape, pitch, z, wavelength))
        turns = abs(z) / wavelength * (wavelength / (2 * min(pitch))) ** 2
        bound = 2 * np.pi * 4 * np.finfo(float).eps * max(1.0, turns)
        assert np.abs(on_device(precise, transfer, "tables") - expected).max() <= bound


def test_evanescent_waves_decay_forward_and_vanish_backward(device):
    for z in [0.3e-6, -0.3e-6]:
        shape, pitch, wavelength = (17, 22), (0.1e-6, 0.07e-6), 550e-9
        transfer = transfer_of(shape, pitch, z, wavelength)
        expected = quadrant(reference.transfer_function(shape, pitch, z, wavelength))
        s = sum(
            (wavelength * np.arange(n // 2 + 1) / (n * d)) ** 2 for n, d in ((shape[1], pitch[1]),)
        )
        assert (s > 1).any()
        for phase in ["tables", *phases(device)]:
            got = on_device(device, transfer, phase)
            assert np.isfinite(got.view(np.float32)).all()
            # near s = 1 the root magnifies rounding: exp(-k z sqrt(eps)) is the bound
            assert np.abs(got - expected).max() <= 2 * np.pi * abs(z) / wavelength * 1e-6 + 1e-6


def test_weights_and_any_frequencies(device, precise):
    """Frequencies of a chirp-z transform, of both signs, with weights between 0 and 1."""
    f = (np.linspace(-3e4, 5e4, 11), np.linspace(-7e4, -1e4, 7))
    weights = (np.linspace(0, 1, 11), np.linspace(1, 0.25, 7))
    z, wavelength = 0.02, 532e-9
    transfer = Transfer((11, 7), f, weights, z, wavelength)
    s = (wavelength * f[0][:, None]) ** 2 + (wavelength * f[1]) ** 2
    H = np.exp(-2j * np.pi * z / wavelength * s / (1 + np.sqrt(1 - s))) * np.outer(*weights)
    for d, bound in ((device, 6e-7), (precise, 1e-10)):
        spectrum = transfer.on_device(d, "tables")
        assert not spectrum.is_quadrant
        assert np.abs(d.download(spectrum.values) - H).max() <= bound


def test_beyond_the_band_waves_may_be_evanescent(device):
    """The band propagates, the frequencies beside it do not: weight 0, among others in vectors."""
    shape, z, wavelength = (4, 80), 1e-4, 550e-9
    f = tuple(fft_frequencies(n, 0.2e-6) for n in shape)
    weights = tuple((a < 1.2e6).astype(float) for a in f)
    s = (wavelength * f[0][:, None]) ** 2 + (wavelength * f[1]) ** 2
    inside = np.outer(*weights) > 0
    assert (s > 1).any()
    assert (s[inside] < 1).all()
    turns = -z / wavelength * s / (1 + np.sqrt(np.maximum(1 - s, 0)))
    expected = np.where(inside, np.exp(2j * np.pi * turns), 0)
    transfer = Transfer(shape, f, weights, z, wavelength)
    got = on_device(device, transfer, "tables")
    assert np.abs(got - expected).max() <= 6e-7


def test_turned(device):
    """The same samples with x and y exchanged, bit for bit where the phase is the same sum."""
    for kind in ["transfer", "sommerfeld"]:
        shape, pitch, z, wavelength = (12, 70), (6.6e-6, 5e-6), 0.02, 532e-9
        factor = transfer_of(shape, pitch, z, wavelength, (3e4, 5e4))
        if kind == "sommerfeld":
            factor = Sommerfeld(shape, pitch, z, wavelength)
        plain = device.download(factor.on_device(device, "tables").values)
        turned = factor.turned()
        assert turned.shape == (70, 12)
        got = device.download(turned.on_device(device, "tables").values)
        assert got.shape == plain.shape[::-1]
        np.testing.assert_allclose(got.T, plain, atol=2e-6 * np.abs(plain).max())  # float32
