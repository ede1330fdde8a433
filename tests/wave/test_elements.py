"""Thin lens and microlens array: values, sampling rule, messages."""

import numpy as np
import pytest
import reference
from tolerance import relative_max

from clplen import Field, Grid, MicrolensArray, SamplingError, SamplingWarning, thin_lens

LAM = 532e-9


def ones(grid, device):
    return Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)


@pytest.mark.parametrize("f", [0.12, -0.05])
@pytest.mark.parametrize("shape", [(64, 75), (33, 40), (1, 50)])
def test_lens_phase_in_float32(device, precise, f, shape):
    grid = Grid(shape, (5e-6, 6.6e-6), origin=(2.5e-6, 0))
    expected = reference.lens_phase(shape, grid.pitch, f, LAM, origin=grid.origin)
    assert np.abs(thin_lens(ones(grid, device), f).to_numpy() - expected).max() <= 3e-7
    assert np.abs(thin_lens(ones(grid, precise), f).to_numpy() - expected).max() <= 1e-13


def test_lens_at_full_sensor_size_keeps_its_phase(device):
    grid = Grid((1, 3030), 6.6e-6)
    expected = reference.lens_phase(grid.shape, grid.pitch, 0.12, LAM)
    got = thin_lens(ones(grid, device), 0.12, aliasing="allow").to_numpy()
    assert np.abs(got - expected).max() <= 3e-7


def test_aperture_of_a_lens_is_area_weighted(device):
    grid = Grid((40, 47), 5e-6)
    got = thin_lens(ones(grid, device), 0.1, diameter=120e-6).to_numpy()
    expected = reference.circle_coverage(grid.shape, grid.pitch, 120e-6)
    assert np.abs(np.abs(got) - expected).max() <= 3e-4


def test_infinite_focal_length_does_nothing(device):
    grid = Grid((5, 6), 1e-3)
    assert (
        relative_max(np.ones((5, 6), complex), thin_lens(ones(grid, device), np.inf).to_numpy())
        == 0
    )


def test_aliased_lens_says_what_would_do(device):
    grid = Grid((100, 100), 5e-6)
    f_min = 2 * 200e-6 * 5e-6 / LAM
    thin_lens(ones(grid, device), 1.001 * f_min, diameter=400e-6)
    with pytest.raises(SamplingError, match=r"R = 0.0002 m, R_max = .*at least 0.003759 m"):
        thin_lens(ones(grid, device), 0.9 * f_min, diameter=400e-6)
    with pytest.warns(SamplingWarning, match="R_max"):
        thin_lens(ones(grid, device), 0.9 * f_min, diameter=400e-6, aliasing="warn")
    thin_lens(ones(grid, device), 0.9 * f_min, diameter=400e-6, aliasing="allow")


def test_without_diameter_the_half_window_counts(device):
    grid = Grid((100, 100), 5e-6)
    with pytest.raises(SamplingError, match=r"R = 0.00025 m"):
        thin_lens(ones(grid, device), 2e-3)


@pytest.mark.parametrize("f", [0, np.nan])
def test_focal_length_is_not_zero(device, f):
    with pytest.raises(ValueError, match="focal length is not 0"):
        thin_lens(ones(Grid((3, 4), 1e-6), device), f)


def test_aliasing_words(device):
    with pytest.raises(ValueError, match="'raise', 'warn' or 'allow'"):
        thin_lens(ones(Grid((3, 4), 1e-6), device), 1.0, aliasing="ignore")


def test_lenslets_below_two_samples(device):
    grid = Grid((16, 16), 5e-6)
    with pytest.raises(SamplingError, match=r"1.9 samples .* at least 2"):
        MicrolensArray(9.5e-6, 1e-3, count=3).apply(ones(grid, device))


def test_the_diameter_counts_for_aliasing(device):
    """Gaps between lenslets need no sampling: R is half the diameter, not half the pitch."""
    grid = Grid((64, 64), 5e-6)
    f = 2 * 60e-6 * 5e-6 / LAM  # R_max = 60 um
    MicrolensArray(150e-6, f, count=2, diameter=119e-6).apply(ones(grid, device))
    with pytest.raises(SamplingError, match="R_max"):
        MicrolensArray(150e-6, f, count=2, diameter=121e-6).apply(ones(grid, device))


def test_aliased_lenslets(device):
    grid = Grid((64, 64), 5e-6)
    with pytest.raises(SamplingError, match="R_max"):
        MicrolensArray(150e-6, 1e-3, count=2).apply(ones(grid, device))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pitch": 0}, "pitch of lenslets is positive"),
        ({"f": 0}, "focal length of lenslets"),
        ({"count": 0}, "count of lenslets"),
        ({"count": (3, 2.5)}, "count of lenslets"),
        ({"lattice": "cubic"}, "lattice is 'square' or 'hexagonal'"),
        ({"fill": "round"}, "fill is 'circular' or 'full'"),
        ({"diameter": 2e-4}, "between 0 and its pitch"),
        ({"count": (3, 3, 3)}, "one number or"),
        ({"rotation": np.nan}, "all finite"),
        ({"offset": (np.nan, 0)}, "all finite"),
    ],
)
def test_bad_arrays(change, message):
    values = {"pitch": 1e-4, "f": 1e-2, "count": 3} | change
    pitch, f = values.pop("pitch"), values.pop("f")
    with pytest.raises(ValueError, match=message):
        MicrolensArray(pitch, f, **values)


def test_centres_turn_x_towards_y():
    array = MicrolensArray(1.0, 1.0, count=(1, 3), rotation=np.pi / 2, offset=(10.0, 20.0))
    np.testing.assert_allclose(array.centres()[0], [(9, 20), (10, 20), (11, 20)], atol=1e-12)
    twin = reference.lenslet_centres(2.0, count=(3, 4), lattice="hexagonal", rotation=0.3)
    ours = MicrolensArray(2.0, 1.0, count=(3, 4), lattice="hexagonal", rotation=0.3).centres()
    np.testing.assert_allclose(ours[..., ::-1], twin, atol=1e-12)


def test_transmission_is_kept(device):
    grid = Grid((40, 41), 5e-6)
    array = MicrolensArray(50e-6, 5e-3, count=3)
    array.apply(ones(grid, device))
    hits = device.plans.hits
    array.apply(ones(grid, device))
    assert device.plans.hits == hits + 1
