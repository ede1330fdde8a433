"""The section 1.5 camera: raw image, energy, decode, refocus, aperture, viewpoint, phase space."""

import itertools

import numpy as np
import pytest
from tolerance import relative_max

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources, Propagator
from clplen.cameras.camera_base import scene_energy
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.wave.field.field import row_powers

pytestmark = pytest.mark.thorough

POINTS = {"A": (-3e-3, -3e-3, -0.05), "B": (0.0, 0.0, 0.0), "C": (3e-3, 3e-3, 0.05)}
ALPHA = {"A": 0.736842, "B": 1.0, "C": 1.172414}
LENSLET = {"A": 75.26, "B": 50.0, "C": 33.45}  # where each lies, in lenslets, both axes


@pytest.mark.nightly
@pytest.mark.parametrize("name", POINTS)
def test_raw_image_against_the_independent_simulation(raws, twin_raws, name):
    got, expected = raws[name].to_numpy(), twin_raws[name]
    assert got.shape == (3030, 3030)
    correlation = np.vdot(got.astype(float), expected) / (
        np.linalg.norm(got) * np.linalg.norm(expected)
    )
    assert correlation >= 0.999
    # complex64 fields of 120 dB and better: 1e-6 of the amplitude, twice that of the intensity
    assert relative_max(expected, got) <= 2e-6


def test_energy_table(camera):
    scene = PointSources(list(POINTS.values()), diameter=10e-6)
    table = (0.99931, 0.99974, 0.99953)
    for (_, at_array, at_sensor), expected in zip(scene_energy(camera, scene), table, strict=True):
        assert at_array == pytest.approx(expected, abs=5e-6)
        assert at_sensor == pytest.approx(at_array, abs=1e-6)


def test_decode(raws, camera):
    calibrated = LightField.from_raw(raws["B"])
    naive = LightField.from_raw(raws["A"], decode="naive")
    assert calibrated.shape == naive.shape == (30, 30, 101, 101)
    raw = raws["A"].to_numpy()
    np.testing.assert_array_equal(
        naive.to_numpy(), raw.reshape(101, 30, 101, 30).transpose(1, 3, 0, 2)
    )
    assert calibrated.spacing == pytest.approx((-120e-6, -120e-6, 150e-6, 150e-6), rel=1e-9)
    assert calibrated.camera is camera
    assert calibrated.raw is raws["B"]


def near(name, image, half=8):
    """17 x 17 window about a point."""
    i = round(LENSLET[name])
    return image[i - half : i + half + 1, i - half : i + half + 1]


def test_refocus_triplet(scene):
    images = {a: refocus(scene, alpha=a).to_numpy() for a in (0.736842, 1.0, 1.172414)}
    top = images[1.0].max()
    peak = {(n, a): near(n, image).max() / top for a, image in images.items() for n in POINTS}
    assert peak["A", 0.736842] > 4 * peak["A", 1.0]
    assert peak["C", 1.172414] > 2 * peak["C", 1.0]
    assert peak["B", 1.0] == max(peak["B", a] for a in images)
    # the printed table, linear shifts
    table = {"A": (0.2653, 0.0525, 0.0260), "B": (0.0467, 1, 0.0933), "C": (0.0245, 0.0831, 0.2061)}
    for name, expected in table.items():
        got = [peak[name, a] for a in images]
        np.testing.assert_allclose(got, expected, rtol=0.02)
    for name in POINTS:
        energy = [near(name, image).sum(dtype=np.float64) for image in images.values()]
        assert max(energy) / min(energy) < 1.02
    sums = [image.sum(dtype=np.float64) for image in images.values()]
    np.testing.assert_allclose(sums, sums[1], rtol=1e-3)


def test_rescaled_refocus_keeps_the_energy(scene):
    """Form 1 with the Jacobian: I(x') = alpha^2 R(alpha x')."""
    for alpha in [0.736842, 1.172414]:
        plain = refocus(scene, alpha=alpha).to_numpy().sum(dtype=np.float64)
        scaled = refocus(scene, alpha=alpha, rescale=True).to_numpy()
        assert scaled.sum(dtype=np.float64) == pytest.approx(plain, rel=1e-2)


def test_refocused_point_lies_at_its_image(point_fields, camera):
    for name in POINTS:
        image = near(name, refocus(point_fields[name], alpha=ALPHA[name]).to_numpy()).astype(float)
        start = round(LENSLET[name]) - 8
        weight = image**2 / (image**2).sum()
        X = camera.image_of(POINTS[name])[0] / 150e-6 + 50
        along = np.arange(17) + start
        assert abs((weight.sum(axis=0) * along).sum() - X[0]) < 0.5
        assert abs((weight.sum(axis=1) * along).sum() - X[1]) < 0.5


def test_aperture_totals_and_means(scene):
    full = scene.render(total=True).to_numpy().sum(dtype=np.float64)
    for kept, expected in {24: 0.791, 18: 0.493, 12: 0.214, 6: 0.0463, 2: 0.00466}.items():
        total = scene.render(aperture=kept, total=True).to_numpy().sum(dtype=np.float64)
        assert total / full == pytest.approx(expected, rel=0.03)
    means = [
        scene.render(aperture=n).to_numpy().mean(dtype=np.float64) for n in (30, 24, 18, 12, 6, 2)
    ]
    np.testing.assert_allclose(
        means, np.array([3.15, 3.89, 4.31, 4.21, 3.65, 3.30]) * 1e-7, rtol=0.03
    )


def test_viewpoint_moves_the_point_by_its_disparity(point_fields):
    """First moments over views: right sign, attenuated by the blur of the sub-image."""
    for name, first, squared in [("A", 0.184, 0.2105), ("C", -0.112, -0.138)]:
        lf = point_fields[name]
        positions = {"u": [], "v": []}
        steps = np.arange(-6, 7)
        for step in steps:
            for axis, place in (("u", (14.5, 14.5 + step)), ("v", (14.5 + step, 14.5))):
                image = near(name, lf.view(*place).to_numpy()).astype(np.float64)
                image = np.maximum(image, 0)
                along = np.arange(17)
                profile = image.sum(axis=0 if axis == "u" else 1)
                positions[axis].append((profile * along).sum() / profile.sum())
        for axis in ("u", "v"):
            # x = X - d (j - j_c): the position falls as the view index grows for d > 0
            slope = -np.polyfit(steps, positions[axis], 1)[0]
            assert np.sign(slope) == np.sign(first)
            assert abs(slope) <= abs(squared) * 1.05
            assert slope == pytest.approx(first, rel=0.15)


def test_calibrated_decode_keeps_the_energy_of_30_of_31_pixels(scene):
    assert float(scene.to_numpy().sum(dtype=np.float64)) / 3 == pytest.approx(0.964, abs=0.02)


def crosstalk(device, d, *, count=51, alone=False):
    """Energy of a centred in-focus point outside its own cell."""
    pixels = 24 if d < 180e-6 else 40  # the angles that a wide lenslet bends light to
    array = MicrolensArray(d, 10e-3, count=count, fill="full")
    camera = PlenopticCamera.type1(
        focal_length=0.12, mla=array, wavelength=532e-9, pixels_per_lenslet=pixels, device=device
    )
    middle = slice((count // 2) * pixels, (count // 2 + 1) * pixels)
    if not alone:
        raw = camera.expose(PointSources((0, 0, 0))).to_numpy().astype(np.float64)
        return 1 - raw[middle, middle].sum() / raw.sum()
    at_array = camera.optics.array_field(camera.optics.pupil(np.zeros((1, 3))))
    through = MicrolensArray(d, 10e-3, count=1, fill="full").apply(at_array)
    step = Propagator(camera.grid, 10e-3, wavelength=532e-9, method="as", pad=1, device=device)
    behind = step(through)
    field = behind.to_numpy()[0]
    inside = (np.abs(field[middle, middle]) ** 2).sum(dtype=np.float64)
    return 1 - inside / row_powers(behind).sum()


@pytest.mark.nightly
def test_crosstalk(device):
    assert crosstalk(device, 70e-6) > 0.45
    assert crosstalk(device, 150e-6) == pytest.approx(0.107, abs=0.01)
    assert crosstalk(device, 150e-6, alone=True) < 0.03
    # averaged over d +- 20 % the curve falls
    means = [
        np.mean([crosstalk(device, d * s) for s in (0.8, 0.9, 1.0, 1.1, 1.2)])
        for d in (60e-6, 100e-6, 150e-6, 225e-6)
    ]
    assert all(a > b for a, b in itertools.pairwise(means))
