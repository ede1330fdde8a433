"""Point clouds: the file byte by byte, and the pinhole by hand."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from clplen.errors import FormatError, ShapeError
from clplen.io.formats.ply import points_of, read_ply, write_ply

POINTS = np.array([[1, 2, 3], [4, np.nan, 6], [7, 8, np.inf], [-1.5, 0.25, 9]])
COLOURS = np.array([[10, 20, 30], [1, 1, 1], [2, 2, 2], [255, 0, 128]], np.uint8)


def test_the_file_is_what_the_format_says(tmp_path: Path):
    write_ply(tmp_path / "a.ply", POINTS, COLOURS, comment="metres\nof a test")
    header = (
        b"ply\nformat binary_little_endian 1.0\ncomment Written by clplen\n"
        b"comment metres\ncomment of a test\n"
        b"element vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
        b"property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    )
    body = struct.pack("<3f3B", 1, 2, 3, 10, 20, 30) + struct.pack(
        "<3f3B", -1.5, 0.25, 9, 255, 0, 128
    )
    assert (tmp_path / "a.ply").read_bytes() == header + body


def test_without_colours(tmp_path: Path):
    write_ply(tmp_path / "a.ply", np.array([[1, 2, 3], [1e300, 0, 0]]))  # float32 cannot hold it
    content = (tmp_path / "a.ply").read_bytes()
    assert b"red" not in content
    assert content.count(b"comment") == 1
    assert content.endswith(b"end_header\n" + struct.pack("<3f", 1, 2, 3))


def test_what_cannot_be_written(tmp_path: Path):
    path = tmp_path / "a.ply"
    refused(
        (
            ValueError,
            r"must end in \.ply .* got .*a\.obj",
            lambda: write_ply(tmp_path / "a.obj", POINTS),
        ),
        (ShapeError, r"\(n, 3\), got \(4, 2\)", lambda: write_ply(path, POINTS[:, :2])),
        (
            ShapeError,
            r"\(4, 3\) of the points, got \(3, 3\)",
            lambda: write_ply(path, POINTS, COLOURS[1:]),
        ),
        (ValueError, "uint8, got float64", lambda: write_ply(path, POINTS, COLOURS / 255)),
        (ValueError, "must be ASCII", lambda: write_ply(path, POINTS, comment="µm")),
    )
    assert not path.exists()


def test_a_point_projects_back():
    """A point in space, seen at pixel (31, 45) and, one baseline to the right, elsewhere."""
    b, f, p, z0, z = 0.02, 0.05, 1e-5, 2.0, 1.6
    place = np.array([(45 - 30) * p * z / f, (31 - 19.5) * p * z / f, z])
    seen, neighbour = ((place[0] - eye) * f / (z * p) for eye in (0, b))
    d = seen - neighbour - b * f / (z0 * p)  # the shift of the focused plane is taken off
    points, comment = points_of(
        np.full((40, 61), d), baseline=b, focal_length=f, pixel_pitch=p, focus_distance=z0
    )
    np.testing.assert_allclose(points[31 * 61 + 45], place, rtol=1e-12)
    assert "metres" in comment


def test_points_behind_the_camera_are_nan():
    points, _ = points_of(
        np.array([[1.0, 0.0, -1.0, np.nan]]), baseline=1, focal_length=1, pixel_pitch=0.5
    )
    np.testing.assert_array_equal(points[0], (-1.5, 0, 2))
    assert np.isnan(points[1:]).all()


def test_without_a_camera():
    d = np.array([[1.0, 2.0], [3.0, np.nan], [5.0, 6.0]])
    points, comment = points_of(d)
    np.testing.assert_array_equal(points[2], (0, 1, 3))
    np.testing.assert_array_equal(points[5], (1, 2, 6))
    assert "disparity" in comment


def test_half_a_camera():
    d, lengths = np.zeros((2, 2)), "need baseline=, focal_length= and pixel_pitch="
    zero = {"baseline": 1, "focal_length": 0, "pixel_pitch": 1}
    refused(
        (ValueError, lengths, lambda: points_of(d, baseline=1)),
        (ValueError, lengths, lambda: points_of(d, focus_distance=1)),
        (ValueError, "focal_length must be positive", lambda: points_of(d, **zero)),
        (ShapeError, r"\(y, x\), got \(3,\)", lambda: points_of(np.zeros(3))),
    )


HEADS = [
    b"", b"ply", b"ply\nformat", b"ply\nformat ascii 1.0\nelement vertex 1",
    b"element vertex 1\nply", b"ply\nformat binary_little_endian 1.0\nelement",
    b"ply\nformat binary_little_endian 1.0\nelement vertex",
    b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty",
    b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float",
    b"ply\nformat binary_little_endian 1.0\nelement vertex -1\nproperty float x",
    b"ply\nformat binary_little_endian 1.0\nelement vertex 1" + b"0" * 400,
    b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty list uchar int x",
    b"ply\nformat binary_little_endian 1.0\nelement vertex 1" + b"\nproperty float x" * 2,
]  # fmt: skip


def test_heads_that_are_none(tmp_path: Path):
    for head in HEADS:
        path = tmp_path / "a.ply"
        for end in (b"end_header\n", b"\nend_header\n", b"\nend_header\n" + bytes(64)):
            path.write_bytes(head + end)
            with pytest.raises(FormatError, match=r"a\.ply"):
                read_ply(path)
