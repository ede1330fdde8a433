"""Plane and spherical waves, Gaussian beams, tilts: values, sampling warnings, messages."""

import numpy as np
import pytest
import reference
from reference_elements import spherical_wave as sphere_twin
from reference_elements import tilt_phase
from tolerance import relative_max

from clplen import Field, Grid, SamplingWarning
from clplen.wave.elements.beams import gaussian_beam, plane_wave, spherical_wave, tilt

LAM = 532e-9
GRID = Grid((45, 62), (5e-6, 3e-6), origin=(2e-6, -40e-6))


@pytest.fixture(params=["single", "double"])
def wave(request, device):
    return device if request.param == "single" else request.getfixturevalue("precise")


def rounding(device):
    """Products of a few phasors, or float64 phases of 1e4 turns on both sides."""
    return max(10 * np.finfo(device.real).eps, 1e-11)


# Plane waves and tilts


def test_plane_wave(wave):
    for direction in [(0, 0), (0.02, -0.07), (-0.05, 0.01)]:
        got = plane_wave(GRID, wavelength=LAM, device=wave, direction=direction).to_numpy()
        expected = tilt_phase(GRID.shape, GRID.pitch, direction, LAM, origin=GRID.origin)
        assert np.abs(got - expected).max() <= rounding(wave)


def test_tilt(wave):
    rng = np.random.default_rng(4)
    u = rng.normal(size=(2, *GRID.shape)) + 1j * rng.normal(size=(2, *GRID.shape))
    field = Field.from_array(u, GRID, wavelength=LAM, device=wave)
    got = tilt(field, (0.01, -0.03)).to_numpy()
    expected = u * tilt_phase(GRID.shape, GRID.pitch, (0.01, -0.03), LAM, origin=GRID.origin)
    assert relative_max(expected, got) <= rounding(wave)


def test_aliased_directions_warn(device):
    """A direction cosine of lam/(2 dx) is the last that the samples carry."""
    for axis, name in [(0, "y"), (1, "x")]:
        limit = LAM / (2 * GRID.pitch[axis])
        steep, flat = ([0, 0], [0, 0])
        steep[axis], flat[axis] = -1.01 * limit, -0.99 * limit
        plane_wave(GRID, wavelength=LAM, device=device, direction=flat)
        with pytest.warns(
            SamplingWarning, match=rf"plane wave with .* along {name} is aliased.*at most"
        ):
            plane_wave(GRID, wavelength=LAM, device=device, direction=steep)
        field = plane_wave(GRID, wavelength=LAM, device=device)
        with pytest.warns(SamplingWarning, match=f"tilt with .* along {name}"):
            tilt(field, steep)


# Spherical waves


def test_spherical_wave(wave):
    for z in [30e-3, -30e-3, 4e-3]:
        source = (50e-6, 20e-6)
        got = spherical_wave(GRID, z, wavelength=LAM, device=wave, source=source).to_numpy()
        expected = sphere_twin(GRID.shape, GRID.pitch, z, LAM, source=source, origin=GRID.origin)
        assert relative_max(expected, got) <= rounding(wave)


def test_aliased_spheres_warn(device):
    """Between the outermost samples the phase steps by pi just where the warning starts."""
    grid = Grid((3, 101), 5e-6)
    sine = LAM / 10e-6
    z = 250e-6 * np.sqrt(1 - sine**2) / sine
    for times in (1.03, 0.97):
        r = np.hypot(np.array([245e-6, 250e-6]), times * z)
        assert (np.diff(r)[0] * 2 / LAM < 1) == (times > 1)
    spherical_wave(grid, 1.01 * z, wavelength=LAM, device=device)
    with pytest.warns(SamplingWarning, match=r"on samples of 5e-06 m along x: the grid extends"):
        spherical_wave(grid, -0.99 * z, wavelength=LAM, device=device)
    turned = Grid((101, 3), 5e-6)
    spherical_wave(turned, 2.01 * z, wavelength=LAM, device=device, source=(-250e-6, 0))
    match = "along y: the grid extends 0.0005 m from its axis, .* at least 0.009385 m"
    with pytest.warns(SamplingWarning, match=match):
        spherical_wave(turned, 1.99 * z, wavelength=LAM, device=device, source=(-250e-6, 0))


def test_a_source_far_beside_the_window(device):
    """Rays along x are less steep where y is large; samples below lam/2 along y carry all."""
    grid = Grid((3, 101), (0.2e-6, 5e-6))
    sine = LAM / 10e-6
    z = 250e-6 * np.sqrt(1 - sine**2) / sine
    beside = 1.01 * z * np.sin(1), 1.01 * z * np.cos(1)
    spherical_wave(grid, beside[0], wavelength=LAM, device=device, source=(beside[1], 0))
    with pytest.warns(SamplingWarning, match="along x"):
        spherical_wave(grid, beside[0], wavelength=LAM, device=device, source=(0.9 * beside[1], 0))


def test_nothing_varies_along_an_axis_of_length_one(device):
    """Where such an axis lies and what a direction or source says of it does not matter."""
    here, away = Grid((1, 30), 4e-6), Grid((1, 30), 4e-6, origin=(1e-3, 0))
    optics = {"wavelength": LAM, "device": device}
    for one, other in (
        (plane_wave(here, **optics), plane_wave(away, direction=(0.9, 0), **optics)),
        (spherical_wave(here, 0.1, **optics), spherical_wave(away, 0.1, source=(1, 0), **optics)),
        (
            gaussian_beam(here, 3e-5, **optics),
            gaussian_beam(away, 3e-5, centre=(1, 0), direction=(0.9, 0), **optics),
        ),
    ):
        np.testing.assert_array_equal(one.to_numpy(), other.to_numpy())


# Gaussian beams


def test_gaussian_beam(wave):
    for z in [0, 5e-3, -2e-3]:
        centre = (10e-6, -50e-6)
        got = gaussian_beam(GRID, 20e-6, wavelength=LAM, device=wave, z=z, centre=centre).to_numpy()
        r = np.hypot(*np.meshgrid(GRID.y - centre[0], GRID.x - centre[1], indexing="ij"))
        expected = reference.gaussian_paraxial(r, z, waist=20e-6, wavelength=LAM)
        assert np.abs(got - expected).max() <= rounding(wave)


def test_gaussian_of_fewer_axes(device):
    for shape, dim in [((1, 64), 1), ((64, 1), 1), ((1, 1), 0)]:
        grid = Grid(shape, 3e-6, origin=tuple(0.0 if n > 1 else 1.0 for n in shape))
        got = gaussian_beam(grid, 20e-6, wavelength=LAM, device=device, z=4e-3).to_numpy().ravel()
        r = max(grid.y, grid.x, key=len) if dim else np.zeros(1)
        expected = reference.gaussian_paraxial(r, 4e-3, waist=20e-6, wavelength=LAM, dim=dim)
        assert np.abs(got - expected).max() <= rounding(device)


def test_tilted_beam_is_its_waist_propagated(precise):
    """Fresnel propagation in float64, waist and beam inside a wide window."""
    for direction in [(0.02, -0.03), (-0.01, 0.0)]:
        grid, z, centre = Grid((160, 144), (3e-6, 4e-6)), 3e-3, (-20e-6, 30e-6)
        beam = [
            gaussian_beam(
                grid,
                30e-6,
                wavelength=LAM,
                device=precise,
                z=at,
                centre=centre,
                direction=direction,
            ).to_numpy()
            for at in (0, z)
        ]
        f2 = np.add.outer(grid.fy**2, grid.fx**2)
        got = np.fft.ifft2(np.fft.fft2(beam[0]) * np.exp(-1j * np.pi * LAM * z * f2))
        assert np.abs(got - beam[1]).max() <= 1e-9
        weight = np.abs(beam[1]) ** 2
        middle = [np.sum(weight * c) / weight.sum() for c in (grid.y[:, None], grid.x)]
        assert middle == pytest.approx([c + a * z for c, a in zip(centre, direction, strict=True)])


def test_beams_finer_than_their_samples_warn(device):
    with pytest.warns(SamplingWarning, match="Gaussian beam with .* along y is aliased"):
        gaussian_beam(GRID, 3e-6, wavelength=LAM, device=device)
    with pytest.warns(SamplingWarning, match="along x"):
        gaussian_beam(GRID, 30e-6, wavelength=LAM, device=device, direction=(0, 0.09))


# Bad input


def test_what_is_no_source(device):
    cosines = "direction cosines with a sum of squares below 1"
    waist, place = "waist of a beam must be positive", "z and centre of a beam must be finite"
    rows = [
        *((plane_wave, (), {"direction": d}, cosines) for d in [(0.8, 0.7), (np.nan, 0), 0.1]),
        (plane_wave, (), {"direction": (0, 0, 0)}, cosines),
        *((spherical_wave, (z,), {}, "point source must be finite and not 0") for z in (0, np.inf)),
        (spherical_wave, (1,), {"source": (0, np.nan)}, "place of a source must be finite"),
        *((gaussian_beam, (size,), {}, waist) for size in (0, np.inf)),
        (gaussian_beam, (1e-5,), {"z": np.nan}, place),
        (gaussian_beam, (1e-5,), {"centre": (0, np.inf)}, place),
        (gaussian_beam, (1e-5,), {"direction": (1, 1)}, "direction cosines"),
    ]
    for source, args, more, message in rows:
        with pytest.raises(ValueError, match=message):
            source(GRID, *args, wavelength=LAM, device=device, **more)
    with pytest.raises(ValueError, match=cosines):
        tilt(plane_wave(GRID, wavelength=LAM, device=device), (1, 0))
    for source, args in ((plane_wave, ()), (spherical_wave, (1e-3,)), (gaussian_beam, (1e-3,))):
        with pytest.raises(ValueError, match="wavelength must be positive"):
            source(GRID, *args, wavelength=0, device=device)
        with pytest.raises(TypeError, match="device must be a Device"):
            source(GRID, *args, wavelength=LAM, device=0)
