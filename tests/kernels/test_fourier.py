"""fourier.cl: channels as complex arrays, matrices on an axis, phase ramps, oblique slices."""

from __future__ import annotations

import numpy as np
import pytest
from reference_render import phase_ramps as twin
from reference_render import steps
from tolerance import relative_max

from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.fourier_slice import fourier_stack
from clplen.lightfield.refocusing.phase_ramps import fourier_refocus, transform_views

TYPES = (np.uint8, np.uint16, np.float16, np.float32)
SHAPES = [(3, 4, 7, 10), (2, 3, 12, 5, 3), (1, 5, 6, 11)]
SPACING = (-3e-4, -2e-4, 1e-4, 1.5e-4)  # d along y is 2.25 times d along x
D = (0.0, -0.65, 1.0, 1.9)


def light_field(device, shape, dtype=np.float32, **more) -> tuple[np.ndarray, LightField]:
    a = np.random.default_rng(3).uniform(1, 250, shape).astype(dtype)
    w = np.random.default_rng(4).uniform(0.2, 1.7, shape[:2]).astype(np.float32)
    w[0, 1] = 0
    return a, LightField.from_array(a, device=device, weights=w, **more)


@pytest.mark.parametrize(("dtype", "shape"), list(zip(TYPES, [*SHAPES, SHAPES[1]], strict=True)))
def test_phase_ramps(device, dtype, shape):
    a, lf = light_field(device, shape, dtype)
    got = device.download(fourier_refocus(lf, np.array(D), lf.weights)).astype(float)
    for picture, d in zip(got, D, strict=True):
        want = twin(a, d, weights=lf.weights.astype(float), step=steps(shape[:2]))
        assert relative_max(want, picture) <= 1e-5


@pytest.mark.parametrize(("width", "shape"), list(zip((4, 6, 8), SHAPES, strict=True)))
def test_slices(device, width, shape):
    """The errors that the doc string states: even and odd counts of views, and rows apart."""
    a, lf = light_field(device, shape, spacing=SPACING)
    got = fourier_stack(lf, disparities=D, width=width).to_numpy().astype(float)
    ratio = SPACING[0] / SPACING[1] * SPACING[3] / SPACING[2]
    for picture, d in zip(got, D, strict=True):
        want = twin(a, d, weights=lf.weights.astype(float), step=steps(shape[:2], ratio))
        assert relative_max(want, picture) <= {4: 2e-3, 6: 1e-4, 8: 1e-5}[width]


def test_a_matrix_on_the_middle_axis(device):
    random = np.random.default_rng(5)
    values, matrix = (
        random.normal(size=shape) + 1j * random.normal(size=shape) for shape in ((2, 3, 7), (5, 3))
    )
    got = transform_views(
        device.upload(values.astype(np.complex64)), matrix, batch=2, n=7, device=device
    )
    want = np.einsum("ij,bjn->bin", matrix, values)
    assert relative_max(want, device.download(got)) <= 1e-6
