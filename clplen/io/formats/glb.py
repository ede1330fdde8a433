"""Point clouds as binary glTF 2.0 (ISO/IEC 12113:2022), for browsers and 3-D programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.files import PathLike, replacing
from clplen.io.formats.picture import linear
from clplen.io.formats.ply import checked_points, write_ply
from clplen.outputs import MARK

Array = np.ndarray[Any, Any]

SUFFIXES = (".ply", ".glb")  # of point clouds
_MAGIC, _VERSION = 0x46546C67, 2
_JSON, _BINARY = 0x4E4F534A, 0x004E4942  # types of chunks
_FLOAT, _SHORT = 5126, 5123  # types of components
_POINTS = 0  # mode of a primitive
_VERTICES = 34962  # target of a view of a buffer
_AXES = np.array([1.0, -1.0, -1.0])  # glTF: x right, y up, z towards the viewer
_MAX_FILE_BYTES = 2**32 - 1  # length field of 32 bits


def write_glb(
    path: PathLike, points: ArrayLike, colours: ArrayLike | None = None, *, comment: str = ""
) -> None:
    """Write points and their colours as binary glTF.

    glTF has x right, y up and z towards the viewer, so y and z change sign. Colours are decoded
    from sRGB to the linear colours of glTF, in 16 bits.

    Parameters
    ----------
    path : path-like
        ``.glb`` file.
    points : array_like
        Points (n, 3): x right, y down, z along the optical axis, in metres; stored as float32.
        Points with a NaN or infinite coordinate are left out.
    colours : array_like, optional
        sRGB colours (n, 3), uint8.
    comment : str, optional
        Meaning of the coordinates, stored in ``asset.extras``.

    Raises
    ------
    ValueError, ShapeError, OSError
        If the suffix is not ``.glb``, colours are not uint8, no point is finite, or the file
        exceeds 4 GiB; if shapes are wrong; if the file cannot be written.

    Examples
    --------
    >>> points = np.array([[0.0, 0.0, 1.5], [0.1, 0.2, 1.5]])  # in metres
    >>> clplen.io.write_glb("points.glb", points, np.full((2, 3), 200, np.uint8))
    >>> with open("points.glb", "rb") as file:
    ...     file.read(4)
    b'glTF'
    """
    if Path(path).suffix.lower() != ".glb":
        raise ValueError(f"path must end in .glb for binary glTF, got {path}.")
    points, colours = checked_points(points, colours)
    with np.errstate(over="ignore"):
        coordinates = (points * _AXES).astype("<f4")
    is_valid = np.isfinite(coordinates).all(1)
    if not is_valid.any():
        raise ValueError("points must have at least one finite point for glTF.")
    parts = [coordinates[is_valid]]
    if colours is not None:
        rgba = np.ones((int(is_valid.sum()), 4))
        rgba[:, :3] = linear(colours[is_valid])
        parts.append(np.rint(65535 * rgba).astype("<u2"))
    text = json.dumps(_scene(parts, comment), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = sum(part.nbytes for part in parts)  # 12 and 8 bytes a point: a multiple of 4
    total = 12 + 8 + len(text) + 8 + size
    if total > _MAX_FILE_BYTES:
        raise ValueError(
            f"glTF files must be smaller than 4 GiB, got {total:,} bytes: write fewer points."
        )
    head = np.array([_MAGIC, _VERSION, total, len(text), _JSON], "<u4")
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(head.tobytes() + text + np.array([size, _BINARY], "<u4").tobytes())
        for part in parts:
            file.write(part.tobytes())


def write_points(
    path: PathLike, points: ArrayLike, colours: ArrayLike | None = None, *, comment: str = ""
) -> None:
    """Write a point cloud as PLY or binary glTF, by the suffix; arguments as for `write_glb`."""
    write = write_glb if Path(path).suffix.lower() == ".glb" else write_ply
    write(path, points, colours, comment=comment)


def _scene(parts: list[Array], comment: str) -> dict[str, Any]:
    """Return the scene as JSON: a mesh of points."""
    coordinates = parts[0]
    count, start = len(coordinates), 0
    views: list[dict[str, int]] = []
    for part in parts:
        size = part.nbytes
        views.append({"buffer": 0, "byteOffset": start, "byteLength": size, "target": _VERTICES})
        start += size
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": _FLOAT, "count": count, "type": "VEC3",
         "min": coordinates.min(0).tolist(), "max": coordinates.max(0).tolist()}
    ]  # fmt: skip
    attributes = {"POSITION": 0}
    if len(parts) > 1:
        accessors.append(
            {"bufferView": 1, "componentType": _SHORT, "normalized": True, "count": count,
             "type": "VEC4"}
        )  # fmt: skip
        attributes["COLOR_0"] = 1
    primitive = {"attributes": attributes, "mode": _POINTS, "material": 0}
    return {
        "asset": {"version": "2.0", "generator": MARK, "extras": {"comment": comment}},
        "extensionsUsed": ["KHR_materials_unlit"],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}}],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
