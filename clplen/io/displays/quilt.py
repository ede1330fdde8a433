"""Quilts: the views of a light field as tiles of one picture, for Looking Glass displays.

View 0 is the leftmost viewpoint and the tile at the bottom left; views go to the right, then up.
The name of the file ends in ``_qs{columns}x{rows}a{aspect}``. Sizes, names and presets:
docs.lookingglassfactory.com/keyconcepts/quilts.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array, is_finite, positive_integer
from clplen.compute.memory import free_memory
from clplen.errors import ShapeError
from clplen.files import PathLike
from clplen.io.formats.picture import write_picture

Array = np.ndarray[Any, Any]

_MOST_TILES = 32  # along a side, and
_MOST_PIXELS = 2**14  # a side: bounds of Looking Glass's own toolkit
_LEAST_TILE = 16  # pixels a side
_WIDEST = 10.0  # width over height, or the reverse
_NAME = re.compile(r"_qs(\d+)x(\d+)a(\d+(?:\.\d+)?)$")
_COPIES = 3  # of the quilt while it is written


@dataclass(frozen=True)
class QuiltLayout:
    """How the views of a quilt are arranged.

    Attributes
    ----------
    columns, rows : int
        Of tiles, 1 to 32 each, at least 2 views in all.
    size : tuple of int
        (y, x) pixels of the quilt, at most 16384 each. What a whole number of tiles does not fill
        stays black at the top and at the right.
    aspect : float
        Width over height of what the display shows, 0.1 to 10. A tile may have other proportions:
        the display stretches it.

    Raises
    ------
    ValueError
        If a number is out of range, or a tile would have fewer than 16 pixels a side.

    Examples
    --------
    >>> layout = clplen.io.QuiltLayout(8, 6, (3360, 3360), 0.75)
    >>> layout.views, layout.tile
    (48, (560, 420))
    >>> layout.name("flower.png").name
    'flower_qs8x6a0.75.png'
    """

    columns: int
    rows: int
    size: tuple[int, int]
    aspect: float

    def __post_init__(self) -> None:
        for name, count in (("columns", self.columns), ("rows", self.rows)):
            if positive_integer(count, f"The number of {name}") > _MOST_TILES:
                raise ValueError(f"A quilt has 1 to {_MOST_TILES} {name}, not {count}.")
        if self.views < 2:
            raise ValueError("A quilt has at least 2 views: give more columns or rows.")
        if len(self.size) != 2:
            raise ValueError(f"The size of a quilt is (y, x), not {self.size!r}.")
        for count in self.size:
            if positive_integer(count, "A side of a quilt") > _MOST_PIXELS:
                raise ValueError(
                    f"A quilt has 1 to {_MOST_PIXELS:,} pixels a side, not {count:,}: no display "
                    "takes more."
                )
        if not (is_finite(self.aspect) and 1 / _WIDEST <= self.aspect <= _WIDEST):
            raise ValueError(
                f"The aspect is width over height, {1 / _WIDEST:g} to {_WIDEST:g}, not "
                f"{self.aspect!r}."
            )
        if min(self.tile) < _LEAST_TILE:
            raise ValueError(
                f"{self.columns} x {self.rows} views in {self.size[1]} x {self.size[0]} pixels "
                f"have {self.tile[1]} x {self.tile[0]} each: give a larger size or fewer views, "
                f"so that they have at least {_LEAST_TILE}."
            )

    @property
    def views(self) -> int:
        """How many there are."""
        return self.columns * self.rows

    @property
    def tile(self) -> tuple[int, int]:
        """(y, x) pixels of one."""
        return self.size[0] // self.rows, self.size[1] // self.columns

    def place(self, view: int) -> tuple[slice, slice]:
        """Rows and columns of pixels of a view's tile; view 0 is bottom left, then to the right."""
        up, right = divmod(view, self.columns)
        height, width = self.tile
        top = self.size[0] - (up + 1) * height
        return slice(top, top + height), slice(right * width, (right + 1) * width)

    def name(self, path: PathLike) -> Path:
        """The name of a file with this layout at the end of its stem.

        Parameters
        ----------
        path : path-like

        Returns
        -------
        pathlib.Path

        Raises
        ------
        ValueError
            If the name tells another layout.
        """
        path = Path(path)
        ending = f"_qs{self.columns}x{self.rows}a{self.aspect:.6g}"
        told = _NAME.search(path.stem)
        if told is None:
            return path.with_name(path.stem + ending + path.suffix)
        same = (int(told[1]), int(told[2])) == (self.columns, self.rows)
        if not same or abs(float(told[3]) - self.aspect) > 1e-2 * self.aspect:
            raise ValueError(
                f"The name {path} tells of another layout than {ending[1:]}: leave "
                f"{told[0]} out, it is added."
            )
        return path


# By docs.lookingglassfactory.com/keyconcepts/quilts; the displays show 9:16, 3:4 and 16:9.
DISPLAYS = {
    "go": QuiltLayout(11, 6, (4092, 4092), 9 / 16),
    "portrait": QuiltLayout(8, 6, (3360, 3360), 3 / 4),
    "16-landscape": QuiltLayout(7, 7, (5999, 5999), 16 / 9),
    "16-portrait": QuiltLayout(11, 6, (6000, 5995), 9 / 16),
    "32-landscape": QuiltLayout(7, 7, (8190, 8190), 16 / 9),
    "32-portrait": QuiltLayout(11, 6, (8184, 8184), 9 / 16),
    "65": QuiltLayout(8, 9, (8192, 8192), 16 / 9),
}


def write_quilt(path: PathLike, tiles: Iterable[ArrayLike], layout: QuiltLayout) -> Path:
    """Write the views of a quilt as a PNG, whose name tells the layout.

    Parameters
    ----------
    path : path-like
        ``.png``; ``_qs{columns}x{rows}a{aspect}`` is added where the stem does not end in it.
    tiles : iterable of array_like
        uint8, of the tile's shape (y, x) or (y, x, 3), the leftmost viewpoint first.
    layout : QuiltLayout
        Columns, rows and size.

    Returns
    -------
    pathlib.Path
        The name of the file.

    Raises
    ------
    ValueError, ShapeError, MemoryError
        If the name is no ``.png`` or tells another layout, or tiles are not uint8; if a tile has
        another shape, or there are more or fewer than the layout has; if the quilt does not fit
        into memory.

    Examples
    --------
    >>> layout = clplen.io.QuiltLayout(3, 2, (80, 96), 0.8)
    >>> tiles = [np.full(layout.tile, 40 * n, np.uint8) for n in range(layout.views)]
    >>> clplen.io.write_quilt("grey.png", tiles, layout).name
    'grey_qs3x2a0.8.png'
    >>> clplen.io.read_picture("grey_qs3x2a0.8.png")[[79, 0], [0, 95]].tolist()  # first and last
    [0, 200]
    """
    target = layout.name(path)
    if target.suffix.lower() != ".png":
        raise ValueError(f"A quilt is written as .png, not as {target}.")
    quilt: Array | None = None
    count = 0
    for tile in (host_array(tile, "A tile") for tile in tiles):
        if tile.dtype != np.uint8:
            raise ValueError(f"The tiles of a quilt are uint8, not {tile.dtype}.")
        fits = tile.shape[:2] == layout.tile and tile.shape[2:] in ((), (3,))
        if count >= layout.views or not fits:
            raise ShapeError(
                f"A quilt of {layout.columns} x {layout.rows} has {layout.views} tiles of shape "
                f"{layout.tile} or {(*layout.tile, 3)}; tile {count} has {tile.shape}."
            )
        if quilt is None:
            check_memory(layout, tile.size // int(np.prod(layout.tile)))
            quilt = np.zeros((*layout.size, *tile.shape[2:]), np.uint8)
        if tile.ndim != quilt.ndim:
            raise ShapeError("The tiles of a quilt are all grey or all in colour.")
        quilt[layout.place(count)] = tile
        count += 1
    if quilt is None or count != layout.views:
        raise ShapeError(f"The quilt has {layout.views} tiles, and {count} were given.")
    write_picture(target, quilt)
    return target


def check_memory(layout: QuiltLayout, channels: int) -> None:
    """Refuse a quilt that does not fit, before its views are computed."""
    needed, free = _COPIES * int(np.prod(layout.size)) * channels, free_memory()
    if needed > free:
        raise MemoryError(
            f"the quilt takes {needed:,} bytes, of which {free:,} are free: give a smaller size"
        )
