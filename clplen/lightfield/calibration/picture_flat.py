"""White image estimated from one picture: vignetting of a sub-image, by medians."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.lightfield.calibration.sensor_frames import Mosaic, saturated_pixels, subtract_dark
from clplen.lightfield.raw.demosaicing import tile_of
from clplen.lightfield.raw.lenslet_lattice import Lattice

Frame = np.ndarray[Any, np.dtype[np.float32]]
Values = np.ndarray[Any, np.dtype[np.float64]]

_MAX_LENSLETS = 6000  # maximum number from which medians are computed
_MIN_LENSLETS = 300  # minimum number of lit lenslets
_CENTRE_RADIUS = 0.22  # of the pitch: radius of the area whose mean is scaled to 1
_MIN_BRIGHTNESS = 0.1  # of the 99th percentile of these means: darker sub-images are excluded
_MAX_SPREAD = 0.5  # maximum relative standard deviation of the central area
_CELL = 0.5  # pixels: side of a cell of the table
_MIN_CELL_PIXELS = 20  # minimum number of pixels of a cell; others are interpolated
_CELL_PARTS = 4  # subdivisions of a cell in the lookup table
_SEED = 1  # seed of the random choice of lenslets


def flat_of_picture(
    raw: Frame, lattice: Lattice, *, dark: Frame | None = None, bayer: Mosaic | None = None
) -> Frame | None:
    """Estimate a flat frame (each pixel in even light, up to a factor) from one picture.

    Each pixel is divided by the mean round its centre. The flat is the median over all lit
    sub-images by position from the centre. The fall over the sensor cannot be measured.
    """
    shape = (int(raw.shape[0]), int(raw.shape[1]))
    picture = np.asarray(subtract_dark(raw, dark), np.float32)
    tile = np.array([["G"]] if bayer is None else tile_of(bayer))
    kind = np.unique(tile, return_inverse=True)[1].reshape(tile.shape)
    reach = math.ceil(0.6 * lattice.neighbour)
    centres = _inner(lattice.centres(), shape, reach)
    random = np.random.default_rng(_SEED)
    if len(centres) > _MAX_LENSLETS:
        centres = centres[random.choice(len(centres), _MAX_LENSLETS, replace=False)]
    if len(centres) < _MIN_LENSLETS:
        return None
    y, x = _windows(centres, reach)
    patch, colour = picture[y, x], kind[y % tile.shape[0], x % tile.shape[1]]
    offsets = np.stack([y - centres[:, 0, None, None], x - centres[:, 1, None, None]])
    inner = np.hypot(*offsets) < _CENTRE_RADIUS * lattice.neighbour
    full = saturated_pixels(raw)[y, x].any(axis=(1, 2))
    ratios, positions = [], []
    for k in range(kind.max() + 1):
        valid = inner & (colour == k)
        count = np.maximum(valid.sum(axis=(1, 2)), 1)
        mean = np.where(valid, patch, 0).sum(axis=(1, 2), dtype=np.float64) / count
        spread = np.sqrt(
            np.where(valid, (patch - mean[:, None, None]) ** 2, 0).sum(axis=(1, 2)) / count
        )
        lit = (
            (mean > _MIN_BRIGHTNESS * np.percentile(mean, 99))
            & (spread < _MAX_SPREAD * mean)
            & ~full
        )
        lit &= valid.any(axis=(1, 2))
        if lit.sum() < _MIN_LENSLETS:
            return None
        selected = (colour == k) & lit[:, None, None]
        ratios.append((patch / np.where(lit, mean, 1)[:, None, None])[selected])
        positions.append(offsets[:, selected])
    table = _medians(np.concatenate(ratios), np.concatenate(positions, axis=1), reach)
    level = float(np.percentile(picture, 99))
    flat = _spread(table, lattice, shape, reach) * np.float32(level)
    return flat if dark is None else np.asarray(flat + dark, np.float32)


def _inner(centres: Values, shape: tuple[int, int], reach: int) -> Values:
    """Return the lenslets whose window lies on the sensor."""
    inside = (centres >= reach + 1) & (centres <= np.array(shape) - reach - 2)
    return centres[inside.all(axis=1)]


def _windows(centres: Values, reach: int) -> tuple[Any, Any]:
    """Return rows and columns of the pixels about each centre, (n, 2 reach + 1, 2 reach + 1)."""
    window = np.arange(-reach, reach + 1)
    row, column = np.rint(centres).astype(np.intp).T
    y, x = row[:, None, None] + window[:, None], column[:, None, None] + window
    rows, columns = np.broadcast_arrays(y, x)
    return rows, columns


def _medians(ratios: Values, positions: Values, reach: int) -> Frame:
    """Return the median ratio in cells of half a pixel, shape (n, n), centred."""
    half = round((reach + 1) / _CELL)
    side = 2 * half + 1
    row, column = np.rint(positions / _CELL).astype(np.intp) + half
    cell = row * side + column
    order = np.lexsort((ratios, cell))
    counts = np.bincount(cell, minlength=side * side)
    starts = np.concatenate(([0], np.cumsum(counts)[:-1]))
    middle = np.minimum(starts + counts // 2, len(ratios) - 1)
    table = np.where(counts >= _MIN_CELL_PIXELS, ratios[order][middle], np.nan).reshape(side, side)
    return _filled(np.clip(table, 0, None))


def _filled(table: Values) -> Frame:
    """Fill empty cells with the mean of their neighbours, from the middle outwards."""
    while np.isnan(table).any() and not np.isnan(table).all():
        wide = np.pad(table, 1, constant_values=np.nan)
        parts = [
            wide[1 + i : len(wide) - 1 + i, 1 + j : len(wide) - 1 + j]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        valid = [~np.isnan(part) for part in parts]
        count = np.sum(valid, axis=0)
        total = np.sum([np.where(k, part, 0) for k, part in zip(valid, parts, strict=True)], axis=0)
        mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        table = np.where(np.isnan(table), mean, table)
    return table.astype(np.float32)


def _spread(table: Frame, lattice: Lattice, shape: tuple[int, int], reach: int) -> Frame:
    """Look up the table about the nearest centre of every pixel; 0 far from any centre."""
    from scipy.ndimage import map_coordinates

    centres = lattice.centres()
    inside_sensor = ((centres >= 0) & (centres <= np.array(shape) - 1)).all(axis=1)
    inside = np.rint(centres[inside_sensor]).astype(np.intp)
    left_y, left_x = (centres[inside_sensor] - inside).astype(np.float32).T
    margin = reach + 1  # lets windows cross the border
    width = shape[1] + 2 * margin
    first = (inside[:, 0] + margin) * width + inside[:, 1] + margin
    out = np.zeros((shape[0] + 2 * margin) * width, np.float32)
    nearest = np.full(out.shape, np.inf, np.float32)
    half = len(table) // 2
    fine = np.arange(-half * _CELL_PARTS, half * _CELL_PARTS + 1) / _CELL_PARTS + half
    lookup = map_coordinates(table, np.meshgrid(fine, fine, indexing="ij"), order=1)
    middle, scale = half * _CELL_PARTS, np.float32(_CELL_PARTS / _CELL)
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            if math.hypot(i, j) > reach + 1:
                continue
            dy, dx = np.float32(i) - left_y, np.float32(j) - left_x
            distance = dy * dy + dx * dx
            index = first + (i * width + j)
            closer = distance < nearest[index]
            index, dy, dx = index[closer], dy[closer], dx[closer]
            nearest[index] = distance[closer]
            row, column = (np.rint(d * scale).astype(np.intp) + middle for d in (dy, dx))
            out[index] = lookup[row, column]
    return out.reshape(-1, width)[margin:-margin, margin:-margin].copy()
