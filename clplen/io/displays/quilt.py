"""Quilts: the views of a light field as tiles of a picture, for Looking Glass displays.

View 0 is the leftmost viewpoint and the bottom left tile; views continue to the right, then up.
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

_MAX_TILES = 32  # along a side; limit of Looking Glass's toolkit
_MAX_PIXELS = 2**14  # along a side; limit of Looking Glass's toolkit
_MIN_TILE = 16  # pixels along a side
_MAX_ASPECT = 10.0  # width over height, or its inverse
_NAME = re.compile(r"_qs(\d+)x(\d+)a(\d+(?:\.\d+)?)$")
_COPIES = 3  # of the quilt in memory while it is written


@dataclass(frozen=True)
class QuiltLayout:
    """Arrangement of the views of a quilt.

    Attributes
    ----------
    columns, rows : int
        Number of tiles, 1 to 32 each, at least 2 views in total.
    size : tuple of int
        Size (y, x) of the quilt in pixels, at most 16384 each. Pixels beyond whole tiles, at the
        top and at the right, are black.
    aspect : float
        Displayed width over height, 0.1 to 10. The display stretches tiles of other proportions.

    Raises
    ------
    ValueError
        If a number is out of range, or a tile would have fewer than 16 pixels along a side.

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
            if positive_integer(count, f"The number of {name}") > _MAX_TILES:
                raise ValueError(f"{name} must be 1 to {_MAX_TILES}, got {count}.")
        if self.views < 2:
            raise ValueError("A quilt must have at least 2 views: give more columns or rows.")
        if len(self.size) != 2:
            raise ValueError(f"size must be (y, x), got {self.size!r}.")
        for count in self.size:
            if positive_integer(count, "A side of a quilt") > _MAX_PIXELS:
                raise ValueError(
                    f"size must be 1 to {_MAX_PIXELS:,} pixels along each side, got {count:,}."
                )
        if not (is_finite(self.aspect) and 1 / _MAX_ASPECT <= self.aspect <= _MAX_ASPECT):
            raise ValueError(
                f"aspect must be width over height, {1 / _MAX_ASPECT:g} to {_MAX_ASPECT:g}, got "
                f"{self.aspect!r}."
            )
        if min(self.tile) < _MIN_TILE:
            raise ValueError(
                f"Tiles must have at least {_MIN_TILE} pixels along each side, got {self.tile[1]} "
                f"x {self.tile[0]} for {self.columns} x {self.rows} views in {self.size[1]} x "
                f"{self.size[0]} pixels: give a larger size or fewer views."
            )

    @property
    def views(self) -> int:
        """Number of views."""
        return self.columns * self.rows

    @property
    def tile(self) -> tuple[int, int]:
        """Size (y, x) of a tile in pixels."""
        return self.size[0] // self.rows, self.size[1] // self.columns

    def tile_slices(self, view: int) -> tuple[slice, slice]:
        """Return the rows and columns of a view's tile; view 0 is at the bottom left."""
        up, right = divmod(view, self.columns)
        height, width = self.tile
        top = self.size[0] - (up + 1) * height
        return slice(top, top + height), slice(right * width, (right + 1) * width)

    def name(self, path: PathLike) -> Path:
        """Return the name of a file with this layout at the end of its stem.

        Parameters
        ----------
        path : path-like
            Name of the file, with or without a layout.

        Returns
        -------
        pathlib.Path
            Name with this layout.

        Raises
        ------
        ValueError
            If the name contains another layout.
        """
        path = Path(path)
        ending = f"_qs{self.columns}x{self.rows}a{self.aspect:.6g}"
        match = _NAME.search(path.stem)
        if match is None:
            return path.with_name(path.stem + ending + path.suffix)
        has_tiles = (int(match[1]), int(match[2])) == (self.columns, self.rows)
        if not has_tiles or abs(float(match[3]) - self.aspect) > 1e-2 * self.aspect:
            raise ValueError(
                f"The name {path} contains another layout than {ending[1:]}: omit {match[0]}, the "
                "layout is added."
            )
        return path


# From docs.lookingglassfactory.com/keyconcepts/quilts; displays of 9:16, 3:4 and 16:9.
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
    """Write the views of a quilt as a PNG whose name contains the layout.

    Parameters
    ----------
    path : path-like
        ``.png`` file; ``_qs{columns}x{rows}a{aspect}`` is added to the stem if missing.
    tiles : iterable of array_like
        Tiles, uint8 of shape (y, x) or (y, x, 3), the leftmost viewpoint first.
    layout : QuiltLayout
        Columns, rows and size.

    Returns
    -------
    pathlib.Path
        Name of the file.

    Raises
    ------
    ValueError, ShapeError, MemoryError
        If the name is not ``.png`` or contains another layout, or tiles are not uint8; if the shape
        or number of tiles is wrong; if the quilt does not fit into memory.

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
        raise ValueError(f"path must end in .png for a quilt, got {target}.")
    quilt: Array | None = None
    count = 0
    for tile in (host_array(tile, "A tile") for tile in tiles):
        if tile.dtype != np.uint8:
            raise ValueError(f"The tiles of a quilt must be uint8, got {tile.dtype}.")
        fits = tile.shape[:2] == layout.tile and tile.shape[2:] in ((), (3,))
        if count >= layout.views or not fits:
            raise ShapeError(
                f"tiles must be {layout.views} tiles of shape {layout.tile} or "
                f"{(*layout.tile, 3)}, got {tile.shape} for tile {count}."
            )
        if quilt is None:
            check_memory(layout, tile.size // int(np.prod(layout.tile)))
            quilt = np.zeros((*layout.size, *tile.shape[2:]), np.uint8)
        if tile.ndim != quilt.ndim:
            raise ShapeError("The tiles of a quilt must be all grey or all coloured.")
        quilt[layout.tile_slices(count)] = tile
        count += 1
    if quilt is None or count != layout.views:
        raise ShapeError(f"tiles must contain {layout.views} tiles, got {count}.")
    write_picture(target, quilt)
    return target


def check_memory(layout: QuiltLayout, channels: int) -> None:
    """Raise MemoryError for a quilt that does not fit, before its views are computed."""
    needed, free = _COPIES * int(np.prod(layout.size)) * channels, free_memory()
    if needed > free:
        raise MemoryError(
            f"the quilt needs {needed:,} bytes, but only {free:,} are free: give a smaller size"
        )
