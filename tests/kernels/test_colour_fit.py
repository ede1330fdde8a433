"""colour_fit.cl against float64 twins."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from reference_lightfield import keys_kernel

from clplen.lightfield import LensletGrid
from clplen.lightfield.raw.colour_fit import fit_colours, noise_of

PULL = ((0.0016, 0.39), (0.0003, 0.046))  # of slopes and of curvatures
HEXAGONAL = LensletGrid(
    (4, 5), (5, 4), (11.3, 9.8), (8.1, 0.3), (-0.4, 9.3), 0.5, (1.7, 0.1), (-0.1, 2.2), (5, 0.9)
)
SQUARE = LensletGrid((3, 4), (3, 5), (9.3, 10.4), (10.2, -0.3), (0.4, 11.1))
UPRIGHT = LensletGrid((3, 5), (3, 3), (4.0, 5.5), (8.0, 0.0), (0.0, 8.0))  # to the sensor's edge


def neighbours(grid: LensletGrid) -> list[np.ndarray]:
    """Steps to the nearest lenslets, of either side one."""
    column, row = np.array(grid.column_step), np.array(grid.row_step)
    if not grid.odd_row_shift:
        return [column, row]
    return [column, row + column / 2, row - column / 2]


def fitted(frame, white, at, offset, grid, tile, colour, noise, floor):
    """One colour at the place ``at``, ``offset`` from the middle of its lenslet."""
    period = np.array([len(tile), len(tile[0])])
    low = np.maximum(np.floor(at - 2 * period).astype(int), 0)
    box = tuple(slice(a, int(b)) for a, b in zip(low, np.ceil(at + 2 * period) + 1, strict=True))
    pixel = np.stack(np.mgrid[: frame.shape[0], : frame.shape[1]], axis=-1)[box]
    t = (pixel - at) / (2 * period)
    k = np.maximum(1 - (t**2).sum(-1), 0) ** 4
    for e in neighbours(grid):
        k = k * (np.abs((offset + pixel - at) @ e) <= 0.5 * (e @ e))
    letters = np.array([list(row) for row in tile])
    k = k * (letters[pixel[..., 0] % period[0], pixel[..., 1] % period[1]] == colour)
    inside = k > 0
    if not inside.any():
        return 0.0
    y, x = np.moveaxis(t[inside], -1, 0)
    phi = np.stack([np.ones_like(y), y, x, y * y, x * x, y * x], axis=-1)
    level = np.maximum(white[box][inside].astype(np.float64), floor)
    n, w, k_sum = frame[box][inside] / level, k[inside] * level, k.sum()
    total = w.sum()
    mean = (w * n).sum() / total
    variance = (w * (n - mean) ** 2).sum() / total
    random = noise * max(mean, 0) * k_sum / total
    doubt = random / (k_sum * max(variance - 1.5 * random, 1e-3 * random + 1e-30))
    g, q = (a + b * doubt for a, b in PULL)
    pull = np.diag([0, g, g, q, q, q]) * total
    return np.linalg.solve((phi.T * w) @ phi + pull, (phi.T * w) @ n)[0]


def twin(frame, white, grid, tile, noise, floor):
    (V, U), (rows, lenslets) = grid.views, grid.count
    out = np.zeros((V, U, rows, lenslets, 3))
    down, right = np.array(grid.row_view_step), np.array(grid.column_view_step)
    for v, u, i, k in np.ndindex(V, U, rows, lenslets):
        offset = (v - (V - 1) / 2) * down + (u - (U - 1) / 2) * right
        column = k + (grid.odd_row_shift if i % 2 else 0)
        middle = np.array(grid.first) + i * np.array(grid.row_step)
        at = middle + column * np.array(grid.column_step) + offset
        a, b = np.array(grid.column_step), np.array(grid.row_step)
        b = b + grid.odd_row_shift * a
        near = [offset - m * a - n * b for m, n in itertools.product(range(-2, 3), repeat=2)]
        inner = min(near, key=lambda place: float(place @ place))
        for c, colour in enumerate("RGB"):
            out[v, u, i, k, c] = fitted(
                frame, white, at, inner, grid, tile, colour, noise[c], floor
            )
    if grid.columns is None:
        return out
    n, step = grid.columns
    wide = np.zeros((V, U, rows, n, 3))
    for i in range(rows):
        at = np.arange(n) * step - (grid.odd_row_shift if i % 2 else 0)
        for a in range(-1, 3):
            p = np.floor(at).astype(int) + a
            part = out[:, :, i, np.clip(p, 0, lenslets - 1)]
            wide[:, :, i] += keys_kernel(at - p)[:, None] * part
    return wide


@pytest.mark.parametrize(
    ("grid", "tile", "noise"),
    [
        (HEXAGONAL, ("GR", "BG"), (0.004, 0.001, 0.02)),
        (SQUARE, ("RG", "GB"), (0.0, 0.0, 0.0)),
        (UPRIGHT, ("BG", "GR"), (0.004, 0.001, 0.02)),
        (SQUARE, ("RGB", "GBG", "BRG"), (0.004, 0.001, 0.02)),
    ],
)
def test_colours_are_fitted_within_lenslets(device, grid, tile, noise):
    random = np.random.default_rng(5)
    shape = (47, 59) if grid is HEXAGONAL else (37, 55) if grid is SQUARE else (25, 41)
    y, x = np.indices(shape)
    frame = 1 + 0.3 * np.sin(0.5 * y + 0.3 * x) + 0.1 * random.random(shape)
    white = random.uniform(0.02, 1, shape)
    frame, white = frame.astype(np.float32), white.astype(np.float32)
    got = fit_colours(
        *(device.upload(a) for a in (frame, white)), grid, tile, noise=noise, floor=0.1,
        device=device,
    )  # fmt: skip
    want = twin(frame, white, grid, tile, noise, float(np.float32(0.1)))
    assert got.shape == want.shape
    assert want.std() > 0.2
    # 64 sums of float32 in normal equations whose smallest eigenvalue is about 3e-4 of the largest
    error = np.abs(device.download(got) - want)
    assert error.max() <= 64 * 2**-24 / 3e-4 * np.abs(want).max() * 0.2
    assert np.sqrt((error**2).mean()) <= 2e-5


def test_rows_and_columns_are_exchanged(device):
    random = np.random.default_rng(6)
    frame = random.uniform(0.5, 1, (47, 59)).astype(np.float32)
    parts = []
    for exchanged in (False, True):
        grid = LensletGrid(**{**HEXAGONAL.__dict__, "exchanged": exchanged})
        data = device.upload(frame)
        got = fit_colours(data, data, grid, "GRBG", noise=0.0, floor=0.1, device=device)
        parts.append(device.download(got))
    assert parts[0].shape == (5, 4, 4, 5, 3)
    np.testing.assert_array_equal(parts[1], parts[0].transpose(1, 0, 3, 2, 4))


def test_noise_of_photons_is_told(device):
    gain = 7.0
    random = np.random.default_rng(7)
    y, x = np.indices((301, 403))
    white = 0.2 + 0.8 * np.cos(y / 5) ** 2 * np.cos(x / 7) ** 2
    light = 300 * (1.5 + np.sin(y / 60)) * white
    frame = random.poisson(light / gain) * gain
    frame[:, 200:] *= 1 + 0.5 * np.sin(2 * y + x)[:, 200:]  # half of the picture is no plain one
    told = noise_of(frame.astype(np.float32), white.astype(np.float32), "GRBG")
    assert told == pytest.approx(gain, rel=0.3)
    assert noise_of(frame.astype(np.float32), None, ("RGB", "GBR", "BRG")) == 0


def test_a_frame_without_lit_pixels_tells_no_noise(device):
    frame = np.zeros((60, 70), np.float32)
    assert noise_of(frame, frame, "RGGB") == 0
