"""Single pictures: values as stored, and files that declare more than they hold."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zlib
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from png_writer import SIGNATURE, chunk, encode, header

from clplen.errors import FormatError
from clplen.io.formats.picture import decode_picture, read_channels, read_picture

SHAPE = (7, 11)


def values(dtype: str = "u1", channels: int = 1) -> np.ndarray:
    shape = SHAPE + ((channels,) if channels > 1 else ())
    return np.random.default_rng(3).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


def tiff(array: np.ndarray, **words) -> bytes:
    file = io.BytesIO()
    tifffile.imwrite(file, array, metadata=None, **words)
    return file.getvalue()


def test_a_picture_with_a_long_hole(tmp_path: Path):
    for head, message in [
        (encode(values()), r"a\.png has 1,073,741,824 bytes, far more than"),
        (b"no picture", r"a\.png is unreadable \(it is not PNG"),
    ]:
        with (tmp_path / "a.png").open("wb") as file:
            file.write(head)
            file.truncate(1 << 30)
        tracemalloc.start()
        with pytest.raises(FormatError, match=message):
            read_picture(tmp_path / "a.png")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1 << 22


def test_png():
    for channels in [2, 3, 4]:
        for kinds in [[2], [4, 3, 1, 0, 2]]:
            expected = values("u2", channels)
            again = decode_picture(encode(expected, kinds), "a.png")
            assert again.dtype == np.uint16
            np.testing.assert_array_equal(again, expected)
    for shape in [(1, 9, 4), (1031, 3, 3)]:  # 1031 rows: more than are decoded together
        expected = np.random.default_rng(1).integers(0, 65536, shape).astype(np.uint16)
        np.testing.assert_array_equal(decode_picture(encode(expected, [4, 2]), "a.png"), expected)
    for expected in (*(values("u1", channels) for channels in (1, 2, 3, 4)), values("u2")):
        np.testing.assert_array_equal(decode_picture(encode(expected), "a.png"), expected)


def test_damaged_png_of_16_bit_colour():
    whole = encode(values("u2", 3))
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 16
    end, rows = chunk(b"IEND", b""), chunk(b"IDAT", zlib.compress(b"\5" + bytes(6)))
    for content, message in (
        *((whole[:kept], "") for kept in (8, 20, 33, 60, len(whole) // 2, len(whole) - 30)),
        (bytes(flipped), r" \(it is truncated or damaged"),
        (SIGNATURE + header(1, 1, 16, 2) + rows + end, ".*unknown filter"),
        (SIGNATURE + header(1, 1, 16, 2, 1) + rows + end, ".*interlaced PNG of 16-bit colour"),
        (SIGNATURE + header(2, 3, 16, 2) + rows + end, ".*it is truncated"),
    ):
        with pytest.raises(FormatError, match=rf"a\.png is unreadable{message}"):
            decode_picture(content, "a.png")


def test_tiff():
    for dtype in ["u1", "u2"]:
        for words in [
            {"compression": "zlib", "predictor": True, "rowsperstrip": 3},
            {"byteorder": ">"},
            {"bigtiff": True},
            {"tile": (128, 64), "compression": "zlib", "predictor": True},
        ]:
            for channels, colour in ((1, "minisblack"), (3, "rgb")):
                content = tiff(values(dtype, channels), photometric=colour, **words)
                again = decode_picture(content, "a.tif")
                assert again.dtype == np.dtype(dtype)
                np.testing.assert_array_equal(again, values(dtype, channels))


def test_tiff_of_others():
    floats = values("u2", 3).astype(np.float32)
    np.testing.assert_array_equal(decode_picture(tiff(floats, photometric="rgb"), "a"), floats)
    planes = values("u2", 3)
    content = tiff(planes.transpose(2, 0, 1), photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(decode_picture(content, "a"), planes)
    bits = values() > 99
    np.testing.assert_array_equal(decode_picture(tiff(bits, photometric="minisblack"), "a"), bits)
    written = imageio.imwrite(
        "<bytes>", values("u1", 3), extension=".tif", plugin="pillow", compression="tiff_lzw"
    )
    np.testing.assert_array_equal(decode_picture(written, "a"), values("u1", 3))


def test_tiff_that_is_no_single_picture():
    grey, colours = {"photometric": "minisblack"}, np.zeros((3, 256), np.uint16)
    for content, message in (
        (tiff(np.zeros((3, 20, 30), np.uint8), **grey), "it must have one picture, got 3"),
        (tiff(np.ones((4, 5), np.complex64), **grey), "must have real samples, got complex64"),
        (tiff(values(), photometric="palette", colormap=colours), "it has a colour table"),
        (tiff(values(), **grey, compression="lzma"), "34925; write it with deflate or none"),
    ):
        with pytest.raises(FormatError, match=message):
            decode_picture(content, "a.tif")


def test_pgm_and_ppm():
    for dtype, channels in [("u1", 3), ("u2", 1)]:
        expected = values(dtype, channels) // 2  # the highest value is not that of the type
        highest = np.iinfo(dtype).max // 2
        start = f"P{6 if channels == 3 else 5} # made by hand\n{SHAPE[1]}\n{SHAPE[0]} {highest}\n"
        content = start.encode() + expected.astype(expected.dtype.newbyteorder(">")).tobytes()
        again = decode_picture(content, "a.pgm")
        assert again.dtype == np.dtype(dtype)
        np.testing.assert_array_equal(again, expected)
        with pytest.raises(FormatError, match="it is truncated"):
            decode_picture(content[:-1], "a.pgm")


def test_other_kinds():
    for suffix in [".jpg", ".bmp"]:
        for channels in (1, 3):
            content = imageio.imwrite("<bytes>", values("u1", channels), extension=suffix)
            np.testing.assert_array_equal(
                decode_picture(content, f"a{suffix}"), imageio.imread(content, extension=suffix)
            )


def test_alpha(tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(encode(values("u1", 4)))
    np.testing.assert_array_equal(read_channels(path), values("u1", 4))
    with pytest.raises(FormatError, match="transparent pixels"):
        read_picture(path)
    opaque = values("u1", 4)
    opaque[..., 3] = 255
    path.write_bytes(encode(opaque))
    np.testing.assert_array_equal(read_picture(path), opaque[..., :3])


def with_tags(content: bytes, tags: dict[int, int]) -> bytes:
    """A little-endian TIFF with other values of tags: each a 32-bit number."""
    changed = bytearray(content)
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        for code, value in tags.items():
            at = file.pages.first.tags[code].offset
            changed[at : at + 12] = struct.pack("<HHII", code, 4, 1, value)
    return bytes(changed)


def bombs() -> dict[str, bytes]:
    """Pictures of a few bytes that declare gigabytes."""
    side = 30_000
    idat = chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    jpeg = bytearray(imageio.imwrite("<bytes>", values("u1", 3), extension=".jpg"))
    size = jpeg.index(b"\xff\xc0") + 5
    jpeg[size : size + 4] = struct.pack(">HH", side, side)
    bmp = bytearray(imageio.imwrite("<bytes>", values("u1", 3), extension=".bmp"))
    bmp[18:26] = struct.pack("<ii", side, side)
    small = tiff(values(), photometric="minisblack", compression="zlib", rowsperstrip=7)
    wide = with_tags(small, {256: side, 257: side, 278: side})
    return {
        "png": SIGNATURE + header(side, side, 8, 2) + idat,
        "png16": SIGNATURE + header(side, side, 16, 6) + idat,
        "bits": SIGNATURE + header(2**31 - 1, 2**31 - 1, 1, 3) + idat,
        "jpeg": bytes(jpeg),
        "bmp": bytes(bmp),
        "ppm": b"P6 999999999 999999999 65535\n",
        "tiff": wide,
    }


def test_more_declared_than_stored():
    for kind in list(bombs()):
        content = bombs()[kind]
        tracemalloc.start()
        with pytest.raises(
            FormatError, match=r"a\.x: the picture declares .* bytes, more than .* can"
        ):
            decode_picture(content, "a.x")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 4 * len(content) + (1 << 20)


def test_a_strip_that_inflates_to_more_than_declared():
    small = tiff(np.zeros((4, 4), np.uint8), photometric="minisblack", compression="zlib")
    strip = zlib.compress(bytes(40 << 20))
    content = with_tags(small, {273: len(small), 279: len(strip)}) + strip
    tracemalloc.start()
    with pytest.raises(FormatError, match="inflates to more than it declares"):
        decode_picture(content, "a.tif")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 << 20


def test_tiles_much_larger_than_the_picture():
    content = tiff(values(), photometric="minisblack", compression="zlib", tile=(16, 16))
    wide = with_tags(content, {322: 1 << 20, 323: 1 << 20})
    with pytest.raises(FormatError, match=r"its tiles of .* are much larger than the picture"):
        decode_picture(wide, "a.tif")


def test_more_than_the_given_limit():
    decode_picture(encode(values("u1", 3)), "a.png", max_bytes=7 * 11 * 3)
    for content in (encode(values("u1", 3)), tiff(values("u1", 3), photometric="rgb")):
        with pytest.raises(FormatError, match=r"needs 231 bytes, more than 230 \(the given limit"):
            decode_picture(content, "a", max_bytes=230)


def test_more_pixels_than_pillow_reads():
    rows = chunk(b"IDAT", zlib.compress(bytes(10_001 * 10_000 // 8), 1))
    with pytest.raises(FormatError, match=r"is unreadable \(100,000,000 pixels exceed Pillow"):
        decode_picture(SIGNATURE + header(10_000, 10_000, 1, 0) + rows, "a.png")
