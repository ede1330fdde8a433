"""Positions of the sub-images on the sensor in pixels, and the types of lenses."""

from __future__ import annotations

from dataclasses import dataclass

from clplen.reprs import OneLine


@dataclass(frozen=True, repr=False)
class LensletGrid(OneLine):
    """Centres of the sub-images on the sensor, in pixels; pixel centres are integers.

    Sub-image (i, k) has its centre at ``first + i row_step + k column_step``; odd rows are shifted
    by ``odd_row_shift column_step``. View (v, u) of (V, U) is offset from it by ``(v - (V - 1)/2)
    row_view_step + (u - (U - 1)/2) column_view_step``.

    Attributes
    ----------
    count : tuple of int
        Number (rows, columns) of sub-images.
    views : tuple of int
        Number (V, U) of pixels taken from each sub-image.
    first, row_step, column_step : tuple of float
        Vectors (y, x) in pixels.
    odd_row_shift : float
        Shift of odd rows: 0 for a square lattice, 1/2 for a hexagonal one.
    row_view_step, column_view_step : tuple of float
        Vectors (y, x) in pixels along the rows and columns of the lattice, so that rotated and
        upright arrays obey equal equations.
    columns : tuple or None
        (count, step): number and distance of the columns of the views, in steps of ``column_step``
        from ``first``, to which the rows are interpolated. None: the lenslets of even rows.
    exchanged : bool
        True if rows and columns of the picture, and of the views, are exchanged: L[v, u, y, x] is
        view (u, v) at (x, y) of this grid.

    Examples
    --------
    >>> grid = clplen.lightfield.LensletGrid((5, 7), (15, 15), (7.0, 7.0), (15.0, 0.0), (0.0, 15.0))
    >>> grid.count, grid.views
    ((5, 7), (15, 15))
    """

    count: tuple[int, int]
    views: tuple[int, int]
    first: tuple[float, float]
    row_step: tuple[float, float]
    column_step: tuple[float, float]
    odd_row_shift: float = 0.0
    row_view_step: tuple[float, float] = (1.0, 0.0)
    column_view_step: tuple[float, float] = (0.0, 1.0)
    columns: tuple[int, float] | None = None
    exchanged: bool = False

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape (V, U, y, x) of the light field."""
        (V, U), (y, x) = self.views, self.count
        x = x if self.columns is None else self.columns[0]
        return (U, V, x, y) if self.exchanged else (V, U, y, x)


@dataclass(frozen=True)
class LensType:
    """Type of lenses of a multi-focus array.

    Its lenses lie at ``origin + offset + i steps[0] + k steps[1]`` for all integers i and k, with
    ``origin`` that of the array's lattice.

    Attributes
    ----------
    offset : tuple of float
        Offset (y, x) in pixels.
    depth_range : tuple of float
        Range (lowest, highest) of virtual depths in focus.
    steps : tuple
        Two vectors (y, x) in pixels.

    Examples
    --------
    >>> lens = clplen.lightfield.LensType((0.0, 0.0), (2.0, 4.0), ((30.0, 0.0), (0.0, 30.0)))
    >>> lens.depth_range
    (2.0, 4.0)
    """

    offset: tuple[float, float]
    depth_range: tuple[float, float]
    steps: tuple[tuple[float, float], tuple[float, float]]
