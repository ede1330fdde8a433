"""Positions of the sub-images on the sensor, as plain numbers, and the types of lenses."""

from __future__ import annotations

from dataclasses import dataclass

from clplen.reprs import OneLine


@dataclass(frozen=True, repr=False)
class LensletGrid(OneLine):
    """Centres of the sub-images on the sensor, in pixels; pixel centres are integers.

    Sub-image (i, k) has its centre at ``first + i row_step + k column_step``, and odd rows are
    shifted by ``odd_row_shift column_step``. View (v, u) of (V, U) lies ``(v - (V - 1)/2)
    row_view_step + (u - (U - 1)/2) column_view_step`` from there.

    Attributes
    ----------
    count : tuple of int
        Sub-images, (rows, columns).
    views : tuple of int
        Pixels taken from each, (V, U).
    first, row_step, column_step : tuple of float
        (y, x) in pixels.
    odd_row_shift : float
        0 for a square lattice, 1/2 for a hexagonal one.
    row_view_step, column_view_step : tuple of float
        (y, x) in pixels; along the rows and columns of the lattice, so that a rotated array obeys
        the same equations as an upright one.
    columns : tuple or None
        (count, step): how many columns the views have and how far apart, in steps of
        ``column_step`` from ``first``; the rows are interpolated to them. None: those of the
        lenslets of even rows.
    exchanged : bool
        Whether rows and columns of the picture are exchanged here, and views too: L[v, u, y, x]
        is what this grid calls view (u, v) of (x, y).

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
        """(V, U, y, x) of the light field."""
        (V, U), (y, x) = self.views, self.count
        x = x if self.columns is None else self.columns[0]
        return (U, V, x, y) if self.exchanged else (V, U, y, x)


@dataclass(frozen=True)
class LensType:
    """One of the kinds of lenses of a multi-focus array.

    Its lenses lie at ``origin + offset + i steps[0] + k steps[1]`` for all integers i and k, with
    the origin of the array's lattice.

    Attributes
    ----------
    offset : tuple of float
        (y, x) in pixels.
    depth_range : tuple of float
        (least, greatest) virtual depth at which it is sharp.
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
