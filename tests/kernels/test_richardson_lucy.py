"""richardson_lucy.cl: one step after the other, against NumPy."""

import numpy as np
from tolerance import relative_max

RNG = np.random.default_rng(1)
FRAMES, NY, NX = 2, 5, 7


def launched(device, name, out, *args):
    target = device.upload(out)
    given = (device.upload(a) if isinstance(a, np.ndarray) else np.float32(a) for a in args)
    kernel = device.kernel("richardson_lucy.cl", name)
    device.launch_rows(kernel, out.shape, target, *given, np.int32(NY), np.int32(NX))
    return device.download(target)


def arrays():
    first, second = RNG.random((2, FRAMES, NY, NX), np.float32)
    return first, second, RNG.random((NY, NX), np.float32)


def test_expected(device):
    E, b, w = arrays()
    assert relative_max(w * E + b, launched(device, "expected", E, w, b)) < 2e-7


def test_ratio_of_what_is_seen(device):
    out, counts, w = arrays()
    E = RNG.random(out.shape, np.float32)
    E[1, 2, 3] = w[4, 5] = 0
    expected = np.divide(w * counts, E, out=np.zeros_like(E), where=E > 0)
    assert relative_max(expected, launched(device, "ratio", out, counts, E, w)) < 3e-7


def test_update(device):
    V, B, N = arrays()
    B[0, 1, 1], N[3, 2] = -0.5, 1e-3
    expected = np.where(N > 0.01, V * np.maximum(B, 0) / N, 0)
    assert relative_max(expected, launched(device, "update", V, B, N, 0.01)) < 3e-7


def test_moved(device):
    X, Y, _ = arrays()
    assert np.array_equal(launched(device, "moved", X, X, Y), X - Y)


def test_ahead(device):
    X, P, _ = arrays()
    a = np.array([0.25, 0.75], np.float32)
    x, y, p = (device.upload(values) for values in (X, 0 * X, P))
    kernel = device.kernel("richardson_lucy.cl", "ahead")
    device.launch_rows(kernel, X.shape, x, y, p, device.upload(a), np.int32(NY), np.int32(NX))
    expected = np.maximum(X + a[:, None, None] * (X - P), 0)
    assert (expected == 0).any()
    assert relative_max(expected, device.download(x)) < 3e-7
    assert np.array_equal(device.download(x), device.download(y))
    assert np.array_equal(device.download(p), X)
