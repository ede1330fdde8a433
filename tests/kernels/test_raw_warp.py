"""warp.cl over lenslets against a float64 twin: raw images of a picture, and their gradients."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from tolerance import relative_max

from clplen import LightField, RawImage
from clplen.lightfield import Lattice, LensletGrid, RawWarp, ViewWarp
from clplen.lightfield.refocusing import raw_warp

STEP = 1e-7  # of central differences
SHAPE = (46, 59)
TURN = np.array([[np.cos(0.07), np.sin(0.07)], [-np.sin(0.07), np.cos(0.07)]])


def turned(*steps):
    return [tuple(float(n) for n in TURN @ step) for step in steps]


def lattice(kind, row, column):
    return Lattice(kind, (22.3, 28.9), *turned(row, column), shape=SHAPE)


HEXAGONAL = lattice("hexagonal", (6.1, 0), (0, 7.1))
GRIDS = {
    "square": lattice("square", (6.3, 0), (0, 7.1)).grid((6, 7), complete=False),
    "hexagonal": HEXAGONAL.grid((7, 7), complete=False),
    "hexagonal along y": lattice("hexagonal", (7.1, 0), (0, 6.1)).grid(
        (7, 7), complete=False, square=True
    ),
    "skew": LensletGrid((5, 7), (4, 6), (13.217, 9.703), (9.3, -1.1), (1.2, 7.4), 0.5),
}


@pytest.fixture(params=GRIDS, ids=lambda name: name.replace(" ", "-"))
def grid(request):
    return GRIDS[request.param]


def raw_of(grid, device, shape=SHAPE):
    """A raw image with views twice as far apart along y, in pixels of the light field."""
    data = device.zeros(shape, np.float32)
    return RawImage(data, device, 1e-6, grid, grid, spacing=(-2e-4, -1e-4, 2e-6, 2e-6))


def samples(grid, seed=3):
    """(picture, disparity, white image, gradient of the raw image)."""
    rng, shape = np.random.default_rng(seed), grid.shape[2:]
    given = rng.normal(size=shape), rng.uniform(-1.3, 0.9, shape), rng.uniform(0.2, 1.7, SHAPE)
    return [np.float32(values) for values in (*given, rng.normal(size=SHAPE))]


def sampled(picture, y, x):
    """Linear interpolation, positions off the picture being those of its edge."""
    ny, nx = picture.shape
    y, x = np.clip(y, 0, ny - 1), np.clip(x, 0, nx - 1)
    i, k = np.floor(y).astype(int), np.floor(x).astype(int)
    b, a = y - i, x - k
    below, beside = np.minimum(i + 1, ny - 1), np.minimum(k + 1, nx - 1)
    upper = (1 - a) * picture[i, k] + a * picture[i, beside]
    return (1 - b) * upper + b * ((1 - a) * picture[below, k] + a * picture[below, beside])


@lru_cache
def rays(grid):
    """Of every raw pixel (y, x) of its lenslet on the picture and viewpoint (v, u), NaN without.

    The lenslet is looked for among all centres of a lattice that goes on beyond the grid.
    """
    rows, columns = (np.arange(-3, n + 3) for n in grid.count)
    i, k = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    along = k + grid.odd_row_shift * (i % 2)
    centres = np.add(grid.first, np.outer(i, grid.row_step) + np.outer(along, grid.column_step))
    pixels = np.stack(np.mgrid[: SHAPE[0], : SHAPE[1]], axis=-1).reshape(-1, 2)
    own = ((pixels[:, None] - centres) ** 2).sum(axis=-1).argmin(axis=1)
    steps = np.array([grid.row_view_step, grid.column_view_step]).T
    views = np.linalg.solve(steps, (pixels - centres[own]).T)
    there = np.array([i[own], along[own] / (1 if grid.columns is None else grid.columns[1])])
    inside = (i[own] >= 0) & (i[own] < grid.count[0]) & (k[own] >= 0) & (k[own] < grid.count[1])
    found = np.where(inside, np.concatenate((there, views)), np.nan)
    return found[[1, 0, 3, 2]] if grid.exchanged else found


def twin(picture, disparity, white, grid, ratio=2.0):
    """The raw image, float64."""
    y, x, v, u = rays(grid)
    out, on = np.zeros(y.size), np.isfinite(y)
    y, x, v, u = (a[on] for a in (y, x, v, u))
    d = sampled(disparity, y, x)
    out[on] = sampled(picture, y + ratio * v * d, x + u * d)
    return out.reshape(SHAPE) * white


def test_raw_images(device, grid):
    picture, d, white, _ = samples(grid)
    model = RawWarp(raw_of(grid, device), white=white)
    got = model.forward(picture, d)
    want = twin(*(a.astype(float) for a in (picture, d, white)), grid)
    assert got.sub_images == grid
    assert relative_max(want, got.to_numpy()) <= (9 + 2 * 9 + 8) * 2.0**-24
    np.testing.assert_array_equal(model.used, np.isfinite(rays(grid)[0]).reshape(SHAPE))


def test_gradient_of_the_picture_is_the_transpose(device, grid, monkeypatch):
    monkeypatch.setattr(raw_warp, "_BAND", 3)
    picture, d, white, g = samples(grid)
    got = RawWarp(raw_of(grid, device), white=white).vjp(picture, d, g)[0]
    want = np.zeros(picture.size)
    for k, one in enumerate(np.eye(picture.size)):
        raw = twin(one.reshape(picture.shape), d.astype(float), white.astype(float), grid)
        want[k] = np.vdot(raw, g.astype(float))
    assert relative_max(want.reshape(got.shape), got.astype(float)) <= 1e-6


def test_gradient_of_the_disparity(device, grid):
    """Central differences in double precision, a disparity at a time."""
    picture, d, white, g = samples(grid)
    got = RawWarp(raw_of(grid, device), white=white).vjp(picture, d, g)[1]
    picture, d, white, g = (a.astype(float) for a in (picture, d, white, g))
    want = np.zeros(d.size)
    for k, one in enumerate(np.eye(d.size)):
        moved = [d + sign * STEP * one.reshape(d.shape) for sign in (1, -1)]
        ahead, behind = (twin(picture, there, white, grid) for there in moved)
        want[k] = np.vdot(ahead - behind, g) / (2 * STEP)
    assert relative_max(want.reshape(got.shape), got.astype(float)) <= 1e-6


def test_whole_lattices_have_the_samples_of_view_warp(device):
    """Bit by bit, gradients too."""
    count, (V, U) = (9, 11), (4, 7)
    pitch = V, U
    steps = (float(V), 0.0), (0.0, float(U))
    grid = LensletGrid(count, pitch, ((V - 1) / 2, (U - 1) / 2), *steps)
    shape = (count[0] * V, count[1] * U)
    raw = raw_of(grid, device, shape)
    views = LightField.from_array(np.zeros((*pitch, *count)), device=device, spacing=raw.spacing)
    rng = np.random.default_rng(2)
    picture, d, g = rng.normal(size=count), rng.uniform(-1.3, 1.9, count), rng.normal(size=shape)
    model, other = RawWarp(raw), ViewWarp(views)
    own = model.forward(picture, d).to_numpy().reshape(count[0], V, count[1], U)
    np.testing.assert_array_equal(own.transpose(1, 3, 0, 2), other.forward(picture, d).to_numpy())
    slices = g.reshape(count[0], V, count[1], U).transpose(1, 3, 0, 2)
    for mine, its in zip(model.vjp(picture, d, g), other.vjp(picture, d, slices), strict=True):
        np.testing.assert_array_equal(mine, its)
    assert model.used.all()


def test_pixels_halfway_go_to_the_later_lenslet(device):
    """Also where an even number of pixels lies about a whole one."""
    grid = LensletGrid((3, 4), (4, 4), (2.0, 2.0), (4.0, 0.0), (0.0, 4.0))
    raw = raw_of(grid, device, (13, 17))
    picture = np.arange(12.0).reshape(3, 4)
    got = RawWarp(raw).forward(picture, np.zeros((3, 4))).to_numpy()
    np.testing.assert_array_equal(got[:12, :16], np.kron(picture, np.ones((4, 4))))
    assert not got[12].any()
    assert not got[:, 16].any()
