"""Files of intrinsics: what is written is read, and what is wrong is one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clplen.errors import FormatError
from clplen.io import read_intrinsics, write_intrinsics
from clplen.lightfield import Intrinsics


def camera() -> Intrinsics:
    """With numbers that no two of are the same."""
    H = np.diag([1.1e-3, 1.2e-3, 2.1e-3, 2.2e-3, 1.0])
    H[0, 2], H[1, 3], H[2, 0], H[3, 1] = 1e-6, -2e-6, -1e-3, -1.3e-3
    H[0, 4] = -H[0, 0] * 1.5 - H[0, 2] * 23.5
    H[1, 4] = -H[1, 1] * 1 - H[1, 3] * 15
    H[2, 4], H[3, 4] = -0.05, -0.04
    views = np.arange(12.0).reshape(3, 4) / 100
    views[1, 2] = np.nan
    boards = np.array([0.01, np.nan, 0.02])
    return Intrinsics(
        H, np.array([0.1, 0.2, 0.3, 0.4, 0.5]), (3, 4, 31, 48), 0.02, (6, 9), 0.025, boards, views,
        np.eye(5) / 7,
    )  # fmt: skip


def test_what_is_written_is_read(tmp_path: Path):
    wanted = camera()
    write_intrinsics(tmp_path / "camera.json", wanted)
    found = read_intrinsics(tmp_path / "camera.json")
    for name in ("matrix", "distortion", "board_rms", "view_rms", "deviations"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    for name in ("shape", "rms", "board", "spacing"):
        assert getattr(found, name) == getattr(wanted, name)
    words = json.loads((tmp_path / "camera.json").read_text())
    assert words["version"] == 1
    assert words["units"]["spacing"] == "metres"
    bare = Intrinsics(wanted.matrix, wanted.distortion, wanted.shape)
    write_intrinsics(tmp_path / "bare.json", bare)
    assert np.isnan(read_intrinsics(tmp_path / "bare.json").rms)


def without(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda words: words.pop(name)


def put(name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda words: words.update({name: value})


def test_what_is_wrong_is_one_sentence(tmp_path: Path):
    for change, message in [
        (put("version", 2), "must have version 1, got 2"),
        (put("format", "other"), "is not a file of intrinsics"),
        (without("matrix"), "has no 'matrix': use 'clplen calibrate'"),
        (without("views"), "has no 'views'"),
        (put("matrix", [[1.0] * 5] * 4), r"matrix must have shape \(5, 5\), got \(4, 5\)"),
        (put("matrix", [[1.0], [1.0, 2.0]]), "matrix must be an array of numbers"),
        (put("matrix", "H"), "matrix must be an array of numbers"),
        (put("matrix", None), "matrix must not be null"),
        (put("matrix", [[None] * 5] * 5), "matrix must be finite"),
        (put("distortion", [0, 0, 0, 0, 0]), "distortion must have the keys b_u, b_v, k1, k2, k3"),
        (put("distortion", dict.fromkeys(("b_u", "b_v", "k1", "k2", "k3"), "x")), "b_u must be"),
        (put("views", [3]), r"views must be two integers, got \[3\]"),
        (put("pixels", [0, 48]), "pixels must be two positive integers"),
        (put("pixels", [31, 50]), "got .*: H has 12 free numbers"),
        (put("spacing", -1), "spacing must be positive"),
        (put("rms", "small"), "rms must be a number"),
        (put("view_rms", [[0.1]]), r"view_rms must have shape \(3, 4\)"),
    ]:
        path = tmp_path / "camera.json"
        write_intrinsics(path, camera())
        words = json.loads(path.read_text())
        change(words)
        path.write_text(json.dumps(words))
        with pytest.raises(FormatError, match=message) as caught:
            read_intrinsics(path)
        assert str(path) in str(caught.value)


def test_what_is_no_file_of_intrinsics(tmp_path: Path):
    for text, message in [
        ('{"format": NaN}', "has the invalid number NaN"),
        ('{"format": -Infinity}', "has the invalid number -Infinity"),
        ("{", "is not valid JSON"),
        ("[1]", "is not a file of intrinsics"),
        ("[" * 100_000, "is not valid JSON"),
        ("\x00\xff", "is not valid JSON"),
    ]:
        path = tmp_path / "camera.json"
        path.write_bytes(text.encode("latin-1"))
        with pytest.raises(FormatError, match=message):
            read_intrinsics(path)


def test_a_missing_file(tmp_path: Path):
    with pytest.raises(FormatError, match=r"Cannot read the intrinsics .*none.json"):
        read_intrinsics(tmp_path / "none.json")
    with pytest.raises(TypeError, match="intrinsics must be an Intrinsics"):
        write_intrinsics(tmp_path / "none.json", np.eye(5))  # type: ignore[arg-type]
    assert not (tmp_path / "none.json").exists()
