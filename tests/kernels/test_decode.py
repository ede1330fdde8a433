"""decode.cl and upright.cl against a float64 twin: any lattice, exact where pixels are whole."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from reference_lightfield import decode_naive, keys_kernel, spline_kernel

from clplen.errors import DeviceError, ShapeError
from clplen.lightfield.raw.decode import fits_local_memory, is_upright, resample
from clplen.lightfield.raw.lenslet_grid import LensletGrid

# Round-off in units of 2^-24 of the largest pixel. Keys' four weights add up to at most 1.25 in
# magnitude and each is off by at most 4 units; a value is a sum of 4 x 4 products, so at most
# 2 * 16 * 1.25 (weights) + 16 * 1.25^2 (sums); the position is off by at most 2 units and its
# slope is at most 2 * 2.5 per axis.
TOLERANCE = (2 * 16 * 1.25 + 16 * 1.25**2 + 2 * 2 * 2.5) * 2.0**-24
# A row moved by half a column is one more such sum of four, each term with that error.
TOLERANCE_HEXAGONAL = 1.25 * TOLERANCE + (16 + 4) * 1.25**2 * 2.0**-24


def turned(degrees: float, length: float) -> tuple[float, float]:
    """(y, x) of a step along x turned from +x towards +y."""
    angle = np.deg2rad(degrees)
    return length * np.sin(angle), length * np.cos(angle)


def centres(grid: LensletGrid) -> np.ndarray:
    """Positions (rows, columns, 2) of the lenslets' centres."""
    i, k = np.indices(grid.count)[..., None]
    k = k + np.where(i % 2, grid.odd_row_shift, 0)
    first, row, column = map(np.array, (grid.first, grid.row_step, grid.column_step))
    return first + i * row + k * column


def sampled(raw: np.ndarray, grid: LensletGrid, kernel=keys_kernel) -> np.ndarray:
    """L[v, u, i, k] by cubic convolution at the true centres, in float64."""
    V, U = grid.views
    y = centres(grid)[None, None, :, :, 0] + (np.arange(V) - (V - 1) / 2)[:, None, None, None]
    x = centres(grid)[None, None, :, :, 1] + (np.arange(U) - (U - 1) / 2)[None, :, None, None]
    ny, nx = raw.shape
    padded = np.pad(raw, 3)
    out = np.zeros(np.broadcast_shapes(y.shape, x.shape))
    for a in range(-1, 3):
        for b in range(-1, 3):
            py, px = np.floor(y) + a, np.floor(x) + b
            weight = kernel(y - py) * kernel(x - px)
            inside = (
                np.clip(py, -3, ny + 2).astype(int) + 3,
                np.clip(px, -3, nx + 2).astype(int) + 3,
            )
            out += weight * padded[inside]
    return out


def straightened(views: np.ndarray, shift: float) -> np.ndarray:
    """Odd rows, whose samples lie at k + shift, by cubic convolution at k; the ends go on."""
    columns = views.shape[-1]
    out = views.copy()
    k = np.arange(columns)
    low = int(np.floor(-shift))
    odd = np.zeros_like(views[:, :, 1::2])
    for a in range(-1, 3):
        weight = float(keys_kernel(np.array(-shift - low - a)))
        odd += weight * views[:, :, 1::2, np.clip(k + low + a, 0, columns - 1)]
    out[:, :, 1::2] = odd
    return out


def decoded(device, raw: np.ndarray, grid: LensletGrid, **words) -> np.ndarray:
    pixels = device.upload(raw.astype(np.float32))
    return device.download(resample(pixels, grid, device, **words))


def picture(*shape: int) -> np.ndarray:
    return np.random.default_rng(7).random(shape).astype(np.float32)


GRIDS = {
    "square": LensletGrid((11, 13), (6, 5), (9.3, 7.1), (9.41, 0.0), (0.0, 9.87)),
    "turned": LensletGrid((7, 9), (5, 8), (13.2, 9.7), turned(97, 9.37), turned(7, 9.37)),
    "one view": LensletGrid((3, 5), (1, 1), (9.25, 8.0), (10.6, 0.7), (-0.3, 11.0)),
}


@pytest.mark.parametrize("name", GRIDS)
def test_any_lattice(device, name):
    """Weights of B-splines are products of three factors, and add up to 1: fewer roundings."""
    grid, raw = GRIDS[name], picture(97, 131)
    for interpolation, kernel in (("cubic", keys_kernel), ("spline", spline_kernel)):
        got = decoded(device, raw, grid, interpolation=interpolation)
        want = sampled(raw.astype(np.float64), grid, kernel)
        assert got.dtype == np.float32
        assert got.shape == (*grid.views, *grid.count)
        assert np.abs(got - want).max() <= TOLERANCE * raw.max()


@pytest.mark.parametrize(
    ("shift", "interpolation"), [(0.5, "cubic"), (-0.5, "spline"), (0.3, "cubic")]
)
def test_hexagonal_lattice(device, shift, interpolation):
    grid = LensletGrid((7, 11), (5, 4), (9.1, 8.3), (8.1, 0.4), (-0.2, 9.37), shift)
    raw = picture(61, 113)
    got = decoded(device, raw, grid, interpolation=interpolation)
    kernel = spline_kernel if interpolation == "spline" else keys_kernel
    want = straightened(sampled(raw.astype(np.float64), grid, kernel), shift)
    assert np.abs(got - want).max() <= TOLERANCE_HEXAGONAL * raw.max()


@pytest.mark.parametrize(("pixels", "noise"), [(6, 3e-12), (7, 0.0)])
def test_cells_are_a_permutation(device, pixels, noise):
    raw = picture(5 * pixels, 11 * pixels)
    raw[raw < 0.5] = 0  # next to which nothing is too small to be seen
    middle = (pixels - 1) / 2 + noise
    grid = LensletGrid((5, 11), (pixels, pixels), (middle, middle), (pixels, 0), (0, pixels))
    got = decoded(device, raw, grid)
    np.testing.assert_array_equal(got, decode_naive(raw, pixels))


def test_off_the_sensor_is_zero(device):
    raw = np.full((5, 7), 2.0)
    grid = LensletGrid((1, 4), (1, 1), (2.0, -5.0), (1.0, 0.0), (0.0, 4.5))
    got = decoded(device, raw, grid)[0, 0, 0]
    # at x = -5, -0.5, 4 and 8.5 of 7 pixels: none, half of the weights, all, none
    np.testing.assert_allclose(got, [0, 1, 2, 0], atol=TOLERANCE * 2)


def test_raw_with_nan_is_refused(device):
    raw = picture(20, 20)
    raw[3, 4] = np.nan
    raw[5, 6] = np.inf
    grid = GRIDS["one view"]
    with pytest.raises(ValueError, match="raw image has 2 pixels that are NaN or infinite"):
        decoded(device, raw, grid)


def test_wrong_grids_are_refused(device):
    for change, message in (
        ({"count": (0, 3)}, "at least one lenslet and one view"),
        ({"views": (2, 0)}, "at least one lenslet and one view"),
        ({"first": (np.nan, 0.0)}, "numbers of a lenslet grid must be finite"),
    ):
        grid = replace(GRIDS["square"], **change)
        with pytest.raises((ShapeError, ValueError), match=message):
            decoded(device, picture(20, 20), grid)


def test_too_large_is_refused_before_anything_is_made(device, monkeypatch):
    grid = GRIDS["square"]
    raw = picture(20, 20)
    needed = 4 * 6 * 5 * 11 * 13
    monkeypatch.setattr(device, "memory_bytes", needed - 1)
    with pytest.raises(DeviceError, match=f"This light field needs {needed:,} bytes"):
        decoded(device, raw, grid)


UPRIGHT = {
    "fractions": GRIDS["square"],
    "steps of views": replace(
        GRIDS["square"], row_view_step=(0.83, 0.0), column_view_step=(0.0, 1.21)
    ),
    "exchanged": replace(GRIDS["square"], exchanged=True),
    "past all edges": LensletGrid((5, 7), (6, 5), (-1.4, -3.3), (9.41, 0.0), (0.0, 6.87)),
    "off the sensor": LensletGrid((3, 2), (3, 4), (-40.0, 90.0), (20.5, 0.0), (0.0, 30.25)),
}


@pytest.mark.parametrize(
    ("name", "interpolation"),
    list(zip(UPRIGHT, ("cubic", "linear", "spline", "cubic", "linear"), strict=True)),
)
def test_both_ways_of_an_upright_lattice_agree(device, name, interpolation, monkeypatch):
    grid = UPRIGHT[name]
    assert is_upright(grid)
    raw = picture(47, 53)
    quick = decoded(device, raw, grid, interpolation=interpolation)
    monkeypatch.setattr("clplen.lightfield.raw.decode.is_upright", lambda _: False)
    general = decoded(device, raw, grid, interpolation=interpolation)
    assert quick.shape == general.shape == grid.shape
    assert np.abs(quick - general).max() <= 2 * TOLERANCE
    assert name == "off the sensor" or quick.any()


def test_a_row_that_local_memory_does_not_hold_is_decoded_all_the_same(device, monkeypatch):
    grid = UPRIGHT["fractions"]
    raw = picture(47, 53)
    room = SimpleNamespace(cl_device=SimpleNamespace(local_mem_size=4 * 61))
    assert fits_local_memory(53, room)
    assert not fits_local_memory(54, room)
    quick = decoded(device, raw, grid)
    monkeypatch.setattr("clplen.lightfield.raw.decode.fits_local_memory", lambda *_: False)
    assert np.abs(quick - decoded(device, raw, grid)).max() <= 2 * TOLERANCE


def test_other_lattices_are_not_upright(device):
    for change in (
        {"odd_row_shift": 0.5},
        {"columns": (5, 0.9)},
        {"row_step": (9.4, 0.1)},
        {"column_step": (0.1, 9.8)},
        {"row_view_step": (1.0, 0.1)},
        {"column_view_step": (0.1, 1.0)},
    ):
        assert not is_upright(replace(GRIDS["square"], **change))
