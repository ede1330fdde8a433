"""LightField: what it takes, what it keeps, what it refuses, and its law of disparity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyopencl as cl
import pyopencl.array as cla
import pytest

from clplen.errors import DeviceError, ShapeError
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage

SPACING = (-120e-6, -120e-6, 150e-6, 150e-6)  # du/dx = -0.8


def samples(dtype=np.float32, shape=(2, 3, 5, 7)) -> np.ndarray:
    return np.random.default_rng(11).integers(1, 250, shape).astype(dtype)


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [
        (np.uint8, (2, 3, 5, 7)),
        (np.uint16, (3, 2, 4, 5, 3)),
        (np.float16, (2, 3, 5, 7)),
        (np.float32, (3, 2, 4, 5, 3)),
    ],
)
def test_storage_stays(device, dtype, shape):
    values = samples(dtype, shape)
    lf = LightField.from_array(values, device=device)
    assert lf.dtype == dtype
    assert lf.shape == shape
    assert lf.data.nbytes == values.nbytes
    np.testing.assert_array_equal(lf.to_numpy(), values)


@pytest.mark.parametrize(
    ("dtype", "kept"),
    [(np.float64, "f4"), (np.int32, "f4"), (np.bool_, "f4"), (">f4", "f4"), (">u2", "u2")],
)
def test_other_real_types_become_float32(device, dtype, kept):
    values = samples().astype(dtype)
    lf = LightField.from_array(values, device=device)
    assert lf.dtype == kept
    np.testing.assert_array_equal(lf.to_numpy(), values)


def test_device_array_is_not_copied(device):
    array = cla.to_device(device.queue, samples(np.uint16))
    assert LightField.from_array(array, device=device).data is array


def test_device_array_of_another_queue(device):
    queue = cl.CommandQueue(device.context)
    values = samples(shape=(2, 3, 400, 500))
    array = cla.to_device(queue, values)
    for _ in range(20):  # what must be done before the samples are looked at
        array += np.float32(1)
        array -= np.float32(1)
    marker = cl.enqueue_marker(queue)
    lf = LightField.from_array(array, device=device)
    assert marker.command_execution_status == cl.command_execution_status.COMPLETE
    assert lf.data is array
    np.testing.assert_array_equal(lf.to_numpy(), values)


def test_array_of_another_context_is_refused(device):
    other = cl.Context([device.cl_device])  # a name keeps it alive: Intel's queue does not
    array = cla.to_device(cl.CommandQueue(other), samples())
    with pytest.raises(DeviceError, match="belongs to another OpenCL context"):
        LightField.from_array(array, device=device)


def test_what_is_refused(device):
    strided = cla.to_device(device.queue, samples())[:, :, :, ::2]
    integers = cla.to_device(device.queue, samples(np.int32))
    holed, negative, odd = samples(), np.ones((2, 3)), r"shape \(v, u, y, x\) or \(v, u, y, x, c\)"
    holed[1, 2, 3, 4], holed[0, 0, 0, 0], negative[1, 1] = np.nan, -np.inf, -1
    metres = r"spacing must be \(dv, du, dy, dx\) in metres"
    for given, words, error, message in (
        (strided, {}, ShapeError, "C-contiguous, got strides"),
        (integers, {}, TypeError, "uint8, uint16, float16 or float32, got int32"),
        (samples(np.complex64), {}, TypeError, "A light field must be real, got complex64"),
        (np.ones((2, 3, 5), np.float32), {}, ShapeError, odd),
        (np.ones((2, 0, 5, 7), np.float32), {}, ShapeError, odd),
        (np.ones((1, 2, 3, 4, 5, 6), np.float32), {}, ShapeError, odd),
        (holed, {}, ValueError, "2 samples that are NaN or infinite"),
        (samples(), {"weights": np.ones((3, 2))}, ShapeError, r"weights must have the shape"),
        (samples(), {"weights": negative}, ValueError, "finite, not negative and not all 0"),
        (samples(), {"weights": np.inf * negative}, ValueError, "finite, not negative and not"),
        (samples(), {"weights": 0 * negative}, ValueError, "not all 0"),
        (samples(), {"spacing": (1e-4, 1e-4, 1e-4)}, ValueError, metres),
        (samples(), {"spacing": (1e-4, 1e-4, 0, 1e-4)}, ValueError, metres),
    ):
        with pytest.raises(error, match=message):
            LightField.from_array(given, device=device, **words)


def test_too_large_is_refused_before_it_is_made(device, monkeypatch):
    values = samples(np.uint16)
    monkeypatch.setattr(device, "memory_bytes", 419)
    with pytest.raises(DeviceError, match=r"This light field needs 420 bytes .* has 419 bytes"):
        LightField.from_array(values, device=device)


def test_black_views_get_no_weight(device):
    values = samples(np.uint8)
    values[0, 0] = values[1, 2] = 0
    lf = LightField.from_array(values, device=device)
    np.testing.assert_array_equal(lf.weights, [[0, 1, 1], [1, 1, 0]])
    assert lf.weights.dtype == np.float32
    given = LightField.from_array(values, device=device, weights=np.full((2, 3), 0.5))
    np.testing.assert_array_equal(given.weights, np.full((2, 3), 0.5))


def test_disparity_of_the_thesis_camera(device):
    """alpha(dz) = (2f + 2dz)/(2f + dz): nearer is larger (dz = -50, +50 mm)."""
    lf = LightField.from_array(samples(), device=device, spacing=SPACING)
    alpha = [0.19 / 0.19 * (0.24 - 0.1) / (0.24 - 0.05), 1.0, (0.24 + 0.1) / (0.24 + 0.05)]
    d = lf.disparity(alpha)
    np.testing.assert_allclose(d, [0.2105263, 0, -0.1379310], atol=1e-6)
    np.testing.assert_allclose(lf.alpha(d), alpha, rtol=1e-12)


def test_disparity_of_naive_cells(device):
    """x = X/alpha + u (1/alpha - 1): another law, met at alpha = 1."""
    lf = LightField.from_array(samples(), device=device, spacing=SPACING)
    lf = replace(lf, decode="naive")
    alpha = np.array([0.7368421, 1.0, 1.1724138])
    d = lf.disparity(alpha)
    np.testing.assert_allclose(d, 0.8 * (1 / alpha - 1), rtol=1e-12)
    np.testing.assert_allclose(lf.alpha(d), alpha, rtol=1e-12)


def test_disparity_needs_spacing_and_a_positive_alpha(device):
    lf = LightField.from_array(samples(), device=device)
    with pytest.raises(ValueError, match="alpha needs the spacing of views and pixels"):
        lf.disparity(1.1)
    assert np.isnan(lf.alpha([0.1, 0.2])).all()
    spaced = replace(lf, spacing=SPACING)
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="positive and finite"):
            spaced.disparity(bad)


def raw_image(device) -> RawImage:
    """5 x 7 lenslets of 4 pixels; sub-images 4.25 pixels apart."""
    values = np.random.default_rng(13).random((20, 28)).astype(np.float32)
    step = 4.25
    sub_images = LensletGrid(
        (5, 7), (4, 4), (9.5 - 2 * step, 13.5 - 3 * step), (step, 0), (0, step)
    )
    cells = LensletGrid((5, 7), (4, 4), (1.5, 1.5), (4, 0), (0, 4))
    return RawImage(device.upload(values), device, 5e-6, sub_images, cells, SPACING)


def test_from_raw(device):
    raw = raw_image(device)
    calibrated, naive = LightField.from_raw(raw), LightField.from_raw(raw, decode="naive")
    for lf, name in ((calibrated, "calibrated"), (naive, "naive")):
        assert lf.shape == (4, 4, 5, 7)
        assert lf.dtype == np.float32
        assert lf.spacing == SPACING
        assert lf.raw is raw
        assert lf.decode == name
        np.testing.assert_array_equal(lf.weights, np.ones((4, 4)))
    cells = raw.to_numpy().reshape(5, 4, 7, 4).transpose(1, 3, 0, 2)
    np.testing.assert_array_equal(naive.to_numpy(), cells)
    # The middle lenslet's sub-image lies in its cell; its neighbours' are a quarter pixel off.
    middle = calibrated.to_numpy()[:, :, 2, 3]
    np.testing.assert_array_equal(middle, cells[:, :, 2, 3])
    assert np.abs(calibrated.to_numpy() - cells).max() > 0.1


def test_from_raw_with_an_unknown_decode(device):
    with pytest.raises(ValueError, match="decode must be 'calibrated' or 'naive', got 'exact'"):
        LightField.from_raw(raw_image(device), decode="exact")
