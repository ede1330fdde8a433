"""parametrise.cl against its sum in float64, view by view and column by column."""

from __future__ import annotations

import numpy as np
import pytest
from reference_lightfield import keys_kernel, linear_kernel
from tolerance import relative_max

from clplen.lightfield.model.light_field import LightField

FOCAL = 0.2
SPACINGS = [(-110e-6, -130e-6, 70e-6, 60e-6), (90e-6, -130e-6, 70e-6, -60e-6)]
LIMIT = 1e-5  # of the maximum


def twin(a, weights, spacing, views, to_angles, kind="linear"):
    """out[j, i, y, x]: at theta = -du/F (i - ic) the main lens is seen at u = x - F theta."""
    V, U, ny, nx = a.shape[:4]
    out = np.zeros((*views, *a.shape[2:]))
    sign = 1 if to_angles else -1
    y, x = ((np.arange(n) - (n - 1) / 2) * p for n, p in zip((ny, nx), spacing[2:], strict=True))
    for j, i, q, p in np.ndindex(*views, ny, nx):
        v = (V - 1) / 2 + j - (views[0] - 1) / 2 + sign * y[q] / spacing[0]
        u = (U - 1) / 2 + i - (views[1] - 1) / 2 + sign * x[p] / spacing[1]
        out[j, i, q, p] = sample(a[:, :, q, p], weights, v, u, kind)
    return out


def sample(a, weights, v, u, kind):
    kernel = {"linear": linear_kernel, "cubic": keys_kernel}[kind]
    taps, total, used = (0, 1) if kind == "linear" else (-1, 0, 1, 2), 0.0, 0.0
    for k, m in np.ndindex(len(taps), len(taps)):
        row, column = int(np.floor(v)) + taps[k], int(np.floor(u)) + taps[m]
        w = float(kernel(np.array(v - row)) * kernel(np.array(u - column)))
        if abs(w) < 1e-12:
            continue
        inside = 0 <= row < len(a) and 0 <= column < a.shape[1]
        if not (inside and weights[row, column] > 0):
            if kind == "cubic":
                return sample(a, weights, v, u, "linear")
            continue
        total = total + w * a[row, column].astype(float)
        used += w
    return total / used if used else 0 * a[0, 0].astype(float)


@pytest.mark.parametrize(
    ("shape", "dtype", "kind"),
    [
        ((3, 4, 5, 7), "uint8", "linear"),
        ((3, 4, 5, 7), "float32", "cubic"),
        ((4, 3, 6, 5, 3), "float32", "linear"),
        ((2, 1, 4, 1), "uint16", "cubic"),
        ((1, 2, 3, 4), "float16", "cubic"),
    ],
)
def test_against_twin(device, shape, dtype, kind):
    rng = np.random.default_rng(3)
    a = rng.uniform(1, 250, shape).astype(dtype)
    weights = rng.uniform(0.2, 1, shape[:2])
    if weights.size > 2:
        weights.flat[1] = 0
    for spacing in SPACINGS:
        lf = LightField.from_array(a, device=device, spacing=spacing, weights=weights)
        views = (shape[0] + 2, shape[1] + 3)
        found = lf.resample("point-angle", image_distance=FOCAL, views=views, interpolation=kind)
        want = twin(a, weights, spacing, views, True, kind)
        assert relative_max(want, found.to_numpy()) <= LIMIT
        angles = (-spacing[0] / FOCAL, -spacing[1] / FOCAL, *spacing[2:])
        np.testing.assert_allclose(found.spacing, angles)
        options = {"image_distance": FOCAL, "views": shape[:2], "interpolation": kind}
        back = found.resample("two-plane", **options)
        values = found.to_numpy()
        want = twin(values, found.weights, spacing, shape[:2], False, kind)
        assert relative_max(want, back.to_numpy()) <= LIMIT
        np.testing.assert_allclose(back.spacing, spacing)
