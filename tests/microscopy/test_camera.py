"""The light-field microscope against its float64 twin, the Debye integral, and its geometry."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from reference_microscope import Setup, axis, debye, native, sensor
from tolerance import relative_max

from clplen import (
    Coherence,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    SamplingError,
    Spectrum,
)
from clplen.cameras.optics.objective import CoverGlass, Objective
from clplen.errors import SamplingWarning
from clplen.io import read_lightfield, write_lightfield
from clplen.lightfield.depth.alpha_estimate import estimate_alpha
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.lightfield.stacks import focal_stack
from clplen.wave import RandomPhaseMask
from clplen.wave.field.field import Grid

S = Setup()


def microscope(device, *, count=15, n=25, fill="full", **other):
    values = {"magnification": 20, "na": 0.5, "wavelength": 525e-9, "pixels_per_lenslet": n}
    mla = MicrolensArray(125e-6, 2.5e-3, count=count, fill=fill)
    values |= {"mla": mla, "device": device} | other
    return PlenopticCamera.microscope(**values)


def cells(picture, n=25):
    ny, nx = (k // n for k in picture.shape)
    return picture.astype(float).reshape(ny, n, nx, n).sum(axis=(1, 3))


def test_native_field_is_the_debye_integral(precise):
    z, limit = -25e-6, 0.0235  # the sampling of the pupil by a window of 375^2 leaves 0.0225
    grid = Grid((375, 375), 5e-6)
    objective = Objective(20, 0.5, 1, 525e-9)
    field = objective.fields(PointSources([(0, 0, z)]), grid, precise).to_numpy()[0, 187]
    expected = debye(S, np.abs(grid.x), z, nodes=400)
    inner = np.abs(grid.x) < 900e-6  # at its ends the window's neighbours count
    field, expected = (u[inner] / u[187] for u in (field, expected))
    assert np.abs(field - expected).max() / np.abs(expected).max() < limit


def test_apodisation_and_index_shape_the_field(precise):
    power = -0.5
    # the twin sums frequencies one by one; a rectangle, off the axis, in water
    setup = Setup(M=60, na=1.1, p=100e-6, n=15, lam=593e-9, index=1.33, power=power)
    point = (0.61e-6, -0.83e-6, 2.3e-6)
    x = axis(setup, 9)
    grid = Grid((135, 135), setup.dx)
    objective = Objective(60, 1.1, 1.33, 593e-9, apodisation=power)
    found = objective.fields(PointSources([point]), grid, precise)
    assert np.allclose(grid.x, x)
    assert relative_max(native(setup, point, 9), found.to_numpy()[0]) < 1e-10


def test_sensor_is_that_of_the_twin(device):
    points, power, count = ((2.3e-6, -4.1e-6, -6e-6), (-1e-6, 2e-6, 8e-6)), (1, 3), 8
    found = microscope(device, count=count, n=26).expose(PointSources(points, power=power))
    twins = (p * sensor(replace(S, n=26), one, count) for one, p in zip(points, power, strict=True))
    # complex64 through three transforms, measured 9e-7 of the peak
    assert relative_max(sum(twins), found.to_numpy()) < 3e-6


def test_depth_by_disparity(device):
    z = -20e-6
    camera = microscope(device)
    lf = LightField.from_raw(camera.expose(PointSources([(0, 0, z)])))
    d = camera.disparity(z)
    assert d == pytest.approx(-0.128 * z / 20e-6)
    assert camera.z(d) == pytest.approx(z)
    found = estimate_alpha(lf, window=15)
    assert np.isnan(found.alpha)
    assert found.disparity == pytest.approx(d, rel=0.12)
    assert found.z == pytest.approx(z, rel=0.12)
    stack = focal_stack(lf, disparities=d * np.linspace(0.5, 1.5, 21))
    best = stack.to_numpy().max(axis=(1, 2)).argmax()
    assert stack.disparities[best] == pytest.approx(d, rel=0.12)
    assert np.isnan(stack.alphas).all()
    depth = depth_map(stack)
    assert depth.z[7, 7] == pytest.approx(camera.z(depth.disparity[7, 7]), rel=1e-5)
    with pytest.raises(ValueError, match="has no alpha = F/F'"):
        lf.disparity(0.9)


def test_both_decodes_coincide(device):
    raw = microscope(device, count=9).expose(PointSources([(3e-6, 1e-6, 5e-6)]))
    both = [LightField.from_raw(raw, decode=word) for word in ("calibrated", "naive")]
    assert np.array_equal(*(lf.to_numpy() for lf in both))
    assert both[0].shear_alpha(0.2) == both[1].shear_alpha(0.2)
    # the picture has the same size on every plane
    plain, rescaled = (refocus(both[0], disparity=-0.03, rescale=r) for r in (False, True))
    assert np.array_equal(plain.to_numpy(), rescaled.to_numpy())
    # on the pupil f_tube behind it, where rays of a view meet; the first view is the last there
    du = -5e-6 * 0.2 / 2.5e-3
    assert raw.spacing == pytest.approx((du, du, 125e-6, 125e-6))


def test_light_fields_in_files_keep_their_microscope(device, tmp_path):
    camera = microscope(device, count=7, apodisation=-0.5)
    write_lightfield(
        tmp_path / "lf.h5", LightField.from_raw(camera.expose(PointSources([(0, 0, 0)])))
    )
    again = read_lightfield(tmp_path / "lf.h5", device=device)
    assert again.camera == camera
    assert np.isnan(again.alpha(0.1))


def test_fluorescence_with_a_spectrum(device):
    camera, point = microscope(device, count=7), PointSources([(2e-6, 0, 3e-6)])
    lines = Coherence(None, Spectrum.lines([520e-9, 530e-9], [1, 3]))
    blue, red = (replace(camera, wavelength=w).expose(point).to_numpy() for w in (520e-9, 530e-9))
    found = camera.expose(point, coherence=lines).to_numpy()
    assert relative_max(0.25 * blue + 0.75 * red, found) < 1e-6
    with pytest.raises(ValueError, match="incoherent already"):
        camera.expose(point, coherence=Coherence(RandomPhaseMask(40e-6)))
    with pytest.raises(ValueError, match="are for slides"):
        camera.expose(point, snapshots=3)


def test_cover_glass_aberrates_as_third_order_theory_says(device):
    n = 1.33
    # W040 = t (g^2 - n^2) s^4/(8 g^3 n^2); the next order is s^2 (g^-2 + n^-2)/2 of it
    objective = Objective(20, 0.2, n, 525e-9, CoverGlass(250e-6, 1.5, 200e-6, 1.5))
    grid = Grid((375, 375), 5e-6)
    pupils = (one.pupil(grid, 3e-6)[0] for one in (objective, replace(objective, cover=None)))
    aberrated, plain = pupils
    s = 20 * 525e-9 * np.abs(grid.fx)
    expected = 50e-6 * (1.5**2 - n**2) * s**4 / (8 * 1.5**3 * n**2) / 525e-9
    inside = s < 0.19
    phase = np.angle(aberrated[inside] / plain[inside]) / (2 * np.pi)
    assert np.abs(phase).max() > 8e-4
    assert np.allclose(phase, expected[inside], atol=0.04 * expected[inside].max())
    same = replace(objective, cover=CoverGlass(170e-6, 1.5255))
    assert np.array_equal(same.pupil(grid, 0), replace(same, cover=None).pupil(grid, 0))
    camera = microscope(device, count=7, cover=CoverGlass(3e-4), pupil={5: 1e-8})
    assert (camera.objective.cover, camera.objective.aberration) == (camera.cover, camera.pupil)


@pytest.mark.parametrize(("thickness", "z"), [(500e-6, 4e-6), (0, -45e-6)])
def test_the_outermost_rays_behind_a_cover_glass(thickness, z):
    # by the slope of the phase, differences of W from its definition
    n, g, surplus = 1.35, 1.5255, thickness - 170e-6
    objective = Objective(60, 1.2, n, 593e-9, CoverGlass(thickness))
    s = np.linspace(0, 1.2, 20001)
    path = (surplus * np.sqrt(g**2 - s**2) + (z - n * surplus / g) * np.sqrt(n**2 - s**2)) * 60
    expected = np.abs(np.diff(path) / np.diff(s)).max()
    assert objective.blur(z) == pytest.approx(expected, rel=5e-4)
    assert np.array_equal(objective.blur([z, z]), [objective.blur(z)] * 2)
    plain = replace(objective, cover=CoverGlass(170e-6))
    assert plain.blur(z) == pytest.approx(replace(objective, cover=None).blur(z))


def test_description(device):
    about = microscope(device).describe()
    expected = {
        "lateral resolution": 6.25e-6, "Sparrow limit": 0.494e-6, "resolvable views": 12.66,
        "depth of field": 2.1e-6, "light-field range": 170e-6, "band limit from": 37.2e-6,
        "objective focal length": 10e-3, "pupil": 10e-3,
    }  # fmt: skip
    for name, value in expected.items():
        assert about[name] == pytest.approx(value, rel=4e-3), name
    assert "matched" in str(about)
    # at its least depth nu(z) = M/(.47 d), half the period of a lenslet
    assert microscope(device).band_limit(37.21e-6) == pytest.approx(1 / (0.47 * 6.25e-6), rel=1e-3)


def test_discs_spread_what_points_do_not(device):
    camera = microscope(device, count=7)
    point, disc = (
        cells(camera.expose(PointSources([(0, 0, 0)], diameter=d)).to_numpy()) for d in (0, 9e-6)
    )
    assert disc[3, 4] > 5 * point[3, 4]
    assert disc[3, 4] == pytest.approx(disc[4, 3], rel=1e-4)
    # the window holds the image of a large one
    wide = PointSources([(0, 0, 0)], diameter=60e-6)
    assert camera.window(wide).extent[0] > 20 * 60e-6 + 2 * 125e-6


def test_bad_microscopes(device):
    for change, error, words in [
        ({"na": 1.1}, ValueError, "NA = n sin"),
        ({"n": 12}, SamplingError, r"pixels_per_lenslet = 24\)"),
        ({"medium_index": 0.9}, ValueError, "from 1 .air. on"),
        ({"magnification": 0}, ValueError, "magnification is"),
        ({"apodisation": 2}, ValueError, "from -1 to 1"),
        ({"wavelength": -1}, ValueError, "wavelength is positive"),
        ({"na": "0.5"}, ValueError, "NA = n sin"),
        ({"tube_lens": "0.2"}, ValueError, "tube_lens is positive"),
        ({"n": "25"}, SamplingError, "pixels_per_lenslet is a number, at least 2, not '25'"),
        ({"mla": None}, TypeError, "mla is a MicrolensArray, not None"),
        ({"cover": "150um"}, TypeError, "cover is a CoverGlass, as .* not '150um'"),
        ({"na": 1.1, "medium_index": 1.33, "cover": CoverGlass(1e-4, 1.05)}, ValueError,
         r"NA 1\.1 does not pass a cover glass of index 1\.05"),
    ]:  # fmt: skip
        with pytest.raises(error, match=words):
            microscope(device, **change)
    for thickness, index, words in [
        (150, 1.5, "0 to 0.01 m thick, not 150: 150 um are 150e-6"),
        ("150um", 1.5, "not '150um'"),
        (1e-4, 0.9, "index from 1 to 5, not 0.9"),
    ]:
        with pytest.raises(ValueError, match=words):
            CoverGlass(thickness, index)
    with pytest.raises(SamplingError, match="beyond the array"):
        microscope(device, count=7).expose(PointSources([(30e-6, 0, 0)]))


def test_unmatched_f_numbers_are_said_aloud(device):
    with pytest.warns(SamplingWarning, match=r"M/\(2 NA\) = 25, f_mu/d = 20; sub-images leave"):
        microscope(device, na=0.4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        microscope(device, na=0.47)
