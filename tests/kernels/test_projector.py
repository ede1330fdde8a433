"""projector.cl: a matrix for each frequency and its transpose, against NumPy."""

import numpy as np
import pytest
from tolerance import relative_max

WIDTH = 16


def launched(device, name, out, R, other, *, stretch, add=False, **switches):
    blocks, rows, columns = R.shape[:3]
    defines = {"LANES": WIDTH if device.rows else 1, "HEIGHT": 3}
    switches |= {"ADD": True} if add else {}
    kernel = device.kernel("projector.cl", name, **defines, **switches)
    items = -(-rows // 3) if name == "forward" else -(-columns // stretch)
    size = (items, blocks) if device.rows else (blocks * WIDTH, items)
    middle = () if name == "forward" else (stretch,)
    sizes = (rows, columns, *middle, blocks, len(out))
    target = device.upload(out)
    device.launch(
        kernel, size, target, device.upload(R), device.upload(other), *(np.int32(k) for k in sizes)
    )
    return device.download(target)


@pytest.mark.parametrize("shape", [(2, 7, 5), (1, 3, 4), (3, 1, 1)])
def test_forward_and_backward(device, shape):
    blocks, rows, columns = shape
    rng = np.random.default_rng(rows)
    R = rng.standard_normal((blocks, rows, columns, WIDTH)).astype(np.float32)
    f = rng.standard_normal((2, blocks, columns, 4, WIDTH)).astype(np.float32)
    g = rng.standard_normal((2, blocks, rows, 4, WIDTH)).astype(np.float32)
    # sums of up to 7 products, each rounded
    expected = np.einsum("qijl,bqjkl->bqikl", R.astype(float), f)
    assert relative_max(expected, launched(device, "forward", g, R, f, stretch=1)) < 1e-6
    added = launched(device, "forward", g, R, f, stretch=1, add=True)
    assert relative_max(expected + g, added) < 1e-6
    expected = np.einsum("qijl,bqikl->bqjkl", R.astype(float), g)
    for stretch in (2, columns):
        assert relative_max(expected, launched(device, "backward", f, R, g, stretch=stretch)) < 1e-6


@pytest.mark.parametrize("switches", [{"MIRRORED"}, {"TURNED"}, {"MIRRORED", "TURNED"}])
def test_parts_with_signs(device, switches):
    """Columns at (-y, x) change their sign; all are multiplied by -i, backward by i."""
    rng = np.random.default_rng(5)
    R = rng.standard_normal((2, 4, 5, WIDTH)).astype(np.float32)
    f = rng.standard_normal((2, 2, 5, 4, WIDTH)).astype(np.float32)
    g = rng.standard_normal((2, 2, 4, 4, WIDTH)).astype(np.float32)
    sign = -1 if "MIRRORED" in switches else 1
    factor = np.array([1, sign]) * (-1j if "TURNED" in switches else 1)

    def columns(values, by):
        pairs = (values[..., 0::2, :] + 1j * values[..., 1::2, :]) * by[:, None]
        out = np.empty(values.shape)
        out[..., 0::2, :], out[..., 1::2, :] = pairs.real, pairs.imag
        return out

    on = dict.fromkeys(switches, True)
    expected = g + np.einsum("qijl,bqjkl->bqikl", R.astype(float), columns(f, factor))
    found = launched(device, "forward", g, R, f, stretch=1, add=True, **on)
    assert relative_max(expected, found) < 1e-6
    expected = f + np.einsum("qijl,bqikl->bqjkl", R.astype(float), columns(g, factor.conj()))
    found = launched(device, "backward", f, R, g, stretch=5, add=True, **on)
    assert relative_max(expected, found) < 1e-6
