"""Thin lenses: phase in float32, sampling rule, messages, what they do to light."""

import numpy as np
import pytest
import reference
from reference_elements import stigmatic_phase
from tolerance import relative_max

from clplen import Field, Grid, SamplingError, SamplingWarning, thin_lens

LAM = 532e-9


def ones(grid, device, wavelength=LAM):
    return Field.from_array(np.ones(grid.shape), grid, wavelength=wavelength, device=device)


def test_lens_phase_in_float32(device, precise):
    for f in [0.12, -0.05]:
        for shape in [(64, 75), (33, 40), (1, 50)]:
            grid = Grid(shape, (5e-6, 6.6e-6), origin=(2.5e-6, 0))
            expected = reference.lens_phase(shape, grid.pitch, f, LAM, origin=grid.origin)
            assert np.abs(thin_lens(ones(grid, device), f).to_numpy() - expected).max() <= 3e-7
            assert np.abs(thin_lens(ones(grid, precise), f).to_numpy() - expected).max() <= 1e-13


def test_aliased_lens_says_what_would_do(device):
    grid = Grid((100, 100), 5e-6)
    f_min = 2 * 200e-6 * 5e-6 / LAM
    thin_lens(ones(grid, device), 1.001 * f_min, diameter=400e-6)
    with pytest.raises(SamplingError, match=r"R = 0.0002 m, R_max = .*at least 0.003759 m"):
        thin_lens(ones(grid, device), 0.9 * f_min, diameter=400e-6)
    with pytest.warns(SamplingWarning, match="R_max"):
        thin_lens(ones(grid, device), 0.9 * f_min, diameter=400e-6, aliasing="warn")
    thin_lens(ones(grid, device), 0.9 * f_min, diameter=400e-6, aliasing="allow")
    for form, f in (("paraxial", 0.9 * f_min), ("stigmatic", 0.3 * f_min)):
        with pytest.raises(SamplingError) as refused:
            thin_lens(ones(grid, device), f, diameter=400e-6, form=form)
        pitch = float(str(refused.value).split("samples, of at most ")[1].split()[0])
        assert 0.2 * grid.pitch[1] < pitch < grid.pitch[1]
        finer = Grid((1, int(500e-6 / pitch)), pitch)
        thin_lens(ones(finer, device), f, diameter=400e-6, form=form)
        with pytest.raises(SamplingError):
            thin_lens(ones(Grid(finer.shape, 1.002 * pitch), device), f, diameter=400e-6, form=form)
    with pytest.raises(SamplingError, match=r"R = 0.00025 m"):  # half of the window
        thin_lens(ones(grid, device), 2e-3)


def test_what_is_no_lens(device):
    for f, more, message in [
        (0, {}, "focal_length must not be 0"),
        (np.nan, {}, "focal_length must not be 0"),
        (1.0, {"aliasing": "ignore"}, "'raise', 'warn' or 'allow'"),
        (1.0, {"form": "thick"}, "form must be 'paraxial' or 'stigmatic', got 'thick'"),
    ]:
        with pytest.raises(ValueError, match=message):
            thin_lens(ones(Grid((3, 4), 1e-6), device), f, **more)


# Stigmatic form


def test_stigmatic_phase_in_float32(device, precise):
    """1.1e-6 rad on PoCL and Intel at 10 mm (0.6 turns beside the tables), 3e-7 at 2 mm."""
    for f in [10e-3, -10e-3, 2e-3]:
        grid = Grid((401, 300), 5e-6, origin=(0, 2.5e-6))
        expected = stigmatic_phase(grid.shape, grid.pitch, f, LAM, origin=grid.origin)
        for where, bound in ((device, 3e-6), (precise, 1e-11)):
            got = thin_lens(ones(grid, where), f, form="stigmatic", aliasing="allow").to_numpy()
            assert np.abs(np.angle(got * expected.conj())).max() <= bound


def test_stigmatic_aperture_and_infinity(device):
    grid = Grid((40, 47), (5e-6, 4e-6))
    got = thin_lens(ones(grid, device), 0.05, diameter=120e-6, form="stigmatic").to_numpy()
    expected = reference.circle_coverage(grid.shape, grid.pitch, 120e-6)
    expected = expected * stigmatic_phase(grid.shape, grid.pitch, 0.05, LAM)
    assert np.abs(got - expected).max() <= 3e-4  # coverage by strips
    flat = thin_lens(ones(grid, device), np.inf, form="stigmatic").to_numpy()
    assert relative_max(np.ones(grid.shape, complex), flat) == 0


def test_stigmatic_limit_and_its_message(device):
    """R_max = f q/sqrt(1 - q^2): there the phase changes by pi a sample, by less before."""
    dx, f = 0.4e-6, 50e-6
    q = LAM / (2 * dx)
    largest = f * q / np.sqrt(1 - q**2)
    r = np.array([0.999, 1.001]) * largest
    step = 2 * np.pi / LAM * (np.hypot(r + dx / 2, f) - np.hypot(r - dx / 2, f))
    assert step[0] < np.pi < step[1]
    grid = Grid((1, 800), dx)
    thin_lens(ones(grid, device), f, diameter=1.99 * largest, form="stigmatic")
    match = rf"R_max = f q/sqrt\(1 - q\^2\), q = lam/\(2 dx\), = {largest:.4g} m; .*at least 5.05e"
    with pytest.raises(SamplingError, match=match):
        thin_lens(ones(grid, device), f, diameter=2.02 * largest, form="stigmatic")
    with pytest.warns(SamplingWarning, match="R_max"):
        thin_lens(ones(grid, device), f, diameter=2.02 * largest, form="stigmatic", aliasing="warn")
    finer = Grid((1, 800), 0.26e-6)  # below lam/2 no ray is too steep
    thin_lens(ones(finer, device), 1e-6, form="stigmatic")


def test_a_length_of_one_is_a_cylinder(device):
    line, plane = Grid((1, 90), 4e-6, origin=(1e-4, 0)), Grid((1, 90), 4e-6)
    for form in ("paraxial", "stigmatic"):
        got = [
            thin_lens(ones(grid, device), 20e-3, diameter=250e-6, form=form).to_numpy()
            for grid in (line, plane)
        ]
        np.testing.assert_array_equal(*got)
        cut = 250e-6 / 4e-6  # samples across the slit
        assert np.abs(got[0]).sum() == pytest.approx(cut, rel=1e-6)


# What a lens does
