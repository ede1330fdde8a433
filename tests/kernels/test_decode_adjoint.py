"""decode_adjoint.cl against a float64 twin, and as the transpose of decode.cl and upright.cl."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_lightfield import keys_kernel, spline_kernel

from clplen.lightfield.raw import decode_adjoint
from clplen.lightfield.raw.decode import is_upright, resample
from clplen.lightfield.raw.decode_adjoint import resample_adjoint
from clplen.lightfield.raw.lenslet_grid import LensletGrid

SIZE = (47, 53)


def turned(degrees: float, length: float) -> tuple[float, float]:
    """(y, x) of a step along x turned from +x towards +y."""
    angle = np.deg2rad(degrees)
    return length * np.sin(angle), length * np.cos(angle)


SQUARE = LensletGrid((4, 5), (6, 5), (9.3, 7.1), (9.41, 0.0), (0.0, 9.87))
HEXAGONAL = LensletGrid((5, 4), (5, 4), (6.3, 7.1), (8.1, 0.3), (-0.2, 9.37), 0.5)
GRIDS = {
    "square": SQUARE,
    "exchanged": replace(SQUARE, exchanged=True),
    "past all edges": LensletGrid((5, 7), (6, 5), (-1.4, -3.3), (9.41, 0.0), (0.0, 6.87)),
    "whole pixels": LensletGrid((5, 7), (5, 5), (6.0, 5.0), (7.0, 0.0), (0.0, 7.0)),
    "turned": LensletGrid((4, 5), (5, 7), (9.2, 1.7), turned(97, 9.37), turned(7, 9.37)),
    "steps of views": LensletGrid(
        (4, 5), (5, 6), (9.2, 9.7), turned(93, 9.37), turned(3, 9.37), 0.0, turned(93, 1.7),
        turned(3, 1.3),
    ),
    "sub-images that overlap": LensletGrid(
        (4, 5), (9, 11), (9.2, 9.7), turned(93, 6.37), turned(3, 6.37)
    ),
    "hexagonal": HEXAGONAL,
    "columns of its own": replace(HEXAGONAL, columns=(5, 0.866), exchanged=True),
    "one row, one view": LensletGrid(
        (1, 5), (3, 1), (23.0, 9.0), (0.0, 0.0), (0.3, 9.0), 0.0, (1.0, 0.1), (0.0, 0.0)
    ),
}  # fmt: skip


def triangle(t):
    return np.maximum(1 - np.abs(t), 0)


def places(grid: LensletGrid) -> np.ndarray:
    """(y, x) of every sample of the lenslets, shape (2, V, U, rows, lenslets)."""
    V, U = grid.views
    v, u, i, k = np.indices((*grid.views, *grid.count)).astype(float)
    k += np.where(i % 2, grid.odd_row_shift, 0)
    steps = (grid.row_view_step, grid.column_view_step, grid.row_step, grid.column_step)
    counts = (v - (V - 1) / 2, u - (U - 1) / 2, i, k)
    moved = sum(np.multiply.outer(step, n) for step, n in zip(steps, counts, strict=True))
    return moved + np.reshape(grid.first, (2, 1, 1, 1, 1))


KERNELS = {"cubic": keys_kernel, "linear": triangle, "spline": spline_kernel}


def of_lenslets(views: np.ndarray, grid: LensletGrid, h) -> np.ndarray:
    """The transpose of the interpolation along the rows of lenslets."""
    count, step = (grid.count[1], 1.0) if grid.columns is None else grid.columns
    out = np.zeros((*grid.views, *grid.count))
    for i, k in np.ndindex(grid.count[0], count):
        place = k * step - (grid.odd_row_shift if i % 2 else 0)
        for m in range(int(np.floor(place)) - 1, int(np.floor(place)) + 3):
            out[:, :, i, np.clip(m, 0, grid.count[1] - 1)] += h(place - m) * views[:, :, i, k]
    return out


def twin(views: np.ndarray, grid: LensletGrid, interpolation: str) -> np.ndarray:
    """Every sample spread to its sixteen pixels."""
    h = KERNELS[interpolation]
    if grid.exchanged:
        views = views.transpose(1, 0, 3, 2)
    along = triangle if interpolation == "linear" else keys_kernel
    samples = of_lenslets(views.astype(np.float64), grid, along)
    raw = np.zeros(SIZE)
    y, x = places(grid)
    for a in range(-1, 3):
        for b in range(-1, 3):
            py, px = np.floor(y).astype(int) + a, np.floor(x).astype(int) + b
            inside = (py >= 0) & (py < SIZE[0]) & (px >= 0) & (px < SIZE[1])
            share = h(y - py) * h(x - px) * samples
            np.add.at(raw, (py[inside], px[inside]), share[inside])
    return raw


def numbers(shape, seed=7):
    return np.random.default_rng(seed).random(shape).astype(np.float32)


@pytest.mark.parametrize(
    ("name", "interpolation"),
    list(zip(GRIDS, 3 * ("cubic", "linear", "spline") + ("cubic",), strict=True)),
)
def test_values(device, name, interpolation):
    """Round-off in units of 2^-24, as of decoding: of sums of sixteen products of weights (4 units
    each, 1.25^2 in all), for every sub-image that holds the pixel."""
    grid = GRIDS[name]
    views = numbers(grid.shape)
    got = resample_adjoint(
        device.upload(views), SIZE, grid, device=device, interpolation=interpolation
    )
    want = twin(views, grid, interpolation)
    assert np.count_nonzero(want) > 30
    unit = 2.0**-24 * max(np.abs(want).max(), 1)
    assert np.abs(device.download(got) - want).max() <= 4 * (32 * 1.25 + 16 * 1.25**2 + 10) * unit


@pytest.mark.parametrize("name", GRIDS)
def test_inner_products(device, name, monkeypatch):
    monkeypatch.setattr(decode_adjoint, "_BAND", 7)  # rows of an item, fewer than of a sub-image
    grid, x = GRIDS[name], numbers(SIZE)
    seen = device.download(resample(device.upload(x), grid, device))
    y = seen + numbers(seen.shape, 8)
    back = device.download(resample_adjoint(device.upload(y), SIZE, grid, device=device))
    want = np.vdot(seen.astype(np.float64), y)
    assert abs(want - np.vdot(x.astype(np.float64), back)) <= 1e-6 * abs(want)


def test_both_ways_of_an_upright_lattice_agree(device, monkeypatch):
    views = device.upload(numbers(SQUARE.shape))
    assert is_upright(SQUARE)
    separable = device.download(resample_adjoint(views, SIZE, SQUARE, device=device))
    monkeypatch.setattr("clplen.lightfield.raw.decode_adjoint.is_upright", lambda _: False)
    general = device.download(resample_adjoint(views, SIZE, SQUARE, device=device))
    np.testing.assert_allclose(separable, general, atol=1e-5)
