"""Binary glTF, parsed here by the published structure."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from clplen.errors import ShapeError
from clplen.io import write_glb


def chunks_of(path: Path) -> tuple[dict, bytes]:
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    assert size % 4 == 0
    more, binary = struct.unpack_from("<I4s", data, 20 + size)
    assert binary == b"BIN\0"
    assert 28 + size + more == len(data)
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def test_points_are_where_they_were(tmp_path: Path) -> None:
    for coloured in [False, True]:
        rng = np.random.default_rng(5)
        points = rng.normal(size=(37, 3)) * (0.3, 0.2, 1) + (0, 0.1, 2)
        points[11, 1] = np.nan
        colours = rng.integers(0, 256, (37, 3)).astype(np.uint8)
        path = tmp_path / "a.glb"
        write_glb(path, points, colours if coloured else None, comment="metres")
        scene, binary = chunks_of(path)
        assert scene["buffers"] == [{"byteLength": len(binary)}]
        assert scene["asset"]["extras"] == {"comment": "metres"}
        primitive = scene["meshes"][0]["primitives"][0]
        assert primitive["mode"] == 0
        place = scene["accessors"][primitive["attributes"]["POSITION"]]
        view = scene["bufferViews"][place["bufferView"]]
        assert (place["count"], place["type"], place["componentType"]) == (36, "VEC3", 5126)
        found = np.frombuffer(binary, "<f4", 3 * 36, view["byteOffset"]).reshape(36, 3)
        wanted = np.delete(points, 11, 0) * (1, -1, -1)  # y up, z towards the eye
        np.testing.assert_array_equal(found, wanted.astype(np.float32))
        np.testing.assert_array_equal(place["min"], found.min(0).astype(float))
        np.testing.assert_array_equal(place["max"], found.max(0).astype(float))
        assert ("COLOR_0" in primitive["attributes"]) == coloured
        if coloured:
            colour = scene["accessors"][primitive["attributes"]["COLOR_0"]]
            assert (colour["componentType"], colour["type"], colour["normalized"]) == (
                5123,
                "VEC4",
                1,
            )
            at = scene["bufferViews"][colour["bufferView"]]["byteOffset"]
            rgba = np.frombuffer(binary, "<u2", 4 * 36, at).reshape(36, 4) / 65535
            s = np.delete(colours, 11, 0) / 255
            light = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
            np.testing.assert_allclose(rgba[:, :3], light, atol=1e-5)
            assert (rgba[:, 3] == 1).all()


def test_what_is_no_point_cloud(tmp_path: Path) -> None:
    points = np.zeros((4, 3))
    for error, message, words in (
        (ValueError, r"must end in \.glb", (tmp_path / "a.gltf", points)),
        (ShapeError, "Points must have shape", (tmp_path / "a.glb", points[:, :2])),
        (
            ShapeError,
            "Colours must have the shape",
            (tmp_path / "a.glb", points, np.zeros((3, 3), np.uint8)),
        ),
        (ValueError, "uint8", (tmp_path / "a.glb", points, points)),
        (ValueError, "one finite point", (tmp_path / "a.glb", points * np.nan)),
    ):
        with pytest.raises(error, match=message):
            write_glb(*words)
    assert not list(tmp_path.iterdir())
