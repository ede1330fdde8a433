"""Mosaics: lenslet images, views side by side, ESLF, and what is guessed."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from png_writer import encode

from clplen.compute.device import Device
from clplen.errors import FormatError, ShapeError
from clplen.io import read_lightfield, write_mosaic
from clplen.lightfield.model.light_field import LightField

SHAPE = (3, 5, 13, 11)  # V, U, y, x


def noise(dtype: type = np.uint8, channels: int = 3, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    values = np.random.default_rng(7).integers(1, 250, (*shape, channels)).astype(dtype)
    return (values if channels > 1 else values[..., 0]) * (1 if dtype == np.uint8 else 7)


def scene(d: float, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    """A smooth texture on a plane of disparity d, (D1)."""
    v, u, y, x = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    y, x = y + d * (v - (shape[0] - 1) / 2), x + d * (u - (shape[1] - 1) / 2)
    texture = 2 + np.sin(0.9 * y + 0.2 * x) + 0.7 * np.sin(1.1 * x - 0.3 * y + 1)
    return (50 * texture).astype(np.uint8)


def mosaic(lf: np.ndarray, order: str) -> np.ndarray:
    """By the formulas, one sample after the other."""
    V, U, ny, nx = lf.shape[:4]
    picture = np.empty((V * ny, U * nx, *lf.shape[4:]), lf.dtype)
    for v, u, y, x in np.ndindex(V, U, ny, nx):
        at = (y * V + v, x * U + u) if order == "yvxu" else (v * ny + y, u * nx + x)
        picture[at] = lf[v, u, y, x]
    return picture


def test_16_bit_colour_and_words_of_layout(tmp_path: Path, device: Device):
    values = noise(np.uint16)
    (tmp_path / "a.png").write_bytes(encode(mosaic(values, "vyux")))
    words: dict[str, Any] = {"views": (3, 5), "order": "v:y:u:x:c"}
    lf = read_lightfield(tmp_path / "a.png", device=device, swap_uv=True, flip_u=True, **words)
    np.testing.assert_array_equal(lf.to_numpy(), values.swapaxes(0, 1)[:, ::-1])
    lf = read_lightfield(tmp_path / "a.png", device=device, srgb=True, flip_v=True, **words)
    s = values[::-1] / 65535  # IEC 61966-2-1:1999
    expected = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(lf.to_numpy(), expected, rtol=1e-6)


def test_the_order_is_guessed_and_said(
    tmp_path: Path, device: Device, caplog: pytest.LogCaptureFixture
):
    for order in ["yvxu", "vyux"]:
        for d, views in [(0.3, (3, 5)), (-1.0, (3, 5)), (0.4, (1, 5)), (0.4, (3, 1))]:
            values = scene(d, (*views, 13, 11))
            imageio.imwrite(tmp_path / "a.png", mosaic(values, order))
            caplog.clear()
            with caplog.at_level(logging.INFO, "clplen.io"):
                lf = read_lightfield(tmp_path / "a.png", device=device, views=views)
            np.testing.assert_array_equal(lf.to_numpy(), values)
            assert f"{views[0]} x {views[1]} views (V x U) of 13 x 11 uint8" in caplog.text
            assert f"order '{order}' (guessed from the content)" in caplog.text


def test_what_is_not_taken(tmp_path: Path, device: Device):
    imageio.imwrite(tmp_path / "a.png", noise(channels=3).reshape(39, 55, 3))
    with pytest.raises(FormatError, match=r"a\.png fits equally .* order='yvxu' or order='vyux'"):
        read_lightfield(tmp_path / "a.png", device=device, views=(3, 5))
    imageio.imwrite(tmp_path / "eslf.png", np.full((28, 28, 4), [9, 9, 9, 0], np.uint8))
    with pytest.raises(FormatError, match="transparent at all nonblack pixels"):
        read_lightfield(tmp_path / "eslf.png", device=device)


def test_sizes_that_are_no_multiple(tmp_path: Path, device: Device):
    imageio.imwrite(tmp_path / "a.png", np.ones((37, 55, 3), np.uint8))
    for words, error, message in (
        ({"views": (3, 5)}, FormatError, r"got 37 x 55 .* to 36 or 39 rows and 55 columns"),
        ({"views": (100, 5)}, FormatError, "crop it to 100 rows and 55 columns"),
        ({}, FormatError, r"views in the mosaic .* unknown: give views=\(V, U\)"),
        ({"views": (3, 5), "order": "vuyx"}, ValueError, "must be 'yvxu' or 'vyux' .* got 'vuyx'"),
    ):
        with pytest.raises(error, match=message):
            read_lightfield(tmp_path / "a.png", device=device, **words)


@pytest.mark.parametrize(("dtype", "alpha"), [(np.uint8, False), (np.uint16, True)])
def test_eslf(tmp_path: Path, device: Device, dtype: type, alpha: bool):
    """Padded from 40 x 54 to 42 x 56: 3 x 4 lenslets of 14 x 14 views."""
    values = noise(dtype, 3, (14, 14, 3, 4))
    values[0, 0] = 0
    picture = mosaic(values, "yvxu")[:40, :54]
    weights = np.ones((14, 14))
    weights[0, 0] = 0
    if alpha:
        full = np.iinfo(dtype).max
        opaque = np.full((14, 14, 3, 4, 1), full, dtype)
        opaque[1, 2] = full // 5
        opaque[13, 13, 0] = 0
        picture = np.concatenate([picture, mosaic(opaque, "yvxu")[:40, :54]], axis=2)
        weights[1, 2] = 1 / 5
        # rows y = 2 of the views v = 12, 13 and columns x = 3 of u = 12, 13 are padding
        weights[12:] *= 2 / 3
        weights[:, 12:] *= 3 / 4
        weights[13, 13] = (3 / 12) if alpha else 1
    (tmp_path / "IMG_7_eslf.png").write_bytes(encode(picture))
    lf = read_lightfield(tmp_path / "IMG_7_eslf.png", device=device)
    values[12:, :, 2] = 0
    values[:, 12:, :, 3] = 0
    assert lf.dtype == dtype
    np.testing.assert_array_equal(lf.to_numpy(), values)
    # 8 bits: a fifth of 255 is exact; float32 after that
    np.testing.assert_allclose(lf.weights, weights, atol=1e-6)
    lf = read_lightfield(tmp_path / "IMG_7_eslf.png", device=device, flip_v=True, swap_uv=True)
    np.testing.assert_allclose(lf.weights, weights.T[::-1], atol=1e-6)


@pytest.mark.parametrize("words", [{}, {"white": "w.tif"}])
def test_what_is_a_raw_image(
    tmp_path: Path, device: Device, words: dict[str, Any], monkeypatch: pytest.MonkeyPatch
):
    frame = noise(np.uint16, 1)[0, 0]
    imageio.imwrite(tmp_path / "a.png", frame)
    seen = []

    def decode(values, path, *, device, layout, progress):
        seen.append((values, path, layout.user_options()))
        return LightField.from_array(noise(), device=device), "a raw image"

    monkeypatch.setattr("clplen.io.lightfields.mosaic.decode_frame", decode)
    read_lightfield(tmp_path / "a.png", device=device, **words)
    np.testing.assert_array_equal(seen[0][0], frame)
    assert seen[0][1:] == (tmp_path / "a.png", words)
    imageio.imwrite(tmp_path / "a.png", noise()[0, 0])
    if words:
        with pytest.raises(FormatError, match="must have one channel, got 3"):
            read_lightfield(tmp_path / "a.png", device=device, **words)


def test_written(tmp_path: Path, device: Device):
    for dtype, channels, name in [
        (np.uint8, 3, "a.png"),
        (np.float32, 1, "a.tif"),
    ]:
        for order in ["yvxu", "vyux"]:
            lf = LightField.from_array(noise(dtype, channels), device=device)
            write_mosaic(tmp_path / name, lf, order=order)
            read = imageio.imread if name.endswith("png") else tifffile.imread
            np.testing.assert_array_equal(read(tmp_path / name), mosaic(lf.to_numpy(), order))
            again = read_lightfield(tmp_path / name, device=device, views=(3, 5), order=order)
            np.testing.assert_array_equal(again.to_numpy(), lf.to_numpy())


def test_what_cannot_be_written(tmp_path: Path, device: Device):
    lf = LightField.from_array(noise(np.uint16), device=device)
    with pytest.raises(ValueError, match=r"a\.png cannot hold uint16 of shape \(39, 55, 3\)"):
        write_mosaic(tmp_path / "a.png", lf)
    with pytest.raises(ValueError, match="'vyux' for a mosaic"):
        write_mosaic(tmp_path / "a.tif", lf, order="vuyx")
    with pytest.raises(ShapeError, match="1 or 3 channels, got 2"):
        write_mosaic(tmp_path / "a.tif", LightField.from_array(noise(channels=2), device=device))
    assert not list(tmp_path.iterdir())
