"""projector.cl: a matrix for each frequency and its transpose, against NumPy."""

import numpy as np
import pytest
from tolerance import relative_max

WIDTH = 16


def launched(device, name, out, R, other, *, add=False, depth=2):
    blocks, rows, columns = R.shape[:3]
    defines = {"LANES": WIDTH if device.rows else 1, "HEIGHT": 3, "DEPTH": depth, "PANEL": 6}
    kernel = device.kernel("projector.cl", name, **defines, **({"ADD": True} if add else {}))
    items = -(-(rows if name == "forward" else columns) // 3)
    size = (blocks, 1) if device.rows else (blocks * WIDTH, items)
    sizes = (rows, columns, blocks, len(out))
    target = device.upload(out)
    device.launch(
        kernel, size, target, device.upload(R), device.upload(other), *(np.int32(k) for k in sizes)
    )
    return device.download(target)


@pytest.mark.parametrize("shape", [(2, 7, 5), (1, 5, 13)])
def test_forward_and_backward(device, shape):
    blocks, rows, columns = shape
    rng = np.random.default_rng(rows)
    R = rng.standard_normal((blocks, rows, columns, WIDTH)).astype(np.float32)
    f = rng.standard_normal((2, blocks, columns, 4, WIDTH)).astype(np.float32)
    g = rng.standard_normal((2, blocks, rows, 4, WIDTH)).astype(np.float32)
    # sums of up to 13 products, each rounded
    expected = np.einsum("qijl,bqjkl->bqikl", R.astype(float), f)
    back = np.einsum("qijl,bqikl->bqjkl", R.astype(float), g)
    for depth in (2, 50):
        assert relative_max(expected, launched(device, "forward", g, R, f, depth=depth)) < 1e-6
        assert relative_max(back, launched(device, "backward", f, R, g, depth=depth)) < 1e-6
    added = launched(device, "forward", g, R, f, add=True)
    assert relative_max(expected + g, added) < 1e-6
