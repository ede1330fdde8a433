"""MATLAB files of version 5, written by SciPy."""

from __future__ import annotations

import logging
import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield
from clplen.io.lightfields import array_sources

SHAPE = (3, 5, 7, 11, 3)


def values_of(shape: tuple[int, ...] = SHAPE, dtype: Any = np.uint16) -> np.ndarray:
    return np.random.default_rng(8).integers(1, 250, shape).astype(dtype)


def test_every_type(tmp_path: Path, device: Device):
    for dtype in ["u2", "f8", "i4", "?"]:
        for pressed in [True, False]:
            values = values_of(dtype=dtype)
            words = {"x": np.eye(3), "s": {"a": "b"}, "c": np.array([1, "a"], object), "t": "text"}
            savemat(tmp_path / "a.mat", words | {"LF": values, "z": values}, do_compression=pressed)
            lf = read_lightfield(tmp_path / "a.mat", device=device)
            assert lf.dtype == (np.float32 if dtype not in ("u1", "u2") else dtype)
            np.testing.assert_array_equal(lf.to_numpy(), values)


def test_weights(tmp_path: Path, device: Device):
    for dtype, channels in [(np.uint16, 2), (np.float32, 4)]:
        values = values_of((*SHAPE[:4], channels), dtype)
        values[2, 4, ..., -1] = 0
        values[1, 3, ..., :-1] = 0
        savemat(tmp_path / "a.mat", {"LF": values}, do_compression=True)
        lf = read_lightfield(tmp_path / "a.mat", device=device, swap_uv=True, flip_u=True)
        colours = values[..., 0] if channels == 2 else values[..., :3]
        np.testing.assert_array_equal(lf.to_numpy(), colours.swapaxes(0, 1)[:, ::-1])
        weights = values[..., -1].mean(axis=(2, 3)) / (1 if dtype == np.float32 else 65535)
        weights[1, 3] = 0  # dark throughout
        np.testing.assert_allclose(lf.weights, weights.T[:, ::-1], rtol=1e-6)


def test_several_blocks(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch):
    for block in [100, 1500]:
        monkeypatch.setattr(array_sources, "_BLOCK_BYTES", block)
        values = values_of((3, 2, 7, 11, 4))
        values[:, :, 2:5, :, 1] = 7  # a run that packs well
        savemat(tmp_path / "a.mat", {"LF": values}, do_compression=True)
        lf = read_lightfield(tmp_path / "a.mat", device=device)
        np.testing.assert_array_equal(lf.to_numpy(), values[..., :3])
        weights = values[..., 3].mean(axis=(2, 3)) / 65535
        np.testing.assert_allclose(lf.weights, weights, rtol=1e-6)


def test_which_variable_and_order(tmp_path: Path, device: Device, caplog: pytest.LogCaptureFixture):
    values = values_of((2, 3, 5, 4, 2))
    savemat(tmp_path / "a.mat", {"rays": values, "x": np.eye(3)})
    with caplog.at_level(logging.INFO, logger="clplen.io"):
        lf = read_lightfield(tmp_path / "a.mat", device=device, order="cvuyx")
    np.testing.assert_array_equal(lf.to_numpy(), values.transpose(1, 2, 3, 4, 0))
    assert "the variable 'rays' with axes c:v:u:y:x (as given)" in caplog.text
    savemat(tmp_path / "a.mat", {"rays": values, "more": 2 * values, "s": "text"})
    lf = read_lightfield(tmp_path / "a.mat", device=device, dataset="more")
    np.testing.assert_array_equal(lf.to_numpy(), 2 * values)
    with pytest.raises(FormatError, match="no variable 's' of real numbers; it has rays"):
        read_lightfield(tmp_path / "a.mat", device=device, dataset="s")


def test_what_is_no_light_field(tmp_path: Path, device: Device):
    for values in [np.ones((2, 2, 3, 3), complex), np.ones((5, 3)), np.zeros(0)]:
        savemat(tmp_path / "a.mat", {"LF": values})
        with pytest.raises(FormatError, match=r"a\.mat(:| has) .*(LF|'LF' has shape \(5, 3\))"):
            read_lightfield(tmp_path / "a.mat", device=device)


def element(kind: int, data: bytes, order: str = "<") -> bytes:
    """An element; one of up to 4 bytes in its short form."""
    if 0 < len(data) <= 4:
        return struct.pack(f"{order}I", len(data) << 16 | kind) + data.ljust(4, b"\0")
    return struct.pack(f"{order}2I", kind, len(data)) + data.ljust(-(-len(data) // 8) * 8, b"\0")


def matrix(
    kind: int, shape: tuple[int, ...], packed: int, data: bytes, order: str = "<", name: str = "LF"
) -> bytes:
    """A variable of a class, its samples stored as another type."""
    flags = element(6, struct.pack(f"{order}2I", kind, 0), order)
    sizes = element(5, np.array(shape, f"{order}i4").tobytes(), order)
    parts = flags + sizes + element(1, name.encode(), order) + element(packed, data, order)
    return element(14, parts, order)


def header(order: str = "<") -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + (b"\x00\x01IM" if order == "<" else b"\x01\x00MI")


def test_doubles_that_matlab_stores_as_bytes(tmp_path: Path, device: Device):
    for order in ["<", ">"]:
        shape = (2, 3, 200, 201)  # so large that eight times the stored bytes have to be allowed
        values = values_of(shape)
        for packed, dtype in ((2, "u1"), (4, f"{order}u2")):
            data = values.astype(dtype).tobytes("F")
            (tmp_path / "a.mat").write_bytes(header(order) + matrix(6, shape, packed, data, order))
            lf = read_lightfield(tmp_path / "a.mat", device=device)
            assert lf.dtype == np.float32
            np.testing.assert_array_equal(lf.to_numpy(), values)
        small = matrix(9, (1, 2, 1, 2), 2, bytes([1, 2, 3, 4]), order, name="a_longer_name")
        (tmp_path / "a.mat").write_bytes(header(order) + small)
        lf = read_lightfield(tmp_path / "a.mat", device=device)
        np.testing.assert_array_equal(lf.to_numpy().ravel(), [1, 3, 2, 4])


def test_a_size_that_is_not_there(tmp_path: Path, device: Device):
    short = matrix(9, (2, 2, 900, 900), 2, bytes(100))
    (tmp_path / "a.mat").write_bytes(header() + short)
    with pytest.raises(FormatError, match="100 bytes for LF of size"):
        read_lightfield(tmp_path / "a.mat", device=device)
    size = struct.pack("<2I", 2, 3_240_000)
    lies = short.replace(struct.pack("<2I", 2, 100), size)
    (tmp_path / "a.mat").write_bytes(header() + lies)
    with pytest.raises(FormatError, match="declares 3,240,000 bytes, more than 160 stored"):
        read_lightfield(tmp_path / "a.mat", device=device)
    packed = zlib.compress(lies)
    (tmp_path / "a.mat").write_bytes(header() + struct.pack("<2I", 15, len(packed)) + packed)
    with pytest.raises(FormatError, match="declares 3,240,000 bytes, more than"):
        read_lightfield(tmp_path / "a.mat", device=device)


def test_a_stream_that_goes_on_is_not_inflated(tmp_path: Path, device: Device):
    shape = (2, 2, 8, 8)
    bomb = zlib.compress(matrix(9, shape, 2, bytes(256)) + bytes(1 << 26), 9)
    (tmp_path / "a.mat").write_bytes(header() + struct.pack("<2I", 15, len(bomb)) + bomb)
    tracemalloc.start()
    try:
        lf = read_lightfield(tmp_path / "a.mat", device=device)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert lf.shape == shape
    assert peak < 1 << 24
    with pytest.raises(FormatError, match="needs 256 bytes, more than 99"):
        read_lightfield(tmp_path / "a.mat", device=device, max_bytes=99)


def test_classes_without_numbers_are_refused(tmp_path: Path, device: Device):
    for kind in [1, 5, 17, 99]:
        (tmp_path / "a.mat").write_bytes(header() + matrix(kind, (2, 2, 3, 3), 2, bytes(36)))
        with pytest.raises(FormatError, match=r"a\.mat has no variable of real numbers"):
            read_lightfield(tmp_path / "a.mat", device=device)
