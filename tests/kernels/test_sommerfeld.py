"""sommerfeld.cl: the sampled Rayleigh-Sommerfeld kernel against float64."""

import numpy as np
import pytest
import reference_sommerfeld as reference
from tolerance import relative_max

from clplen.wave.propagation.transfer_function import impulse_response, kernel_residual_turns

# shape, pitch, z, wavelength; Rk = 2e-7, 9.1, 91, 9.6e3, 0.045, 0.004 turns
CASES = [
    ((12, 15), (6.6e-6, 5e-6), 0.02, 532e-9),
    ((31, 16), (9e-5, 16e-5), 6.6e-3, 550e-9),
    ((17, 40), (9e-5, 6e-5), 2e-3, 532e-9),
    ((38, 23), (9e-4, 4e-4), 0.01, 550e-9),
    ((16, 13), (6e-5, 5e-5), -8e-3, 550e-9),
    ((2, 3), (3e-6, 2e-6), -2e-5, 633e-9),
]
ROUNDING = 3e-7  # two or three float32 rounding errors of amplitude and phasor


def phases(device):
    routes = ["tables"]
    if device.precision == "single":
        routes += ["fp64", "twofloat"] if device.has_fp64 else ["twofloat"]
    return routes


def test_error_stays_below_its_bound(device):
    for shape, pitch, z, wavelength in CASES:
        expected = reference.impulse_response(shape, pitch, z, wavelength)
        for phase in phases(device):
            got = device.download(impulse_response(shape, pitch, z, wavelength, device, phase))
            assert got.dtype == np.complex64
            assert relative_max(expected, got) <= ROUNDING, phase


def test_double(precise):
    for shape, pitch, z, wavelength in CASES:
        expected = reference.impulse_response(shape, pitch, z, wavelength)
        got = precise.download(impulse_response(shape, pitch, z, wavelength, precise, "tables"))
        # k r, rounded a few times
        r = np.hypot(z, np.hypot(*(n // 2 * d for n, d in zip(shape, pitch, strict=True))))
        assert got.dtype == np.complex128
        assert relative_max(expected, got) <= 2 * np.pi * np.finfo(float).eps * r / wavelength


def test_line_sources(device, precise):
    for shape in [(1, 9), (10, 1), (1, 1)]:
        for z in [3e-3, -3e-3]:
            pitch, wavelength = (7e-6, 5e-6), 550e-9
            expected = np.ones((1, 1), complex)
            if shape != (1, 1):
                d = pitch[0] if shape[1] == 1 else pitch[1]
                expected = reference.line_response(max(shape), d, z, wavelength).reshape(shape)
            for one, tolerance in ((device, 1e-7), (precise, 1e-13)):
                got = one.download(impulse_response(shape, pitch, z, wavelength, one, "tables"))
                assert got.shape == shape
                assert got.dtype == one.complex
                assert relative_max(expected, got) <= tolerance


def test_a_line_beyond_the_range_of_the_hankel_function(precise):
    # (ikz/2r) H1(kr) e^{-ikz} -> e^{-i pi/4}/sqrt(lam z) on the axis, but for 1/kr
    z, wavelength, d = 100.0, 550e-9, 1e-5
    h = precise.download(impulse_response((1, 4), (d, d), z, wavelength, precise, "tables"))
    assert h[0, 0] == pytest.approx(np.exp(-0.25j * np.pi) * d / np.sqrt(wavelength * z), rel=1e-8)
    # continuous across kr = 1e8, z = 8.7535 m
    below, above = (
        precise.download(impulse_response((1, 2), (d, d), z, wavelength, precise, "tables"))[0, 0]
        for z in (8.7534, 8.7536)
    )
    assert above / below == pytest.approx(np.sqrt(8.7534 / 8.7536), rel=1e-9)


def test_residual():
    shape, pitch, wavelength = (31, 16), (9e-5, 16e-5), 550e-9
    # corner displacement 15 dy, 8 dx
    z, rho = 6.6e-3, np.hypot(15 * pitch[0], 8 * pitch[1])
    expected = (np.hypot(rho, z) - z) ** 2 / (2 * z * wavelength)
    assert kernel_residual_turns(shape, pitch, z, wavelength) == pytest.approx(expected, rel=1e-9)
    assert kernel_residual_turns(shape, pitch, -z, wavelength) == pytest.approx(expected, rel=1e-9)


def test_bad_input_is_refused(device, precise):
    arguments = ((4, 4), (1e-6, 1e-6))
    for z in (0, np.nan, np.inf):
        with pytest.raises(ValueError, match="finite and not 0"):
            impulse_response(*arguments, z, 550e-9, device, "tables")
    with pytest.raises(ValueError, match="no phase route 'float'"):
        impulse_response(*arguments, 1e-3, 550e-9, device, "float")
    with pytest.raises(ValueError, match="double precision; use one of tables"):
        impulse_response(*arguments, 1e-3, 550e-9, precise, "twofloat")
