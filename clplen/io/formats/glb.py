"""Point clouds as binary glTF 2.0 (ISO/IEC 12113:2022), which browsers and 3-D programs open."""

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
_AXES = np.array([1.0, -1.0, -1.0])  # glTF: x right, y up, z towards the eye
_LARGEST = 2**32 - 1  # bytes of a file


def write_glb(
    path: PathLike, points: ArrayLike, colours: ArrayLike | None = None, *, comment: str = ""
) -> None:
    """Write points, each with its colour, as binary glTF.

    The axes of glTF are x right, y up and z towards the eye: y and z change their signs. Colours
    are decoded from sRGB, since glTF holds linear ones, in 16 bits.

    Parameters
    ----------
    path : path-like
        ``.glb``.
    points : array_like
        Shape (n, 3): x right, y down, z along the optical axis, in metres; stored as float32.
        Points with a coordinate that is NaN or infinite are left out.
    colours : array_like, optional
        Shape (n, 3), uint8: red, green, blue of sRGB.
    comment : str, optional
        What the coordinates are; kept in ``asset.extras``.

    Raises
    ------
    ValueError, ShapeError, OSError
        If the suffix is another one, colours are no uint8, no point is finite, or they fill more
        than 4 GiB; if points are not (n, 3), or colours have another shape; if the file cannot be
        written.

    Examples
    --------
    >>> points = np.array([[0.0, 0.0, 1.5], [0.1, 0.2, 1.5]])  # in metres
    >>> clplen.io.write_glb("points.glb", points, np.full((2, 3), 200, np.uint8))
    >>> with open("points.glb", "rb") as file:
    ...     file.read(4)
    b'glTF'
    """
    if Path(path).suffix.lower() != ".glb":
        raise ValueError(f"Binary glTF is written as .glb, not as {path}.")
    points, colours = checked_points(points, colours)
    with np.errstate(over="ignore"):
        places = (points * _AXES).astype("<f4")
    kept = np.isfinite(places).all(1)
    if not kept.any():
        raise ValueError("None of the points has a finite place: glTF holds one at least.")
    parts = [places[kept]]
    if colours is not None:
        rgba = np.ones((int(kept.sum()), 4))
        rgba[:, :3] = linear(colours[kept])
        parts.append(np.rint(65535 * rgba).astype("<u2"))
    text = json.dumps(_described(parts, comment), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = sum(part.nbytes for part in parts)  # 12 and 8 bytes a point: a multiple of 4
    whole = 12 + 8 + len(text) + 8 + size
    if whole > _LARGEST:
        raise ValueError(f"{len(parts[0])} points fill {whole:,} bytes; glTF holds up to 4 GiB.")
    head = np.array([_MAGIC, _VERSION, whole, len(text), _JSON], "<u4")
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(head.tobytes() + text + np.array([size, _BINARY], "<u4").tobytes())
        for part in parts:
            file.write(part.tobytes())


def write_points(
    path: PathLike, points: ArrayLike, colours: ArrayLike | None = None, *, comment: str = ""
) -> None:
    """Write a point cloud as PLY or binary glTF, by the suffix; words as for `write_glb`."""
    write = write_glb if Path(path).suffix.lower() == ".glb" else write_ply
    write(path, points, colours, comment=comment)


def _described(parts: list[Array], comment: str) -> dict[str, Any]:
    """The scene in JSON: one mesh of points."""
    places = parts[0]
    count, start = len(places), 0
    views: list[dict[str, int]] = []
    for part in parts:
        size = part.nbytes
        views.append({"buffer": 0, "byteOffset": start, "byteLength": size, "target": _VERTICES})
        start += size
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": _FLOAT, "count": count, "type": "VEC3",
         "min": places.min(0).tolist(), "max": places.max(0).tolist()}
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
