"""Light of a point outside its own cell of a raw image, or outside its cone's lenslets."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.analysis.cameras.imaging import central_lenslet, is_focused, point_at_lenslet
from clplen.analysis.point.samples import Values, checked
from clplen.cameras.camera_base import Plenoptic
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.wave.elements.hard_apertures import polygon_coverage
from clplen.wave.field.field import Grid

Cell = tuple[int, int]


def cell_centres(cells: LensletGrid) -> Values:
    """Centres (y, x) of all cells in pixels, float64, shape (rows, columns, 2)."""
    i, k = np.indices(cells.count, dtype=np.float64)
    along = k + cells.odd_row_shift * (i % 2)
    first, row, column = (np.asarray(v) for v in (cells.first, cells.row_step, cells.column_step))
    return np.asarray(first + i[..., None] * row + along[..., None] * column)


def cell_outline(cells: LensletGrid, cell: Cell) -> Values:
    """Corners (y, x) of a cell in pixels: of all places that are nearest to its centre.

    A rectangle of a square lattice, a hexagon of a hexagonal one, whatever it is turned by.
    """
    centre = cell_centres(cells)[_known(cells, cell)]
    row, column = np.asarray(cells.row_step), np.asarray(cells.column_step)
    if cells.odd_row_shift == 0:
        around = [column, row, -column, -row]
    else:
        around = [column, row + column / 2, row - column / 2]
        around += [-step for step in around]
    corners = [
        np.linalg.solve(np.stack((a, b)), np.array((a @ a, b @ b)) / 2)
        for a, b in zip(around, around[1:] + around[:1], strict=True)
    ]
    return centre + np.array(corners)


def cell_energies(raw: Any, cells: LensletGrid) -> Values:
    """Return the light in every cell of a raw image.

    Each pixel counts for the cell whose centre is nearest to its own.

    Parameters
    ----------
    raw : array_like
        Intensities on the sensor, shape (y, x).
    cells : LensletGrid
        Such as `RawImage.cells`.

    Returns
    -------
    numpy.ndarray
        Sums in the units of the raw image, float64, shape (rows, columns); pixels outside all cells
        count nowhere.

    Raises
    ------
    ShapeError, ValueError
        If the picture is no real finite one.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> raw = camera.expose(clplen.PointSources([(0.0, 0.0, 0.0)]))
    >>> light = clplen.analysis.cell_energies(raw.to_numpy(), raw.cells)
    >>> light.shape, f"{light[3, 3] / light.sum():.2f} in the middle cell"
    ((7, 7), '0.97 in the middle cell')
    """
    picture = checked(raw, "A raw image")
    y, x = np.indices(picture.shape, dtype=np.float64)
    matrix = np.linalg.inv(np.array([cells.row_step, cells.column_step]).T)
    i = matrix[0, 0] * (y - cells.first[0]) + matrix[0, 1] * (x - cells.first[1])
    k = matrix[1, 0] * (y - cells.first[0]) + matrix[1, 1] * (x - cells.first[1])
    row, column = _rounded(i, k, cells)
    inside = (row >= 0) & (row < cells.count[0]) & (column >= 0) & (column < cells.count[1])
    place = row[inside] * cells.count[1] + column[inside]
    total = np.bincount(place, picture[inside], cells.count[0] * cells.count[1])
    return np.asarray(total, np.float64).reshape(cells.count)


def energy_in_cell(raw: Any, cells: LensletGrid, cell: Cell) -> float:
    """The light in one cell, with the exact part of every pixel that its outline cuts."""
    picture = checked(raw, "A raw image")
    outline = cell_outline(cells, cell)
    low = np.clip(np.floor(outline.min(axis=0)).astype(int) - 1, 0, np.array(picture.shape) - 1)
    high = np.clip(np.ceil(outline.max(axis=0)).astype(int) + 2, 1, picture.shape)
    if (high <= low).any():
        return 0.0
    ny, nx = (int(n) for n in high - low)
    part = Grid((ny, nx), 1.0, origin=(float(low[0] + ny // 2), float(low[1] + nx // 2)))
    held = polygon_coverage(part, outline)
    return float(np.sum(picture[low[0] : high[0], low[1] : high[1]] * held))


def crosstalk(
    raw: Any, cells: LensletGrid, *, cell: Cell | None = None, total: float | None = None
) -> float:
    """Return the share of the light of one point that falls outside its own cell.

    Parameters
    ----------
    raw : array_like
        Intensities on the sensor, shape (y, x), of one point in focus and without background.
    cells : LensletGrid
        The lenslets' cells: `RawImage.cells`, or `RawImage.sub_images` for those of chief rays.
    cell : tuple of int, optional
        (row, column) of its own cell; default the one with the most light.
    total : float, optional
        Energy that counts as 1, in the units of the picture's sum; default that sum.

    Returns
    -------
    float
        Share of the light, between 0 and 1.

    Raises
    ------
    ShapeError, ValueError
        If the picture is no real finite one or has no light, or there is no such cell.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> raw = camera.expose(clplen.PointSources([(0.0, 0.0, 0.0)]))
    >>> f"{clplen.analysis.crosstalk(raw.to_numpy(), raw.cells):.3f}"
    '0.032'
    """
    picture = checked(raw, "A raw image")
    whole = float(picture.sum()) if total is None else float(total)
    if not whole > 0:
        raise ValueError(f"A point's light has a positive sum, not {whole:.4g}.")
    if cell is None:
        energies = cell_energies(picture, cells)
        i, k = np.unravel_index(np.argmax(energies), energies.shape)
        cell = (int(i), int(k))
    return 1 - energy_in_cell(picture, cells, cell) / whole


def _known(cells: LensletGrid, cell: Cell) -> Cell:
    i, k = cell
    if not (0 <= i < cells.count[0] and 0 <= k < cells.count[1]):
        raise ValueError(f"There is no cell {cell!r}; the array has {cells.count} (rows, columns).")
    return int(i), int(k)


def _rounded(i: Values, k: Values, cells: LensletGrid) -> tuple[Any, Any]:
    """The nearest cell of places given in steps of rows and columns."""
    if cells.odd_row_shift == 0:
        return np.rint(i).astype(np.int64), np.rint(k).astype(np.int64)
    row_step, column_step = np.asarray(cells.row_step), np.asarray(cells.column_step)
    found = []
    for near in (np.floor(i), np.floor(i) + 1):
        shift = cells.odd_row_shift * (near % 2)
        column = np.rint(k - shift)
        down, right = i - near, k - shift - column
        y = down * row_step[0] + right * column_step[0]
        x = down * row_step[1] + right * column_step[1]
        found.append((y * y + x * x, near, column))
    first = found[0][0] <= found[1][0]
    row = np.where(first, found[0][1], found[1][1])
    column = np.where(first, found[0][2], found[1][2])
    return row.astype(np.int64), column.astype(np.int64)


def camera_crosstalk(camera: Plenoptic | Any) -> float:
    """Simulate how much of a focused point's light falls outside its own lenslets' cells.

    The point's chief ray goes through the centre of the middle lenslet. Of a 1.0 camera that one is
    the point's own (`crosstalk`); of a 2.0 camera all those are that the cone of rays, D abs(a)/F
    wide on the array, meets, with the cells of their sub-images.

    Parameters
    ----------
    camera : Plenoptic
        `PlenopticCamera.type1` or `type2`, with its device.

    Returns
    -------
    float
        Share of the light, between 0 and 1.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> f"{clplen.analysis.camera_crosstalk(camera):.3f}"
    '0.032'
    """
    raw = camera.expose(point_at_lenslet(camera, (0.0, 0.0), 0.0))
    light, middle = np.asarray(raw.to_numpy(), np.float64), central_lenslet(camera)
    if not is_focused(camera):
        return crosstalk(light, raw.cells, cell=middle)
    own = sum(
        energy_in_cell(light, raw.sub_images, cell) for cell in lenslets_in_cone(camera, middle)
    )
    return max(0.0, 1 - own / float(light.sum()))


def lenslets_in_cone(camera: Any, middle: tuple[int, int]) -> list[tuple[int, int]]:
    """(row, column) of the lenslets that the cone through one of them meets, itself included."""
    reach = camera.aperture_diameter * abs(camera.a) / camera.image_distance / 2
    mla = camera.mla
    centres = np.asarray(mla.centres())
    cos, sin = np.cos(mla.rotation), np.sin(mla.rotation)
    across = np.abs((centres - centres[middle]) @ [[cos, sin], [-sin, cos]])  # along its rows
    beyond = np.maximum(across - np.array((mla.row_pitch, mla.pitch)) / 2, 0)
    inside = np.hypot(beyond[..., 0], beyond[..., 1]) < max(reach, 1e-9)
    return [(int(i), int(k)) for i, k in np.argwhere(inside)]
