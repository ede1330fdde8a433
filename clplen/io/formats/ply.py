"""Point clouds as PLY (Turk 1994, "The PLY Polygon File Format"), binary little endian."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array, real_map
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike, replacing
from clplen.lightfield.depth.depth_maps import metric_depth
from clplen.outputs import MARK

Array = np.ndarray[Any, Any]

_COORDINATES = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
_COLOUR = [("red", "u1"), ("green", "u1"), ("blue", "u1")]
_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2"}
_TYPES |= {"uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
_MAX_HEADER_BYTES = 1 << 16
_METRIC = "metres from the centre view: x right, y down, z along the optical axis"
_PIXELS = "no camera: x and y in pixels, y down, z is the disparity in pixels per view step"


def write_ply(
    path: PathLike, points: ArrayLike, colours: ArrayLike | None = None, *, comment: str = ""
) -> None:
    """Write points and their colours as PLY.

    Parameters
    ----------
    path : path-like
        ``.ply`` file.
    points : array_like
        Points (n, 3): x, y, z; stored as float32. Points with a NaN or infinite coordinate are left
        out.
    colours : array_like, optional
        Colours (n, 3): red, green, blue, uint8.
    comment : str, optional
        Meaning of the coordinates, in ASCII.

    Raises
    ------
    ValueError, ShapeError, OSError
        If the suffix is not ``.ply``, colours are not uint8, or the comment is not ASCII; if shapes
        are wrong; if the file cannot be written.

    Examples
    --------
    >>> points = np.array([[0.0, 0.0, 1.5], [0.1, 0.0, 1.5], [0.0, 0.1, np.nan]])  # in metres
    >>> clplen.io.write_ply("points.ply", points, comment="metres")
    >>> clplen.io.read_ply("points.ply")[0].shape  # without the invalid point
    (2, 3)
    """
    if Path(path).suffix.lower() != ".ply":
        raise ValueError(f"path must end in .ply for a point cloud, got {path}.")
    points, colours = checked_points(points, colours)
    if not comment.isascii():
        raise ValueError(f"comment must be ASCII for PLY, got {comment!r}.")
    # Coordinates beyond the range of float32 become infinite.
    with np.errstate(over="ignore"):
        is_valid = np.isfinite(points.astype(np.float32)).all(1)
    vertices = np.empty(int(is_valid.sum()), _COORDINATES + ([] if colours is None else _COLOUR))
    for i, (name, _) in enumerate(_COORDINATES):
        vertices[name] = points[is_valid, i]
    for i, (name, _) in enumerate(_COLOUR if colours is not None else ()):
        vertices[name] = colours[is_valid, i]  # type: ignore[index]
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(_header(vertices, comment).encode("ascii"))
        file.write(vertices.tobytes())


def checked_points(points: ArrayLike, colours: ArrayLike | None) -> tuple[Array, Array | None]:
    """Return points (n, 3) and their colours (uint8) after a check of shapes and dtype."""
    points = host_array(points, "Points")
    colours = None if colours is None else host_array(colours, "Colours of points")
    if points.ndim != 2 or points.shape[1] != 3:
        raise ShapeError(f"Points must have shape (n, 3), got {points.shape}.")
    if colours is not None and colours.shape != points.shape:
        raise ShapeError(
            f"Colours must have the shape {points.shape} of the points, got {colours.shape}."
        )
    if colours is not None and colours.dtype != np.uint8:
        raise ValueError(f"Colours of points must be uint8, got {colours.dtype}.")
    return points, colours


def read_ply(path: PathLike) -> tuple[Array, Array | None]:
    """Read the points of a binary PLY, such as a file of `write_ply`.

    Parameters
    ----------
    path : path-like
        Binary PLY of either byte order, whose first element is ``vertex``.

    Returns
    -------
    numpy.ndarray, numpy.ndarray or None
        Coordinates x, y, z, shape (n, 3), float32; and colours red, green, blue, shape (n, 3),
        uint8, if stored.

    Raises
    ------
    FormatError
        If the file is missing, damaged, not binary PLY, or has points without x, y and z.

    Examples
    --------
    >>> points = np.array([[0.0, 0.0, 1.5], [0.1, 0.0, 1.5]])  # in metres
    >>> colours = np.array([[255, 0, 0], [0, 0, 255]], np.uint8)
    >>> clplen.io.write_ply("points.ply", points, colours)
    >>> stored, colours = clplen.io.read_ply("points.ply")
    >>> stored[:, 2].tolist(), colours.tolist()
    ([1.5, 1.5], [[255, 0, 0], [0, 0, 255]])
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no point cloud {path}.")
    with path.open("rb") as file:
        head, end, _ = file.read(_MAX_HEADER_BYTES).partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(
        lines[1][1] if len(lines) > 1 and len(lines[1]) > 1 else ""
    )
    elements = [index for index, line in enumerate(lines) if line[:1] == ["element"]]
    first = lines[elements[0]] if elements else []
    if not end or lines[:1] != [["ply"]] or order is None or first[1:2] != ["vertex"]:
        raise FormatError(f"{path} is not a binary PLY of points.")
    inside = lines[elements[0] + 1 : elements[1] if len(elements) > 1 else None]
    try:
        fields = [(line[2], order + _TYPES[line[1]]) for line in inside if line[:1] == ["property"]]
        kind, count = np.dtype(fields), int(first[2])
        available = (path.stat().st_size - len(head + end)) // kind.itemsize
        vertices = np.fromfile(path, kind, min(count, available), offset=len(head + end))
        points = np.stack([vertices[name] for name, _ in _COORDINATES], -1).astype(np.float32)
        colours = [vertices[name] for name, _ in _COLOUR if name in (vertices.dtype.names or ())]
    except (ArithmeticError, LookupError, ValueError) as error:
        raise FormatError(f"{path} is not a readable PLY of points ({error}).") from error
    if len(vertices) != count:
        raise FormatError(f"{path} is truncated: it has {len(vertices):,} of {count:,} points.")
    return points, np.stack(colours, -1).astype(np.uint8) if len(colours) == 3 else None


def _header(vertices: Array, comment: str) -> str:
    properties = [
        f"property {'float' if name in 'xyz' else 'uchar'} {name}"
        for name in vertices.dtype.names or ()
    ]
    comments = [f"comment {line}" for line in (MARK, *comment.splitlines())]
    lines = ["ply", "format binary_little_endian 1.0", *comments]
    lines += [f"element vertex {len(vertices)}", *properties, "end_header"]
    return "\n".join(lines) + "\n"


def points_of(
    disparity: ArrayLike,
    *,
    baseline: float | None = None,
    focal_length: float | None = None,
    pixel_pitch: float | None = None,
    focus_distance: float | None = None,
) -> tuple[Array, str]:
    """Return the points of a disparity map in the pinhole camera of the centre view.

    With Z = `metric_depth` of the disparity, pixel (y, x) has the coordinates Z (x - xc) p/f, Z (y
    - yc) p/f, Z relative to the pinhole. (yc, xc) is the centre of the picture.

    Parameters
    ----------
    disparity : DepthMap or array_like
        Disparity map (y, x) in pixels per view step; NaN and masked values are unknown.
    baseline : float, optional
        View step b in metres; required with ``focal_length`` and ``pixel_pitch``.
    focal_length : float, optional
        Distance f from pinhole to sensor in metres.
    pixel_pitch : float, optional
        Pixel pitch p of a view in metres.
    focus_distance : float, optional
        Distance Z0 of disparity 0 in metres; default infinite.

    Returns
    -------
    numpy.ndarray, str
        Points (y x, 3), float64, row by row: x, y, z in metres, NaN without a finite distance in
        front of the camera; and their meaning, for the comment of a PLY file. Without a camera, x
        and y are in pixels from the upper left pixel and z is the disparity.

    Raises
    ------
    ValueError, ShapeError
        If the camera is incomplete, or a length is not positive and finite; if the map is not
        two-dimensional.

    Examples
    --------
    >>> disparity = np.full((3, 5), 2.0)
    >>> points, comment = clplen.io.points_of(
    ...     disparity, baseline=5e-3, focal_length=20e-3, pixel_pitch=10e-6)
    >>> points.shape, np.round(points[0], 4).tolist()  # of the upper left pixel
    ((15, 3), [-0.005, -0.0025, 5.0])
    >>> comment
    'metres from the centre view: x right, y down, z along the optical axis'
    """
    d = real_map(disparity, "A disparity map", np.float64)
    if d.ndim != 2:
        raise ShapeError(f"disparity must have shape (y, x), got {d.shape}.")
    y, x = np.indices(d.shape, dtype=np.float64)
    if all(n is None for n in (baseline, focal_length, pixel_pitch, focus_distance)):
        return np.stack([x, y, d], -1).reshape(-1, 3), _PIXELS
    if baseline is None or focal_length is None or pixel_pitch is None:
        raise ValueError(
            "Points in metres need baseline=, focal_length= and pixel_pitch= together (and "
            "focus_distance= for a camera focused at a finite distance)."
        )
    z = metric_depth(
        d,
        baseline=baseline,
        focal_length=focal_length,
        pixel_pitch=pixel_pitch,
        focus_distance=focus_distance,
    )
    z[~np.isfinite(z)] = np.nan
    scale = z * pixel_pitch / focal_length
    across, down = (np.array(n) - 1 for n in (d.shape[1], d.shape[0]))
    coordinates = [(x - across / 2) * scale, (y - down / 2) * scale, z]
    return np.stack(coordinates, -1).reshape(-1, 3), _METRIC
