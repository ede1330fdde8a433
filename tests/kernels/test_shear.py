"""shear.cl against a float64 twin of plain slices and weights."""

from __future__ import annotations

import numpy as np
import pytest
from tolerance import relative_max

from clplen.errors import DeviceError
from clplen.lightfield.arrays import shear
from clplen.lightfield.arrays.shear import shear_sum

DISPARITIES = (-2, -1.37, -1, 0, 0.5, 1, 1.9, 2, 400.3)  # the last one leaves the views
SHAPES = [
    (3, 4, 7, 5),  # rows shorter than a vector
    (4, 3, 13, 43, 3),  # one sample more than whole vectors
    (5, 2, 1, 211, 3),
    (2, 3, 31, 131),
    (1, 1, 3, 2),
]


def light_field(shape, dtype="float32", seed=5):
    """Values from 20 to 250, so that no sample is lost in the sum."""
    values = np.random.default_rng(seed).uniform(20, 250, shape)
    return values.astype(dtype)


def view_weights(shape, seed=7):
    """Positive and unlike, one view in three left out."""
    weights = np.random.default_rng(seed).uniform(0.2, 1.7, shape[:2]).astype(np.float32)
    if weights.size > 1:
        weights.flat[::3] = 0
    return weights


def shifts(shape, disparities=DISPARITIES, ratio=1.3):
    """Shifts along y, where the disparity is `ratio` times that along x, and along x."""
    V, U = shape[:2]
    d = np.asarray(disparities, float)
    return (
        np.outer(d * ratio, (V - 1) / 2 - np.arange(V)),
        np.outer(d, (U - 1) / 2 - np.arange(U)),
    )


def moved(view, y, x):
    """(view[i + y, j + x], whether that lies inside) for every pixel (i, j)."""
    rows, columns = (np.arange(n) + step for n, step in zip(view.shape, (y, x), strict=False))
    ny, nx = view.shape[:2]
    inside = np.outer((rows >= 0) & (rows < ny), (columns >= 0) & (columns < nx))
    values = view[np.clip(rows, 0, ny - 1)][:, np.clip(columns, 0, nx - 1)].astype(np.float64)
    return np.where(inside.reshape(inside.shape + (1,) * (view.ndim - 2)), values, 0), inside


def twin(field, weights, shift_y, shift_x, total=False):
    """The four taps of every view, one after the other, in float64."""
    pictures = []
    for along_y, along_x in zip(shift_y, shift_x, strict=True):
        top, used = np.zeros(field.shape[2:]), np.zeros(field.shape[2:4])
        for v, u in zip(*np.nonzero(weights), strict=True):
            sy = along_y[v] if along_y.ndim == 1 else along_y[v, u]
            sx = along_x[u] if along_x.ndim == 1 else along_x[v, u]
            y, x = (int(np.floor(s)) for s in (sy, sx))
            below, beside = sy - y, sx - x
            for w, i, j in (
                ((1 - below) * (1 - beside), y, x),
                ((1 - below) * beside, y, x + 1),
                (below * (1 - beside), y + 1, x),
                (below * beside, y + 1, x + 1),
            ):
                values, inside = moved(field[v, u], i, j)
                top += float(weights[v, u]) * w * values
                used += float(weights[v, u]) * w * inside
        used = used.reshape(used.shape + (1,) * (top.ndim - 2))
        mean = np.divide(top, used, out=np.zeros_like(top), where=used > 0)
        pictures.append(top if total else mean)
    return np.array(pictures)


def tolerance(shape):
    """Of positive samples and weights, relative to the largest value.

    Units of 2^-24: U + V additions and a weight, a tap, a product and a blend (2) for the sum,
    V additions, a table, a blend and a product for the weights, and the division.
    """
    V, U = shape[:2]
    return (U + V + 5 + V + 3 + 1) * 2.0**-24


def sheared(device, field, *args, **options):
    return device.download(shear_sum(device.upload(field), *args, device=device, **options))


def planes(device):
    """Fewer on the simulator, which runs each instruction: fractional, whole and outside."""
    return (-1.37, 1, 400.3) if device.platform == "Oclgrind" else DISPARITIES


def check(device, shape, dtype="float32", disparities=None, **options):
    disparities = planes(device) if disparities is None else disparities
    field, weights = light_field(shape, dtype), view_weights(shape)
    moves = shifts(shape, disparities)
    got = sheared(device, field, weights, *moves, **options)
    want = twin(field, weights, *moves, **options)
    assert got.dtype == np.float32
    assert relative_max(want, got) <= tolerance(shape) < 1e-5


def test_tables_of_one_axis_are_not_those_of_another(device):
    field, weights = light_field(SHAPES[1]), view_weights(SHAPES[1])
    for down, right in ((0.2, 0.2), (0.2, 0.4), (0.4, 0.4)):  # only one of them changes at a time
        moves = (shifts(SHAPES[1], (down,))[0], shifts(SHAPES[1], (right,))[1])
        got = sheared(device, field, weights, *moves)
        want = twin(field, weights, *moves)
        assert relative_max(want, got) <= tolerance(SHAPES[1])


@pytest.mark.parametrize("shape", SHAPES)
def test_against_twin(device, shape):
    check(device, shape)


@pytest.mark.parametrize("dtype", ["float16", "uint8", "uint16"])
def test_other_samples_against_twin(device, dtype):
    check(device, SHAPES[1], dtype)


def test_sums_instead_of_means(device):
    check(device, SHAPES[0], total=True)
    check(device, SHAPES[1], total=True)


@pytest.mark.parametrize(
    ("shape", "own"),
    [(SHAPES[1], (True, True)), (SHAPES[1], (False, True)), (SHAPES[0], (True, False))],
)
def test_views_on_no_grid(device, shape, own):
    """Shifts of shape (P, V, U) along y, x, or both."""
    field, weights = light_field(shape), view_weights(shape)
    d = planes(device)
    rng = np.random.default_rng(3)
    jitter = [np.multiply.outer(d, rng.uniform(-0.4, 0.4, shape[:2])) for _ in "yx"]
    grid = shifts(shape, d)
    full = (grid[0][:, :, None] + jitter[0], grid[1][:, None] + jitter[1])
    moves = [full[i] if own[i] else grid[i] for i in (0, 1)]
    got = sheared(device, field, weights, *moves)
    want = twin(field, weights, *moves)
    assert relative_max(want, got) <= tolerance((shape[0] * shape[1], 1)) < 1e-5


@pytest.mark.thorough
@pytest.mark.parametrize("vectors", [(4, 6), (16, 8)])
def test_vectors_of_other_machines(device, vectors, monkeypatch):
    monkeypatch.setattr(shear, "vector_lanes", lambda device: vectors)
    check(device, (4, 3, 13, 43, 3))
    check(device, (2, 3, 5, 301))


@pytest.mark.parametrize("nbytes", [64, 3072, 24576])  # with 64 bytes, work-items a sample
def test_little_local_memory(device, nbytes, monkeypatch):
    monkeypatch.setattr(shear, "vector_lanes", lambda device: (4, 6))
    monkeypatch.setattr(shear, "_LOCAL_BYTES", nbytes)
    check(device, (4, 3, 13, 43, 3))


def test_several_launches(device, monkeypatch):
    monkeypatch.setattr(shear, "_MAX_PLANES", 2)
    check(device, (3, 4, 7, 29))


def test_weights_of_either_sign(device):
    shape = (4, 5, 9, 14)
    field = light_field(shape)
    weights = view_weights(shape) - np.float32(0.9)
    got = sheared(device, field, weights, *shifts(shape), total=True)
    want = twin(field, weights, *shifts(shape), total=True)
    largest = twin(field, abs(weights), *shifts(shape), total=True).max()
    assert np.abs(got - want).max() <= tolerance(shape) * largest


def test_a_view_of_weight_zero_is_not_read(device):
    shape = (3, 4, 9, 21)
    field, weights = light_field(shape), view_weights(shape)
    assert (weights == 0).sum() > 2
    moves = shifts(shape, planes(device))
    clean = sheared(device, field, weights, *moves)
    field[weights == 0] = np.nan
    np.testing.assert_array_equal(sheared(device, field, weights, *moves), clean)


def test_a_bad_row_stays_where_it_is(device):
    """Rows and columns outside a view are not those of its neighbour in memory."""
    shape = (2, 2, 9, 21)
    field = light_field(shape)
    field[:, :, 0] = np.nan
    got = sheared(device, field, np.ones((2, 2)), [[2, 2]], [[-1, 1]], total=True)
    assert np.isfinite(got).all()


def test_same_bits_and_input_left_alone(device):
    shape = (4, 5, 17, 53, 3)
    field = light_field(shape, "uint16")
    data = device.upload(field)
    args = (data, view_weights(shape), *shifts(shape, planes(device)))
    runs = [device.download(shear_sum(*args, device=device)) for _ in range(3)]
    np.testing.assert_array_equal(runs[1], runs[0])
    np.testing.assert_array_equal(runs[2], runs[0])
    np.testing.assert_array_equal(device.download(data), field)


def test_pictures_that_do_not_fit(device, monkeypatch):
    shape = (2, 3, 8, 9)
    data, weights, moves = device.upload(light_field(shape)), view_weights(shape), shifts(shape)
    monkeypatch.setattr(device, "memory_bytes", 4 * 9 * 8 * 9 - 1)
    with pytest.raises(DeviceError, match="2,592 bytes"):
        shear_sum(data, weights, *moves, device=device)
