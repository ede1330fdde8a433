"""Light fields as .npy."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield
from clplen.io.lightfields import array_sources

SHAPE = (3, 5, 7, 11, 3)


def values_of(dtype: object = np.uint8) -> np.ndarray:
    return np.random.default_rng(8).integers(1, 250, SHAPE).astype(dtype)


def test_every_type(tmp_path: Path, device: Device):
    for dtype in ["u1", ">f8", "?"]:
        for fortran in [False, True]:
            values = values_of(dtype)
            np.save(tmp_path / "a.npy", np.asfortranarray(values) if fortran else values)
            lf = read_lightfield(tmp_path / "a.npy", device=device)
            kept = {"u1": np.uint8, ">u2": np.uint16}.get(dtype, np.float32)
            assert lf.dtype == kept
            np.testing.assert_array_equal(lf.to_numpy(), values.astype(kept))


def test_order_and_words(tmp_path: Path, device: Device, caplog: pytest.LogCaptureFixture):
    values = values_of()
    np.save(tmp_path / "a.npy", values.transpose(4, 3, 1, 0, 2))
    with caplog.at_level(logging.INFO, logger="clplen.io"):
        lf = read_lightfield(tmp_path / "a.npy", device=device, order="c:x:u:v:y", flip_v=True)
    np.testing.assert_array_equal(lf.to_numpy(), values[::-1])
    assert "3 x 5 views (V x U) of 7 x 11 x 3 uint8" in caplog.text
    assert "axes c:x:u:v:y (as given), flip_v" in caplog.text
    (tmp_path / "p.csv").write_text(
        "v,u,y,x\n" + "".join(f"{v},{u},{3 * v},{u}\n" for v in range(3) for u in range(5))
    )
    words = {"order": "cxuvy", "flip_v": True, "positions": tmp_path / "p.csv"}
    lf = read_lightfield(tmp_path / "a.npy", device=device, **words)
    np.testing.assert_allclose(lf.positions[0, 4], (3, 2))  # the file's last row of views


def test_blocks(monkeypatch: pytest.MonkeyPatch):
    for size in [1, 3000]:
        for chunks in [None, (1, 2, 3, 4, 5), (3, 5, 7, 11, 3)]:
            monkeypatch.setattr(array_sources, "_BLOCK_BYTES", size)
            met = np.zeros(SHAPE, int)
            for block in array_sources.blocks(SHAPE, chunks, 2):
                met[block] += 1
                whole = [part.start % n for part, n in zip(block, chunks or (1,) * 5, strict=True)]
                assert not any(whole)
                least = 2 * np.prod(np.minimum(chunks or 1, SHAPE))
                assert 2 * met[block].size <= max(size, least)
            assert (met == 1).all()


def test_srgb(tmp_path: Path, device: Device):
    for values in (values_of("u1"), values_of("u2") * 257, values_of("f4") / 255):
        np.save(tmp_path / "a.npy", values)
        lf = read_lightfield(tmp_path / "a.npy", device=device, srgb=True)
        s = values / ({1: 255, 2: 65535}.get(values.dtype.itemsize, 1))
        expected = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
        np.testing.assert_allclose(lf.to_numpy(), expected, rtol=1e-6)  # rounded to float32
    np.save(tmp_path / "a.npy", values_of("u4"))
    with pytest.raises(FormatError, match=r"a\.npy .* uint8, uint16 or floats .* got uint32"):
        read_lightfield(tmp_path / "a.npy", device=device, srgb=True)


def test_what_is_no_light_field(tmp_path: Path, device: Device):
    for values, message in [
        (np.ones((3, 4)), r"must have 4 or 5 dimensions .* got shape \(3, 4\)"),
        (np.ones((1, 2, 3, 4, 5, 6)), "must have 4 or 5 dimensions"),
        (np.ones((2, 0, 3, 3)), "is empty"),
        (np.ones((2, 2, 3, 3), complex), "must hold real numbers, got complex128"),
        (np.full((2, 2, 3, 3), "a"), "must hold real numbers, got <U1"),
        (np.zeros((2, 2, 3, 3), "u1,f4"), "must hold real numbers"),
        (np.full((2, 2, 3, 3), np.inf), "36 samples that are NaN or infinite"),
        (np.full((2, 2, 3, 3), 1e300), "36 samples that are NaN or infinite"),
    ]:
        np.save(tmp_path / "a.npy", values)
        with pytest.raises(FormatError, match=rf"a\.npy: .*{message}"):
            read_lightfield(tmp_path / "a.npy", device=device)


def test_progress(tmp_path: Path, device: Device, capsys: pytest.CaptureFixture[str]):
    np.save(tmp_path / "a.npy", values_of())
    read_lightfield(tmp_path / "a.npy", device=device)
    assert capsys.readouterr().err == ""
    read_lightfield(tmp_path / "a.npy", device=device, progress=True)
    assert "reading: 100%" in capsys.readouterr().err
