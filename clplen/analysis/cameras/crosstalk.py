"""Share of the light of a point outside its own lenslet's cell, or outside its cone's lenslets."""

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
    """Return centres (y, x) of all cells in pixels, float64, shape (rows, columns, 2)."""
    i, k = np.indices(cells.count, dtype=np.float64)
    along = k + cells.odd_row_shift * (i % 2)
    first, row, column = (np.asarray(v) for v in (cells.first, cells.row_step, cells.column_step))
    return np.asarray(first + i[..., None] * row + along[..., None] * column)


def cell_outline(cells: LensletGrid, cell: Cell) -> Values:
    """Return the corners (y, x) of a cell in pixels.

    The cell holds all points nearest to its centre: a rectangle on a square lattice, a hexagon on
    a hexagonal lattice, at any rotation.
    """
    centre = cell_centres(cells)[_checked_cell(cells, cell)]
    row, column = np.asarray(cells.row_step), np.asarray(cells.column_step)
    if cells.odd_row_shift == 0:
        neighbours = [column, row, -column, -row]
    else:
        neighbours = [column, row + column / 2, row - column / 2]
        neighbours += [-step for step in neighbours]
    corners = [
        np.linalg.solve(np.stack((a, b)), np.array((a @ a, b @ b)) / 2)
        for a, b in zip(neighbours, neighbours[1:] + neighbours[:1], strict=True)
    ]
    return centre + np.array(corners)


def cell_energies(raw: Any, cells: LensletGrid) -> Values:
    """Return the light in every cell of a raw image.

    Each pixel belongs to the cell with the nearest centre.

    Parameters
    ----------
    raw : array_like
        Intensities on the sensor, shape (y, x).
    cells : LensletGrid
        Cells of the lenslets, such as `RawImage.cells`.

    Returns
    -------
    numpy.ndarray
        Sums in the units of the raw image, float64, shape (rows, columns), without pixels outside
        all cells.

    Raises
    ------
    ShapeError, ValueError
        If the picture is not two-dimensional, real and finite.

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
    cell = row[inside] * cells.count[1] + column[inside]
    total = np.bincount(cell, picture[inside], cells.count[0] * cells.count[1])
    return np.asarray(total, np.float64).reshape(cells.count)


def energy_in_cell(raw: Any, cells: LensletGrid, cell: Cell) -> float:
    """Sum the light in a cell; pixels cut by its outline count with their covered part."""
    picture = checked(raw, "A raw image")
    outline = cell_outline(cells, cell)
    low = np.clip(np.floor(outline.min(axis=0)).astype(int) - 1, 0, np.array(picture.shape) - 1)
    high = np.clip(np.ceil(outline.max(axis=0)).astype(int) + 2, 1, picture.shape)
    if (high <= low).any():
        return 0.0
    ny, nx = (int(n) for n in high - low)
    grid = Grid((ny, nx), 1.0, origin=(float(low[0] + ny // 2), float(low[1] + nx // 2)))
    coverage = polygon_coverage(grid, outline)
    return float(np.sum(picture[low[0] : high[0], low[1] : high[1]] * coverage))


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
        Cell (row, column) of the point; default the brightest.
    total : float, optional
        Energy that counts as 1, in the units of the picture's sum; default this sum.

    Returns
    -------
    float
        Share of the light, between 0 and 1.

    Raises
    ------
    ShapeError, ValueError
        If the picture is not two-dimensional, real and finite or is dark, or the cell is outside.

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
    energy = float(picture.sum()) if total is None else float(total)
    if not energy > 0:
        raise ValueError(f"The sum of the picture must be positive, got {energy:.4g}.")
    if cell is None:
        energies = cell_energies(picture, cells)
        i, k = np.unravel_index(np.argmax(energies), energies.shape)
        cell = (int(i), int(k))
    return 1 - energy_in_cell(picture, cells, cell) / energy


def _checked_cell(cells: LensletGrid, cell: Cell) -> Cell:
    i, k = cell
    if not (0 <= i < cells.count[0] and 0 <= k < cells.count[1]):
        raise ValueError(f"cell must lie in {cells.count} (rows, columns), got {cell!r}.")
    return int(i), int(k)


def _rounded(i: Values, k: Values, cells: LensletGrid) -> tuple[Any, Any]:
    """Return the nearest cell of points in steps of rows and columns."""
    if cells.odd_row_shift == 0:
        return np.rint(i).astype(np.int64), np.rint(k).astype(np.int64)
    row_step, column_step = np.asarray(cells.row_step), np.asarray(cells.column_step)
    candidates = []
    for nearest_row in (np.floor(i), np.floor(i) + 1):
        shift = cells.odd_row_shift * (nearest_row % 2)
        column = np.rint(k - shift)
        down, right = i - nearest_row, k - shift - column
        y = down * row_step[0] + right * column_step[0]
        x = down * row_step[1] + right * column_step[1]
        candidates.append((y * y + x * x, nearest_row, column))
    first = candidates[0][0] <= candidates[1][0]
    row = np.where(first, candidates[0][1], candidates[1][1])
    column = np.where(first, candidates[0][2], candidates[1][2])
    return row.astype(np.int64), column.astype(np.int64)


def camera_crosstalk(camera: Plenoptic | Any) -> float:
    """Simulate the fraction of a focused point's light that misses its lenslet cells.

    The chief ray of the point passes through the centre of the middle lenslet. In a 1.0 camera the
    light belongs in the cell of this lenslet (`crosstalk`). In a 2.0 camera it belongs in the
    sub-images of all lenslets in the point's cone of rays, D abs(a)/F wide on the array.

    Pixels on two cells count in part. With a fractional ``pixels_per_lenslet`` they can raise the
    result by several percent; a whole number shows the crosstalk of the optics.

    Parameters
    ----------
    camera : Plenoptic
        Camera from `PlenopticCamera.type1` or `type2`, with its device.

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
    energy = sum(
        energy_in_cell(light, raw.sub_images, cell) for cell in lenslets_in_cone(camera, middle)
    )
    return max(0.0, 1 - energy / float(light.sum()))


def lenslets_in_cone(camera: Any, middle: tuple[int, int]) -> list[tuple[int, int]]:
    """Return (row, column) of all lenslets in the cone through the middle lenslet."""
    reach = camera.aperture_diameter * abs(camera.a) / camera.image_distance / 2
    mla = camera.mla
    centres = np.asarray(mla.centres())
    cos, sin = np.cos(mla.rotation), np.sin(mla.rotation)
    across = np.abs((centres - centres[middle]) @ [[cos, sin], [-sin, cos]])  # along its rows
    beyond = np.maximum(across - np.array((mla.row_pitch, mla.pitch)) / 2, 0)
    inside = np.hypot(beyond[..., 0], beyond[..., 1]) < max(reach, 1e-9)
    return [(int(i), int(k)) for i, k in np.argwhere(inside)]
