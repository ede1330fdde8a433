"""The white image of a camera from one of its pictures: vignetting of a sub-image, by medians."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.lightfield.calibration.sensor_frames import Mosaic, saturated_pixels, subtract_dark
from clplen.lightfield.raw.demosaicing import tile_of
from clplen.lightfield.raw.lenslet_lattice import Lattice

Frame = np.ndarray[Any, np.dtype[np.float32]]
Values = np.ndarray[Any, np.dtype[np.float64]]

_LENSLETS = 6000  # at most, from which medians are taken,
_LEAST = 300  # and at least
_MIDDLE = 0.22  # of the pitch: pixels round the centre whose mean is 1
_LIT = 0.1  # of the 99th percentile of these means: darker sub-images are left out,
_NOISY = 0.5  # as those whose middle varies by more than this part
_CELL = 0.5  # pixels: side of a cell of the table
_FEW = 20  # pixels of a cell: with fewer it takes the value of its neighbours
_FINE = 4  # parts of a cell that are looked up
_SEED = 1


def flat_of_picture(
    raw: Frame, lattice: Lattice, *, dark: Frame | None = None, bayer: Mosaic | None = None
) -> Frame | None:
    """What each pixel would be in even light, as one picture tells, up to a factor.

    It is the median over all lit sub-images, by the place from the centre, of each pixel over the
    mean round the centre. Fall of light over the sensor is not known from one picture and stays.
    """
    shape = (int(raw.shape[0]), int(raw.shape[1]))
    picture = np.asarray(subtract_dark(raw, dark), np.float32)
    tile = np.array([["G"]] if bayer is None else tile_of(bayer))
    kind = np.unique(tile, return_inverse=True)[1].reshape(tile.shape)
    reach = math.ceil(0.6 * lattice.neighbour)
    centres = _inner(lattice.centres(), shape, reach)
    random = np.random.default_rng(_SEED)
    if len(centres) > _LENSLETS:
        centres = centres[random.choice(len(centres), _LENSLETS, replace=False)]
    if len(centres) < _LEAST:
        return None
    y, x = _windows(centres, reach)
    patch, colour = picture[y, x], kind[y % tile.shape[0], x % tile.shape[1]]
    off = np.stack([y - centres[:, 0, None, None], x - centres[:, 1, None, None]])
    inner = np.hypot(*off) < _MIDDLE * lattice.neighbour
    full = saturated_pixels(raw)[y, x].any(axis=(1, 2))
    ratios, places = [], []
    for k in range(kind.max() + 1):
        here = inner & (colour == k)
        count = np.maximum(here.sum(axis=(1, 2)), 1)
        mean = np.where(here, patch, 0).sum(axis=(1, 2), dtype=np.float64) / count
        spread = np.sqrt(
            np.where(here, (patch - mean[:, None, None]) ** 2, 0).sum(axis=(1, 2)) / count
        )
        lit = (mean > _LIT * np.percentile(mean, 99)) & (spread < _NOISY * mean) & ~full
        lit &= here.any(axis=(1, 2))
        if lit.sum() < _LEAST:
            return None
        of_colour = (colour == k) & lit[:, None, None]
        ratios.append((patch / np.where(lit, mean, 1)[:, None, None])[of_colour])
        places.append(off[:, of_colour])
    table = _medians(np.concatenate(ratios), np.concatenate(places, axis=1), reach)
    level = float(np.percentile(picture, 99))
    flat = _spread(table, lattice, shape, reach) * np.float32(level)
    return flat if dark is None else np.asarray(flat + dark, np.float32)


def _inner(centres: Values, shape: tuple[int, int], reach: int) -> Values:
    """Lenslets whose window lies on the sensor."""
    inside = (centres >= reach + 1) & (centres <= np.array(shape) - reach - 2)
    return centres[inside.all(axis=1)]


def _windows(centres: Values, reach: int) -> tuple[Any, Any]:
    """Rows and columns of the pixels about each centre, shape (n, 2 reach + 1, 2 reach + 1)."""
    around = np.arange(-reach, reach + 1)
    row, column = np.rint(centres).astype(np.intp).T
    y, x = row[:, None, None] + around[:, None], column[:, None, None] + around
    rows, columns = np.broadcast_arrays(y, x)
    return rows, columns


def _medians(ratios: Values, places: Values, reach: int) -> Frame:
    """Median of the ratios in cells of half a pixel; shape (n, n), the centre in the middle."""
    half = round((reach + 1) / _CELL)
    side = 2 * half + 1
    row, column = np.rint(places / _CELL).astype(np.intp) + half
    cell = row * side + column
    order = np.lexsort((ratios, cell))
    counts = np.bincount(cell, minlength=side * side)
    starts = np.concatenate(([0], np.cumsum(counts)[:-1]))
    middle = np.minimum(starts + counts // 2, len(ratios) - 1)
    table = np.where(counts >= _FEW, ratios[order][middle], np.nan).reshape(side, side)
    return _filled(np.clip(table, 0, None))


def _filled(table: Values) -> Frame:
    """Cells without a value take the mean of their neighbours', from the middle outwards."""
    while np.isnan(table).any() and not np.isnan(table).all():
        wide = np.pad(table, 1, constant_values=np.nan)
        parts = [
            wide[1 + i : len(wide) - 1 + i, 1 + j : len(wide) - 1 + j]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        known = [~np.isnan(part) for part in parts]
        count = np.sum(known, axis=0)
        total = np.sum([np.where(k, part, 0) for k, part in zip(known, parts, strict=True)], axis=0)
        mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        table = np.where(np.isnan(table), mean, table)
    return table.astype(np.float32)


def _spread(table: Frame, lattice: Lattice, shape: tuple[int, int], reach: int) -> Frame:
    """The table about the nearest centre of every pixel; 0 where there is none near."""
    from scipy.ndimage import map_coordinates

    centres = lattice.centres()
    on = ((centres >= 0) & (centres <= np.array(shape) - 1)).all(axis=1)
    inside = np.rint(centres[on]).astype(np.intp)
    left_y, left_x = (centres[on] - inside).astype(np.float32).T
    margin = reach + 1  # so that windows need no bounds
    width = shape[1] + 2 * margin
    first = (inside[:, 0] + margin) * width + inside[:, 1] + margin
    out = np.zeros((shape[0] + 2 * margin) * width, np.float32)
    nearest = np.full(out.shape, np.inf, np.float32)
    half = len(table) // 2
    fine = np.arange(-half * _FINE, half * _FINE + 1) / _FINE + half
    lookup = map_coordinates(table, np.meshgrid(fine, fine, indexing="ij"), order=1)
    middle, scale = half * _FINE, np.float32(_FINE / _CELL)
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            if math.hypot(i, j) > reach + 1:
                continue
            dy, dx = np.float32(i) - left_y, np.float32(j) - left_x
            apart = dy * dy + dx * dx
            at = first + (i * width + j)
            closer = apart < nearest[at]
            at, dy, dx = at[closer], dy[closer], dx[closer]
            nearest[at] = apart[closer]
            row, column = (np.rint(d * scale).astype(np.intp) + middle for d in (dy, dx))
            out[at] = lookup[row, column]
    return out.reshape(-1, width)[margin:-margin, margin:-margin].copy()
