"""The light-field twins against textures whose light field is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from tolerance import relative_max

pytestmark = pytest.mark.nightly

RNG = np.random.default_rng(11)


def ramp_lightfield(views: tuple[int, int], d: float, slopes: tuple[float, float]) -> np.ndarray:
    """L = T(y + d (v - vc), x + d (u - uc)) of a linear texture: bilinear taps are exact."""
    v, u, y, x = np.meshgrid(*map(np.arange, (*views, 13, 17)), indexing="ij")
    vc, uc = (views[0] - 1) / 2, (views[1] - 1) / 2
    return 3.0 + slopes[0] * (y + d * (v - vc)) + slopes[1] * (x + d * (u - uc))


@pytest.mark.parametrize("views", [(4, 3), (1, 5)])
@pytest.mark.parametrize("d", [0.7, -0.45, 0.0])
def test_refocus_on_the_own_disparity_is_the_centre_view(views, d):
    lf = ramp_lightfield(views, d, (0.31, -0.17))
    y, x = np.arange(13.0)[:, None], np.arange(17.0)[None, :]
    inner = np.s_[3:-3, 3:-3]
    centre = 3.0 + 0.31 * y - 0.17 * x
    assert relative_max(centre[inner], ref.refocus(lf, d)[inner]) < 1e-14
    assert relative_max(centre[inner], ref.refocus(lf, d, edge="clamp")[inner]) < 1e-14


def test_refocus_sign_and_weights_by_hand():
    """One view at (v, u) = (2, 0) of 3 x 3, d = 0.25: its samples come from y - 0.25, x + 0.25."""
    lf = RNG.normal(size=(3, 3, 6, 7, 2))
    weights = np.zeros((3, 3))
    weights[2, 0] = 0.4
    a = lf[2, 0]
    up, left = np.roll(a, 1, axis=0), np.roll(a, -1, axis=1)
    both = np.roll(up, -1, axis=1)
    expected = 0.5625 * a + 0.1875 * up + 0.1875 * left + 0.0625 * both
    got = ref.refocus(lf, 0.25, weights=weights)
    assert relative_max(expected[1:, :-1], got[1:, :-1]) < 1e-14
    edge = 0.75 * a[0] + 0.25 * np.roll(a[0], -1, axis=0)
    assert relative_max(edge[:-1], got[0, :-1]) < 1e-14
    far = ref.refocus(lf, 9.0, weights=weights)
    assert np.all(far == 0)
    assert np.all(ref.refocus(lf, 9.0, weights=weights, edge="clamp") == a[0, -1])


def test_normalised_edges_keep_a_constant_and_use_all_weights():
    lf = np.full((3, 4, 8, 9), 2.5)
    weights = RNG.random((3, 4))
    for edge in ("normalised", "clamp"):
        got = ref.refocus(lf, 1.3, weights=weights, edge=edge)
        assert relative_max(np.full((8, 9), 2.5), got) < 1e-14
    lf = RNG.normal(size=(3, 4, 8, 9))
    assert relative_max(ref.render(lf, weights), ref.refocus(lf, 0.0, weights=weights)) < 1e-14
    with pytest.raises(KeyError):
        ref.refocus(lf, 0.0, edge="wrap")


def test_render_mean_and_total():
    lf = RNG.normal(size=(2, 3, 4, 5, 3))
    weights = np.array([[1.0, 0, 2], [0.5, 0, 0]])
    total = lf[0, 0] + 2 * lf[0, 2] + 0.5 * lf[1, 0]
    assert relative_max(total, ref.render(lf, weights, total=True)) < 1e-14
    assert relative_max(total / 3.5, ref.render(lf, weights)) < 1e-14


def test_aperture_weights_drop_the_smaller_half_below():
    w = ref.aperture_weights((5, 6), 3)
    assert np.array_equal(w[:, 2], [0, 1, 1, 1, 0])
    assert np.array_equal(w[2], [0, 1, 1, 1, 0, 0])


def test_viewpoint_weights():
    w = ref.viewpoint_weights((3, 4), 1.25, 2.0)
    expected = np.zeros((3, 4))
    expected[1, 2], expected[2, 2] = 0.75, 0.25
    assert np.allclose(w, expected, atol=1e-15)


def test_cubic_reproduces_quadratics_and_zero_edges():
    x = np.arange(9.0)
    positions = np.array([1.0, 2.3, 6.75, 7.0])
    matrix = ref.sampling_matrix(positions, 9, kernel="cubic")
    assert np.allclose(matrix @ (x**2 - 3 * x), positions**2 - 3 * positions, atol=1e-13)
    half = ref.sampling_matrix(np.array([3.5]), 9, kernel="cubic").toarray()[0]
    assert np.allclose(half, [0, 0, -0.0625, 0.5625, 0.5625, -0.0625, 0, 0, 0], atol=1e-15)
    outside = ref.sampling_matrix(np.array([-0.5, 8.5, 30.0]), 9, kernel="cubic")
    assert np.allclose(outside.sum(axis=1), [0.5, 0.5, 0])
    clamped = ref.sampling_matrix(np.array([-0.5, 30.0]), 9, kernel="cubic", edge="clamp")
    assert np.allclose(clamped.sum(axis=1), 1)
    with pytest.raises(ValueError, match="edge"):
        ref.sampling_matrix(positions, 9, edge="mirror")


def test_naive_decode_is_a_permutation():
    raw = np.arange(12.0 * 20).reshape(12, 20)
    lf = ref.decode_naive(raw, 4)
    assert lf.shape == (4, 4, 3, 5)
    assert lf[1, 3, 2, 4] == raw[2 * 4 + 1, 4 * 4 + 3]
    assert np.array_equal(np.sort(lf, axis=None), np.sort(raw, axis=None))


@pytest.mark.parametrize(("pixels", "count"), [(6, (5, 8)), (5, (4, 7))])
def test_calibrated_decode_samples_the_sub_image_centres(pixels, count):
    """A quadratic raw image is sampled exactly at x_k (1 + f_mu/F) + (j - (n-1)/2) dx."""
    m = 1 + 1 / 24
    ny, nx = (c * pixels for c in count)
    y, x = (np.arange(n) - (n - 1) / 2 for n in (ny, nx))
    raw = (2 + 0.3 * y - 0.02 * y**2)[:, None] * (1 - 0.1 * x + 0.01 * x**2)[None, :]
    lf = ref.decode_calibrated(raw, pixels, magnification=m)
    assert lf.shape == (pixels, pixels, *count)
    for v, u, i, k in ((0, 1, 1, 3), (pixels - 1, 2, 2, 5), (2, pixels - 1, 1, 2)):
        ys = (i - (count[0] - 1) / 2) * pixels * m + v - (pixels - 1) / 2
        xs = (k - (count[1] - 1) / 2) * pixels * m + u - (pixels - 1) / 2
        exact = (2 + 0.3 * ys - 0.02 * ys**2) * (1 - 0.1 * xs + 0.01 * xs**2)
        assert lf[v, u, i, k] == pytest.approx(exact, rel=1e-12)
    assert (
        relative_max(
            ref.decode_naive(raw, pixels), ref.decode_calibrated(raw, pixels, magnification=1.0)
        )
        < 1e-14
    )


def test_magnify_conserves_the_sum_of_a_smooth_picture():
    x = np.arange(41.0) - 20
    image = np.exp(-(x[:, None] ** 2) / 40 - (x[None, :] - 2) ** 2 / 30)
    for alpha in (0.8, 1.25):
        got = ref.magnify(image, alpha)
        assert got.sum() == pytest.approx(image.sum(), rel=0.02)
        assert np.argmax(got[20]) == 20 + round(2 / alpha)


@pytest.mark.parametrize(("index", "alpha"), [(0, 0.7), (37, 0.885), (60, 1.0), (111, 1.255)])
def test_thesis_curve_by_loops(index, alpha):
    """I(y', x') = sum over v, u of L(y'/alpha + v (1 - 1/alpha), ...) from its definition."""
    pixels, count = 3, 5
    raw = RNG.random((7 * pixels, 8 * pixels))
    alphas, energies = ref.thesis_curve(raw, pixels, near=(4, 3), window=count)
    assert alphas[index] == pytest.approx(alpha, abs=1e-12)
    lf = ref.decode_naive(raw[pixels : 6 * pixels, 2 * pixels : 7 * pixels], pixels)
    image = np.zeros((count, count))
    for i, k, v, u in np.ndindex(count, count, pixels, pixels):
        y = 2 + (i - 2) / alpha + (v - 1) * (1 - 1 / alpha)
        x = 2 + (k - 2) / alpha + (u - 1) * (1 - 1 / alpha)
        for row, column in np.ndindex(count, count):
            weight = max(0, 1 - abs(y - row)) * max(0, 1 - abs(x - column))
            image[i, k] += weight * lf[v, u, row, column]
    frequency = np.fft.fftfreq(count)
    high = np.hypot(frequency[:, None], frequency[None, :]) > 0.1
    expected = np.sum(np.abs(np.fft.fft2(image)[high]) ** 2)
    assert energies[index] == pytest.approx(expected, rel=1e-11)
    best = ref.thesis_alpha(raw, pixels, near=(4, 3), window=count)
    assert best == alphas[np.argmax(energies)]
