"""Views, epipolar slices and synthetic apertures against float64 twins."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from reference_lightfield import aperture_weights as square
from reference_lightfield import render as twin
from reference_lightfield import viewpoint_weights

from clplen.errors import ShapeError
from clplen.lightfield.model.apertures import aperture_weights
from clplen.lightfield.model.light_field import LightField

SAMPLES = [(np.uint8, (5, 8, 7, 11)), (np.uint16, (2, 3, 5, 4, 3))]
SPACING = (-120e-6, -60e-6, 150e-6, 150e-6)
CAMERA = SimpleNamespace(image_distance=0.24, aperture_diameter=0.9e-3)


def values(dtype=np.float32, shape=(5, 8, 7, 11)) -> np.ndarray:
    return np.random.default_rng(17).integers(1, 250, shape).astype(dtype)


def light_field(device, a=None, **more) -> LightField:
    return LightField.from_array(values() if a is None else a, device=device, **more)


def rounding(a: np.ndarray) -> float:
    """Units of 2^-24 of the largest sample: one a view summed, one for its weight."""
    return (a.shape[0] * a.shape[1] + 1) * 2.0**-24 * float(a.max())


@pytest.mark.parametrize(("dtype", "shape"), SAMPLES)
def test_a_view_is_exact(device, dtype, shape):
    a = values(dtype, shape)
    got = light_field(device, a, weights=np.full(shape[:2], 0.3)).view(1, 2).to_numpy()
    assert got.dtype == np.float32
    np.testing.assert_array_equal(got, a[1, 2].astype(np.float32))


@pytest.mark.parametrize("at", [(1.25, 2.5), (4, 6.9)])
def test_between_views(device, at):
    a = values()
    got = light_field(device, a).view(*at).to_numpy()
    want = twin(a.astype(float), viewpoint_weights((5, 8), *at))
    assert np.abs(got - want).max() <= rounding(a)
    alone = light_field(device, a).render(viewpoint=at).to_numpy()
    np.testing.assert_array_equal(alone, got)


def test_a_view_without_weight_is_shown_but_not_mixed(device):
    a = values()
    weights = np.ones((5, 8))
    weights[2, 3] = 0
    lf = light_field(device, a, weights=weights)
    np.testing.assert_array_equal(lf.view(2, 3).to_numpy(), a[2, 3])
    np.testing.assert_array_equal(lf.view(2, 3.25).to_numpy(), a[2, 4])


@pytest.mark.parametrize(("dtype", "shape"), SAMPLES)
def test_epi(device, dtype, shape):
    a = values(dtype, shape)
    lf = light_field(device, a)
    rows, columns = lf.epi(y=4, v=1).to_numpy(), lf.epi(x=3, u=2).to_numpy()
    assert rows.dtype == columns.dtype == np.float32
    np.testing.assert_array_equal(rows, a[1, :, 4].astype(np.float32))
    np.testing.assert_array_equal(columns, a[:, 2, :, 3].astype(np.float32))


@pytest.mark.parametrize(("dtype", "total"), [(np.uint8, True), (np.float32, False)])
def test_all_views(device, dtype, total):
    a = values(dtype, (3, 4, 5, 7, 3))
    weights = np.random.default_rng(19).random((3, 4)).astype(np.float32)
    got = light_field(device, a, weights=weights).render(total=total).to_numpy()
    want = twin(a.astype(float), weights.astype(float), total=total)
    assert np.abs(got - want).max() <= rounding(a) * (weights.sum() if total else 1)


@pytest.mark.parametrize(("across", "total"), [(2, True), (3, False)])
def test_square_aperture(device, across, total):
    """Eq. 3.3 of the thesis, even and odd numbers dropped."""
    a = values()
    got = light_field(device, a).render(aperture=across, total=total).to_numpy()
    w = square((5, 8), across)
    assert np.abs(got - twin(a.astype(float), w, total=total)).max() <= rounding(a) * w.sum()


def test_square_aperture_moves_with_the_viewpoint(device):
    w = aperture_weights(light_field(device), 2, (1.5, 6.75))
    np.testing.assert_allclose(w, np.outer([0, 1, 1, 0, 0], [0, 0, 0, 0, 0, 0, 0.75, 1]))
    w = aperture_weights(light_field(device), 3, (0, 2))
    np.testing.assert_allclose(w, np.outer([1, 1, 0, 0, 0], [0, 1, 1, 1, 0, 0, 0, 0]))


def covered(views, centre, diameter, fine=200) -> np.ndarray:
    """Fraction of every view's cell inside an ellipse, counted on a fine raster."""
    inside = 0.0
    for axis, (n, c, d) in enumerate(zip(views, centre, diameter, strict=True)):
        t = ((np.arange(n * fine) + 0.5) / fine - 0.5 - c) / (d / 2)
        inside = inside + np.expand_dims(t**2, 1 - axis)
    return (inside <= 1).reshape(views[0], fine, views[1], fine).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("fraction", "at"), [(1.0, None), (0.61, (3.7, 0.2)), (np.float32(0.5), (2, 3))]
)
def test_disc(device, fraction, at):
    w = aperture_weights(light_field(device), fraction, at)
    want = covered((5, 8), at or (2, 3.5), (5 * fraction, 8 * fraction))
    # A raster of 200 misjudges at most the cells that the rim crosses: 2 in each of 200 lines.
    assert np.abs(w - want).max() <= 2 / 200
    assert w.dtype == np.float32


def test_array_aperture(device):
    a = values()
    own, w = np.random.default_rng(23).random((2, 5, 8)).astype(np.float32)
    lf = light_field(device, a, weights=own)
    got = lf.render(aperture=w).to_numpy()
    want = twin(a.astype(float), w.astype(float) * own)
    assert np.abs(got - want).max() <= rounding(a)
    moved = aperture_weights(lf, w.tolist(), (1, 5))  # the middle is (2, 3.5)
    want = np.zeros((5, 8))
    want[:4, 2:] = (w[1:, :6] + w[1:, 1:7]) / 2
    want[:4, 1] = w[1:, 0] / 2
    np.testing.assert_allclose(moved, want, atol=1e-7)


OUTSIDE = r"v from 0 to 4 and u from 0 to 7"
PAIR = r"viewpoint must be \(v, u\), got"
VIEWS_ACROSS = "aperture must be views across"
REFUSED = [
    (lambda lf: lf.view(-0.1, 0), ValueError, OUTSIDE),
    (lambda lf: lf.view(np.nan, 1), ValueError, OUTSIDE),
    (lambda lf: lf.render(aperture=2, viewpoint=(0, 7.01)), ValueError, OUTSIDE),
    (lambda lf: lf.render(viewpoint=3), ValueError, PAIR),
    (lambda lf: lf.render(aperture=2, viewpoint=(1, 2, 3)), ValueError, PAIR),
    (lambda lf: lf.epi(), ValueError, "epi must get y and v, or x and u, got"),
    (lambda lf: lf.epi(y=1, x=1), ValueError, "epi must get y and v, or x and u, got"),
    (lambda lf: lf.epi(y=1, v=1, x=1), ValueError, "epi must get y and v, or x and u, got"),
    (lambda lf: lf.epi(y=7, v=0), ValueError, "y must be an integer from 0 to 6, got 7"),
    (lambda lf: lf.epi(x=0.5, u=1), ValueError, "x must be an integer from 0 to 10, got 0.5"),
    (lambda lf: lf.render(aperture="f/200"), ValueError, r"'f/200' is wider than .* f/266\.7"),
    (lambda lf: lf.render(aperture="f66"), ValueError, VIEWS_ACROSS),
    (lambda lf: lf.render(aperture="f/-3"), ValueError, VIEWS_ACROSS),
    (
        lambda lf: replace(lf, camera=None).render(aperture="f/400"),
        ValueError,
        "needs the camera and the spacing",
    ),
    (lambda lf: lf.render(aperture=np.ones((8, 5))), ShapeError, r"\(5, 8\), got \(8, 5\)"),
    (lambda lf: lf.render(aperture=np.full((5, 8), np.nan)), ValueError, "finite and not negative"),
    (lambda lf: lf.render(aperture=np.full((5, 8), -1)), ValueError, "finite and not negative"),
    (lambda lf: lf.render(aperture=0), ValueError, VIEWS_ACROSS),
    (lambda lf: lf.render(aperture=9), ValueError, "must be at most the 8 views across"),
    (lambda lf: lf.render(aperture=0.0), ValueError, VIEWS_ACROSS),
    (lambda lf: lf.render(aperture=1.01), ValueError, VIEWS_ACROSS),
    (lambda lf: lf.render(aperture=True), ValueError, VIEWS_ACROSS),
    (lambda lf: lf.render(aperture={"k": 3}), ValueError, VIEWS_ACROSS),
    (lambda lf: lf.render(aperture=1), ValueError, "must include a view with a weight"),
]


def test_what_is_refused(device):
    weights = np.ones((5, 8))
    weights[2] = 0
    lf = light_field(device, spacing=SPACING, camera=CAMERA, weights=weights)
    aperture_weights(lf, "f/266", None)  # 0.902 mm of 0.9: a rounded number
    for call, error, message in REFUSED:
        with pytest.raises(error, match=message):
            call(lf)
