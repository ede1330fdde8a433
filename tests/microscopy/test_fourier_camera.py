"""The Fourier microscope: its lengths, its waves against float64, its refusals."""

import math
from dataclasses import replace

import numpy as np
import pytest
import reference_fourier
from setups_fourier import SMALL, camera_of, spot, twin

from clplen import (
    Coherence,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    SamplingError,
    ShapeError,
)
from clplen.cameras import CoverGlass, LensletLayout
from clplen.wave import RandomPhaseMask

POINT = (3.4e-6, -5.1e-6, 9e-6)


@pytest.fixture(scope="module")
def camera(device):
    return camera_of("small", device)


def made(**other):
    return PlenopticCamera.fourier_microscope(**(SMALL | other))


def test_lengths_by_hand(camera):
    """2 NA f_FL/M = 1.5 mm, N = 3, M_T = 20 12/50, NA/N = .1, c = .5 mm: sin = .2."""
    known = camera.describe()
    assert known["pupil"] == pytest.approx(1.5e-3)
    assert known["lenslets across the pupil"] == pytest.approx(3)
    assert known["sub-image magnification"] == pytest.approx(4.8)
    assert known["field of view"] == pytest.approx(500e-6 / 4.8)
    assert known["overlap"] == pytest.approx(0)
    assert camera.effective_na == pytest.approx(0.1)
    assert camera.lateral_resolution == pytest.approx(2 * 8e-6 / 4.8)  # pixels, above 2.6 um
    fine = replace(camera, pixel_pitch=2e-6)
    assert fine.lateral_resolution == pytest.approx(525e-9 / 0.2)
    assert fine.axial_resolution == pytest.approx(525e-9 / 0.2 * math.sqrt(0.96) / 0.2)
    assert fine.depth_of_field == pytest.approx(525e-9 / 0.01 + 2e-6 / 4.8 / 0.1)
    assert replace(camera, field_stop=2 * camera.field_stop).overlap == pytest.approx(0.5)


def test_light_of_lenslets(camera):
    """Of 3 x 3 discs in a pupil of three, the corners have a share that a raster counts."""
    t = (np.arange(2001) - 1000) / 1000 * 250e-6
    disc = np.hypot(t[:, None], t) <= 250e-6
    in_pupil = np.hypot(t[:, None] + 500e-6, t + 500e-6) <= 750e-6
    corner = (disc & in_pupil).sum() / disc.sum()
    expected = np.full(9, 1.0)
    expected[[0, 2, 6, 8]] = corner
    assert camera.lit == pytest.approx(expected, abs=2e-3)


def test_arrays_are_layouts():
    """Turned and moved lattices, several focal lengths, hexagons."""
    mla = MicrolensArray(
        1e-3, (30e-3, 31e-3, 32e-3), count=(4, 5), lattice="hexagonal", fill="full",
        rotation=0.2, offset=(2e-4, -1e-4),
    )  # fmt: skip
    layout = LensletLayout.of(mla)
    assert len(layout) == 20
    assert np.array_equal(layout.positions, mla.centres().reshape(-1, 2))
    assert np.array_equal(layout.focal_lengths, np.array(mla.focal_lengths)[mla.types().ravel()])
    assert layout.fill == "hexagonal"
    assert layout.spacing == pytest.approx(1e-3)


@pytest.mark.parametrize("lenslet", [4, pytest.param(8, marks=pytest.mark.thorough)])
def test_point_images_of_an_independent_simulation(camera, lenslet):
    """Whole lenslets and one on the rim, a wide stop; 1e-3 of the largest pixel."""
    wide = replace(camera, field_stop=2.5 * camera.field_stop)
    frame = wide.expose(PointSources(POINT)).to_numpy()
    y, x = spot(wide, lenslet, POINT)
    corner = (round(y) - 5, round(x) - 5)
    expected = reference_fourier.sensor(twin(wide), POINT, corner, 11, step=2e-6, nodes=4)
    found = frame[corner[0] : corner[0] + 11, corner[1] : corner[1] + 11]
    assert np.abs(found - expected).max() < 1e-3 * frame.max()


def test_the_field_stop_hides_points(camera):
    inside = camera.field_stop / (2 * camera.magnification)
    assert camera.expose(PointSources((1.1 * inside, 0, 0))).to_numpy().sum() < 0.01


def test_focal_lengths_focus_planes(device):
    """Of two lenslets, one of a focal length above s: it is sharp farther from the objective."""
    s, longer = 12e-3, 13.2e-3
    layout = LensletLayout([(0, -3e-4), (0, 3e-4)], [s, longer], diameter=5e-4)
    camera = made(mla=layout, sensor_distance=s, na=0.24, device=device)
    z = (1 / s - 1 / longer) * camera.relay**2 / camera.magnification**2  # paraxially, in air
    left, right = np.transpose([
        [side.max() for side in np.array_split(camera.expose(one).to_numpy(), 2, axis=1)]
        for one in (PointSources((0, 0, depth)) for depth in (-z, 0.0, z))
    ])  # fmt: skip
    assert left[1] > 1.3 * max(left[0], left[2])
    assert right[2] > 1.3 * right[1] > 1.3 * right[0]


def test_parameters_that_cannot_be():
    for other, words in [
        ({"na": 1.1}, "na = n sin"),
        ({"magnification": 0.5}, "finite number >= 1"),
        ({"relay": 50.0}, "did you mean 0.05"),
        ({"pixel_pitch": math.nan}, "must be > 0"),
        ({"apodisation": 2}, "apodisation"),
        ({"shape": (0, 5)}, "pixels of the sensor"),
        ({"shape": (10**6, 10**6)}, "at most"),
        ({"pixel_pitch": 100e-6}, "pixels"),
        ({"mla": "square"}, "MicrolensArray or a LensletLayout"),
        ({"cover": 170e-6}, "CoverGlass"),
        ({"na": 1.1, "medium_index": 1.33, "cover": CoverGlass(1e-4, index=1.05)}, "index of the"),
        ({"mla": MicrolensArray(500e-6, (12e-3, 13e-3), count=3)}, "sensor_distance"),
        ({"mla": LensletLayout([(5e-3, 0)], 12e-3, diameter=5e-4)}, "At least one lenslet"),
    ]:
        with pytest.raises((ValueError, TypeError, SamplingError, ShapeError), match=words):
            made(**other)


def test_layouts_that_cannot_be():
    for positions, focal, other, words in [
        ([(0, 0), (0, 4e-4)], 0.01, {}, "0.0005 m wide"),
        ([0, 1], 0.01, {}, "shape"),
        ([(0, 0)], [1e-2, 2e-2], {}, "one for each of 1"),
        ([(0, np.nan)], 0.01, {}, "finite"),
        ([(0, 0)], 0.01, {"fill": "round"}, "fill"),
        ([(0, 0)], 0.01, {"diameter": 0}, "diameter"),
        ("here", 0.01, {}, "real numbers"),
        ([(0, 1000.0)], 0.01, {}, "in metres"),
    ]:
        with pytest.raises(ValueError, match=words):
            LensletLayout(positions, focal, **({"diameter": 5e-4} | other))


def test_scenes_that_cannot_be(camera):
    with pytest.raises(TypeError, match="exposes PointSources"):
        camera.expose([np.zeros(3)])
    with pytest.raises(ValueError, match="did you mean"):
        camera.expose(PointSources((0, 0, 10)))
    with pytest.raises(SamplingError, match="samples"):
        camera.expose(PointSources((0, 0, 0.05)))
    light = Coherence(RandomPhaseMask(1e-5))
    with pytest.raises(ValueError, match="are incoherent"):
        camera.expose(PointSources((0, 0, 0)), coherence=light)
