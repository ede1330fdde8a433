"""source.cl: fields of point sources in the pupil, behind the lens."""

import numpy as np
import pytest
import reference
from scipy import special

from clplen.cameras.optics.wave_optics import pupil_fields
from clplen.errors import DeviceError
from clplen.wave.field.field import Grid

POINTS = np.array([(-3e-3, -2e-3, -0.05), (0, 0, 0), (2.5e-3, 1e-3, 0.05)])


def twin(grid, point, *, diameter, f, D, distance, wavelength):
    x0, y0, dz = point
    z = distance + dz
    y, x = grid.y[:, None], grid.x[None, :]
    rho2 = (x - x0) ** 2 + (y - y0) ** 2
    beyond = rho2 / (np.sqrt(rho2 + z**2) + z)
    v = np.pi * diameter * np.sqrt(rho2) / (wavelength * z)
    amplitude = np.where(v > 0, 2 * special.j1(v) / np.where(v > 0, v, 1), 1)
    inside = reference.circle_coverage(grid.shape, grid.pitch, D, origin=grid.origin)
    phase = beyond / wavelength - (x**2 + y**2) / (2 * wavelength * f)
    return inside * amplitude * np.exp(2j * np.pi * phase)


@pytest.mark.parametrize(
    ("wave", "diameter", "shape"),
    [("single", 400e-6, (24, 37)), ("double", 10e-6, (17, 20))],
    indirect=["wave"],
)
def test_sphere_pattern_aperture_and_lens(wave, diameter, shape):
    grid = Grid(shape, (40e-6, 30e-6), origin=(20e-6, 0))
    optics = {"f": 0.12, "D": 0.5e-3, "distance": 0.24, "wavelength": 532e-9}
    got = pupil_fields(
        np.array(POINTS),
        diameter,
        grid=grid,
        object_distance=0.24,
        focal_length=0.12,
        aperture_diameter=0.5e-3,
        wavelength=532e-9,
        device=wave,
    ).to_numpy()
    expected = np.array([twin(grid, p, diameter=diameter, **optics) for p in POINTS])
    # coverage by 32 strips (2.5e-4 of a rim sample); elsewhere rounding of a few turns
    rim = np.abs(got - expected).max()
    assert rim <= 2.6e-4
    inside = reference.circle_coverage(shape, grid.pitch, 0.5e-3, origin=grid.origin) == 1
    eps = np.finfo(wave.real).eps
    # 2 J1(v)/v by cubic Hermite interpolation: 4e-12; float32 v up to 70 costs v eps |slope|
    assert np.abs(got - expected)[:, inside].max() <= max(100 * eps, 1e-11)


def test_near_sources_keep_their_phase(device, monkeypatch):
    """Sphere minus paraboloid takes many turns: in double where there is double precision."""
    grid = Grid((40, 55), (100e-6, 90e-6))
    point, optics = (0.4e-3, -0.3e-3, 0.0), {"f": 0.03, "D": 4.5e-3, "wavelength": 532e-9}

    def fields():
        return pupil_fields(
            np.array([point]),
            grid=grid,
            object_distance=0.02,
            focal_length=0.03,
            aperture_diameter=4.5e-3,
            wavelength=532e-9,
            device=device,
        )

    if device.has_fp64:
        got = fields().to_numpy()[0]
        expected = twin(grid, point, diameter=0.0, distance=0.02, **optics)
        inside = reference.circle_coverage(grid.shape, grid.pitch, 4.5e-3) == 1
        assert np.abs(got - expected)[inside].max() <= 100 * np.finfo(np.float32).eps
    monkeypatch.setattr(device, "has_fp64", False)
    with pytest.raises(DeviceError, match="turns of phase to single precision"):
        fields()
