"""Colours of the views of a mosaic, fitted to the pixels of one lenslet (`colour_fit.cl`)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.raw.decode import grid_tables, strides_of
from clplen.lightfield.raw.demosaicing import COLOURS, Frame, positions_of, tile_of
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.settings.reading import BAYER

Values = np.ndarray[Any, np.dtype[np.float64]]

_LANES = 16
_BLOCK = 48  # pixels: side of the blocks from which the noise is estimated
_QUANTILE = 0.1  # quantile of the blocks' medians
_CHI_SQUARE_MEDIAN = 0.4549  # median of the chi-square distribution with one degree of freedom
_MIN_WHITE = 0.3  # of the white level: minimum for pixels in the noise estimate
_MAX_ROWS = 768  # rows of pixels in the noise estimate


def fit_colours(
    picture: cla.Array,
    white: cla.Array,
    grid: LensletGrid,
    bayer: str | Sequence[Sequence[str]],
    *,
    noise: float | Sequence[float],
    floor: float,
    device: Device,
    matrix: Frame | None = None,
) -> cla.Array:
    """Fit each colour of the views by a quadratic to its pixels under the lenslet."""
    mixed = device.upload(np.eye(3, dtype=np.float32) if matrix is None else matrix)
    out = device.empty((*grid.shape, 3), np.float32)
    (V, U), (rows, lenslets), (ny, nx) = grid.views, grid.count, picture.shape
    columns = lenslets if grid.columns is None else grid.columns[0]
    tile = tile_of(bayer)
    tables = grid_tables(grid, device)
    period = (len(tile), len(tile[0]))
    lanes = _LANES if device.rows else 1
    fit, spread = (
        device.kernel("colour_fit.cl", name, LANES=lanes, DOWN=period[0], ACROSS=period[1])
        for name in ("fit_colours", "to_columns")
    )
    edges, sides = _cell(grid, period)
    levels = np.array(np.broadcast_to(noise, 3), np.float32)
    edge_table, tile_table, noises = map(device.upload, (edges, _colour_table(tile), levels))
    stride_v, stride_u, stride_y, stride_x = strides_of(out, grid)
    lenslet_colours = device.empty((U, rows, lenslets, 3), np.float32)
    for v in range(V):
        device.launch_rows(
            fit,
            (rows, U, -(-lenslets // lanes)),
            *(lenslet_colours, picture, white, *tables.rows, *tables.columns, *tables.views(v)),
            *(device.upload(sides[v]), edge_table, tile_table, noises, np.float32(floor)),
            *(np.int32(n) for n in (ny, nx, rows, lenslets)),
        )
        device.launch_rows(
            spread,
            (U, rows, columns),
            *(out, lenslet_colours, *tables.near, mixed),
            *(np.int32(n) for n in (rows, lenslets, columns)),
            *(np.int64(n) for n in (v * stride_v, stride_u, stride_y, stride_x)),
        )
    return out


def _colour_table(tile: Any) -> Any:
    """Return the start of each colour's pixel list and all (y, x), int32, for the kernel."""
    pixel_lists = [positions_of(tile, colour) for colour in COLOURS]
    ends = np.cumsum([2, *(len(pixels) for pixels in pixel_lists)])
    pairs = np.array(list(itertools.chain(*pixel_lists))).ravel()
    return np.concatenate([ends, pairs]).astype(np.int32)


def _cell(grid: LensletGrid, period: tuple[int, int]) -> tuple[Frame, Frame]:
    """Return the sides of a lenslet's cell, and the views' positions between them."""
    column = np.array(grid.column_step)
    row_vector = np.array(grid.row_step) + grid.odd_row_shift * column
    third = row_vector - np.rint(row_vector @ column / (column @ column) + 1e-9) * column
    steps = np.array([column, row_vector, third])
    if grid.odd_row_shift:
        steps[2] = row_vector - np.sign(grid.odd_row_shift) * column
    normals = steps / (steps**2).sum(1)[:, None]
    V, U = grid.views
    v, u = np.arange(V) - (V - 1) / 2, np.arange(U) - (U - 1) / 2
    offset = np.add.outer(v, 0 * u)[..., None] * np.array(grid.row_view_step)
    offset = offset + np.add.outer(0 * v, u)[..., None] * np.array(grid.column_view_step)
    candidates = [offset - i * column - k * row_vector for i in range(-2, 3) for k in range(-2, 3)]
    nearest = np.argmin([(candidate**2).sum(-1) for candidate in candidates], axis=0)
    offset = np.take_along_axis(np.array(candidates), nearest[None, ..., None], 0)[0]
    edges = (normals * (2 * np.array(period))).T
    return np.ascontiguousarray(edges, np.float32), np.asarray(offset @ normals.T, np.float32)


def noise_of(picture: Frame, white: Frame | None, bayer: str | Sequence[Sequence[str]]) -> float:
    """Estimate the variance of a pixel's photon noise over its value.

    Compares the greens above and below a red or blue pixel with those on either side, in the
    plainest tenth of blocks of 48 pixels.
    """
    tile = tile_of(bayer)
    if "".join(itertools.chain(*tile)) not in BAYER:
        return 0.0
    ny = picture.shape[0] // _BLOCK
    medians: list[float] = []
    for row in range(0, ny, max(1, ny * _BLOCK // _MAX_ROWS)):
        lines = slice(row * _BLOCK, (row + 1) * _BLOCK)
        values = picture[lines]
        ratio = _against_photons(values, None if white is None else white[lines], tile)
        width = ratio.shape[1] // _BLOCK * _BLOCK
        blocks = ratio[:, :width].reshape(len(ratio), -1, _BLOCK).swapaxes(0, 1)
        for block in blocks.reshape(len(blocks), -1):
            valid = block[np.isfinite(block)]
            if valid.size >= _BLOCK:
                medians.append(float(np.median(valid)))
    return float(np.quantile(medians, _QUANTILE)) / _CHI_SQUARE_MEDIAN if medians else 0.0


def _against_photons(values: Frame, white: Frame | None, tile: Any) -> Frame:
    """Return the squared difference of the four greens over their sum; NaN if unlit."""
    lit = np.ones_like(values) if white is None else white
    n = values / np.maximum(lit, _MIN_WHITE)
    sides = (np.s_[:-2, 1:-1], np.s_[2:, 1:-1], np.s_[1:-1, :-2], np.s_[1:-1, 2:])
    above, below, left, right = (n[side] for side in sides)
    variance = sum(np.maximum(n[side], 0) / np.maximum(lit[side], _MIN_WHITE) for side in sides)
    valid = np.logical_and.reduce([lit[side] > _MIN_WHITE for side in sides]) & (variance > 0)
    y, x = np.indices(valid.shape)
    greens = np.array([[name == "G" for name in row] for row in tile])
    valid &= ~greens[(y + 1) % 2, (x + 1) % 2]
    square = (above + below - left - right) ** 2
    return np.asarray(np.where(valid, square / np.where(valid, variance, 1), np.nan), np.float32)
