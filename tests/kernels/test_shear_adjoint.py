"""shear_adjoint.cl against a float64 twin of plain slices, and as the transpose of shear.cl."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from tolerance import relative_max

from clplen.compute.launcher import Launcher
from clplen.errors import DeviceError
from clplen.lightfield.arrays import shear_adjoint as module
from clplen.lightfield.arrays.shear_adjoint import shear_adjoint

DISPARITIES = (-2, -1.37, 0, 0.5, 1.9, 400.3)  # the last one leaves the views
SHAPES = [
    (3, 4, 7, 5),  # rows shorter than a vector
    (4, 3, 13, 43, 3),
    (2, 5, 11, 1),
    (5, 2, 1, 211, 3),
    (2, 3, 9, 131),
    (1, 1, 3, 2),
    (2, 2, 3, 9, 20),  # more channels than a vector holds
]


def planes(device):
    """Fewer on the simulator, which runs each instruction."""
    return (-1.37, 1, 400.3) if device.platform == "Oclgrind" else DISPARITIES


def numbers(*shape, seed=5):
    """Positive, so that no sample is lost in the sum."""
    return np.random.default_rng(seed).uniform(20, 250, shape).astype(np.float32)


def view_weights(shape, seed=7):
    """Positive and unlike, one view in three left out."""
    weights = np.random.default_rng(seed).uniform(0.2, 1.7, shape[:2]).astype(np.float32)
    if weights.size > 1:
        weights.flat[::3] = 0
    return weights


def shifts(shape, disparities, ratio=1.3):
    V, U = shape[:2]
    d = np.asarray(disparities, float)
    return (
        np.outer(d * ratio, (V - 1) / 2 - np.arange(V)),
        np.outer(d, (U - 1) / 2 - np.arange(U)),
    )


def scattered(shape, count, seed=9):
    """Shifts of views that lie on no grid."""
    return np.random.default_rng(seed).uniform(-4, 4, (2, count, *shape[:2]))


def interpolation(shift, n):
    """Matrix (n, n) that takes sample i from i + shift, 0 outside."""
    at = np.arange(n)[:, None] + shift
    return np.maximum(1 - np.abs(at - np.arange(n)), 0)


def twin(pictures, shape, weights, shift_y, shift_x, total=False):
    """Transposed matrices of every view, in float64."""
    out = np.zeros(shape)
    for p, picture in enumerate(pictures.astype(np.float64)):
        matrices = {}
        used = np.zeros(shape[2:4])
        for v, u in zip(*np.nonzero(weights), strict=True):
            sy = shift_y[p, v] if shift_y.ndim == 2 else shift_y[p, v, u]
            sx = shift_x[p, u] if shift_x.ndim == 2 else shift_x[p, v, u]
            my, mx = interpolation(sy, shape[2]), interpolation(sx, shape[3])
            matrices[v, u] = my, mx
            used += float(weights[v, u]) * np.outer(my.sum(axis=1), mx.sum(axis=1))
        used = used.reshape(used.shape + (1,) * (picture.ndim - 2))
        share = picture if total else np.divide(
            picture, used, out=np.zeros_like(picture), where=used > 1e-9
        )  # fmt: skip
        for (v, u), (my, mx) in matrices.items():
            out[v, u] += float(weights[v, u]) * np.einsum("ij,ik...,kl->jl...", my, share, mx)
    return out


def spread(device, pictures, *args, **options):
    return device.download(shear_adjoint(device.upload(pictures), *args, device=device, **options))


def tolerance(shape, count):
    """Of positive samples, relative to the largest value.

    Units of 2^-24: the weights that are divided by (U + V additions, 3), the division, the blend
    of two rows (3), a tap (2) and the sum of the planes (2 count).
    """
    V, U = shape[:2]
    return (U + V + 3 + 1 + 3 + 2 + 2 * count) * 2.0**-24


@pytest.mark.parametrize(("shape", "total"), [(shape, n % 2 > 0) for n, shape in enumerate(SHAPES)])
def test_grid_of_views(device, shape, total):
    disparities, weights = planes(device), view_weights(shape)
    moves = shifts(shape, disparities)
    pictures = numbers(len(disparities), *shape[2:])
    got = spread(device, pictures, shape, weights, *moves, total=total)
    want = twin(pictures, shape, weights, *moves, total=total)
    assert got.dtype == np.float32
    assert not got[weights == 0].any()
    assert relative_max(want, got) <= tolerance(shape, len(disparities)) < 1e-5


def test_scattered_views(device):
    shape, count = (2, 3, 9, 19, 3), 3
    weights, moves = view_weights(shape), scattered(shape, count)
    pictures = numbers(count, *shape[2:])
    got = spread(device, pictures, shape, weights, *moves)
    want = twin(pictures, shape, weights, *moves)
    assert relative_max(want, got) <= tolerance(shape, count)


def test_planes_of_several_launches_are_added(device, monkeypatch):
    shape, weights = (2, 3, 7, 29), np.array([[1, 0, 2], [0, 0, 0]], np.float32)
    moves, pictures = shifts(shape, (-1.4, 0.3, 0.9)), numbers(3, *shape[2:])
    monkeypatch.setattr(module, "_MAX_PLANES", 2)
    monkeypatch.setattr(module, "_NORM_FLOATS", 1)
    got = spread(device, pictures, shape, weights, *moves)
    assert relative_max(twin(pictures, shape, weights, *moves), got) <= tolerance(shape, 3)


def test_a_block_that_local_memory_does_not_hold_is_done_by_samples(device, monkeypatch):
    shape, weights = (2, 3, 7, 29), view_weights((2, 3))
    moves, pictures = shifts(shape, (-1.4, 0.3)), numbers(2, *shape[2:])
    monkeypatch.setattr(module, "_LOCAL_BYTES", 64)
    assert module._block(
        module.split_views(shape, weights, *moves), device
    ) is None  # fmt: skip
    got = spread(device, pictures, shape, weights, *moves)
    assert relative_max(twin(pictures, shape, weights, *moves), got) <= tolerance(shape, 2)


def test_a_form_that_does_not_run_is_left_for_the_other(device, monkeypatch):
    shape, weights = (2, 3, 7, 29), view_weights((2, 3))
    moves, pictures = shifts(shape, (-1.4, 0.3)), numbers(2, *shape[2:])
    left = []
    tuning = SimpleNamespace(set_aside=(), leave=lambda form, error: left.append(form))
    monkeypatch.setitem(device.__dict__, "tuning", tuning)
    launch = Launcher.launch

    def failing(self, kernel, *args, **more):
        if kernel.function_name == "spread_blocks":
            raise DeviceError("no")
        launch(self, kernel, *args, **more)

    monkeypatch.setattr(Launcher, "launch", failing)
    got = spread(device, pictures, shape, weights, *moves)
    assert left == (["shear adjoint blocks"] if device.rows else [])
    assert relative_max(twin(pictures, shape, weights, *moves), got) <= tolerance(shape, 2)
