"""Lytro containers, built here byte by byte, and raw images with JSON."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from lytro_files import START, a_container, content, contents_of, f01, illum, packed12

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io import read_lightfield
from clplen.io.formats.packing import Packing, unpack
from clplen.io.lightfields import lytro_files
from clplen.io.lightfields.layout import Layout
from clplen.io.raw import lytro_container
from clplen.io.raw.lytro_container import read_container


@pytest.fixture
def frame() -> np.ndarray:
    return np.random.default_rng(7).integers(0, 1024, (5, 12)).astype(np.uint16)


def test_both_cameras_in_both_generations(tmp_path: Path, frame: np.ndarray):
    for newer in [False, True]:
        frame[1, 3] = 0
        frame[4, 11] = 1023
        for write, bayer in ((f01, "BGGR"), (illum, "GRBG")):
            path = a_container(tmp_path / "a.lfr", *write(frame), newer=newer)
            read, filters = read_container(path)
            assert read.dtype == np.uint16
            np.testing.assert_array_equal(read, frame)
            assert filters == bayer


def test_the_stored_image_takes_no_memory(tmp_path: Path):
    frame = np.arange(1000 * 1600, dtype=np.uint16).reshape(1000, 1600) % 1000
    for write in (f01, illum):
        path = a_container(tmp_path / "a.lfp", *write(frame), newer=True)
        tracemalloc.start()
        read = read_container(path)[0]
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        np.testing.assert_array_equal(read, frame)
        assert peak < 1.4 * frame.nbytes


def test_samples_of_other_widths():
    for bits, order in [(8, "big"), (16, "big"), (16, "little")]:
        frame = np.random.default_rng(1).integers(0, 2**bits, (3, 5))
        stored = frame.astype(f"{'>' if order == 'big' else '<'}u{bits // 8}").tobytes()
        read = unpack(np.frombuffer(stored, np.uint8), Packing(5, 3, bits, order))
        np.testing.assert_array_equal(read, frame)
    odd = np.array([[1, 2, 4095]], np.uint16)  # an odd number of pixels of 12 bits
    stored = packed12(np.append(odd, 0))
    size = Packing(3, 1, 12, "big")
    assert size.stored == len(stored) == 6
    np.testing.assert_array_equal(unpack(np.frombuffer(stored, np.uint8), size), odd)


def test_raw_and_json_lie_side_by_side(tmp_path: Path, frame: np.ndarray):
    for suffix in [".json", ".TXT"]:
        raw, metadata = f01(frame)
        (tmp_path / "a.raw").write_bytes(raw)
        # as in the cameras' own calibration archive
        nested = {"master": {"picture": {"frameArray": [{"frame": {"metadata": metadata}}]}}}
        text = tmp_path / f"a{suffix}"
        text.write_bytes(json.dumps(nested).encode() + b"\0")
        for path in (tmp_path / "a.raw", text):
            read, filters = read_container(path)
            np.testing.assert_array_equal(read, frame)
            assert filters == "BGGR"


def test_a_raw_file_without_json(tmp_path: Path):
    (tmp_path / "a.raw").write_bytes(bytes(100))
    with pytest.raises(
        FormatError, match=r"a\.raw: the size of the raw .* unknown.*100 bytes.*JSON"
    ):
        read_container(tmp_path / "a.raw")
    (tmp_path / "b.json").write_text("{}")
    with pytest.raises(FormatError, match=r"b\.raw is not in its folder"):
        read_container(tmp_path / "b.json")


def titles_of(path: Path) -> list[tuple[str, int]]:
    """What the table of contents calls each section, and its length."""
    with path.open("rb") as file:
        sections = list(lytro_container._sections(path, file))
        return lytro_container._titles(sections, lytro_container._table(path, file, sections))


def test_a_container_without_a_raw_image(tmp_path: Path):
    pictures = [content(bytes([i]) * 40) for i in range(15)]
    array = [{"imageRef": name.decode(), "lambda": 2.5} for _, name, _ in pictures]
    table = {"picture": {"accelerationArray": [{"vendorContent": {"imageArray": array}}]}}
    head = (b"M", *content(json.dumps(table).encode())[1:])
    path = tmp_path / "a-stk.lfp"
    path.write_bytes(contents_of([head, *pictures]))
    titles = titles_of(path)
    assert titles[0][0] == "the table of contents"
    assert titles[3] == ("picture.accelerationArray[0].vendorContent.imageArray[2].imageRef", 40)
    match = r"no raw image, only the table.*imageArray\[0\]\.imageRef \(40 bytes\).*and 4 more sec"
    with pytest.raises(FormatError, match=match):
        read_container(path)


def test_empty_sections_and_long_padding(tmp_path: Path, frame: np.ndarray):
    path = a_container(tmp_path / "a.lfp", *f01(frame), newer=False)
    whole = path.read_bytes()
    place = whole.index(b"\x89LFC")
    empty = b"\x89LFC\r\n\x1a\n" + bytes(8)
    path.write_bytes(whole[:place] + empty + bytes(70000) + whole[place:])
    np.testing.assert_array_equal(read_container(path)[0], frame)
    assert ("an empty section", 0) in titles_of(path)


def damaged(path: Path, old: bytes, new: bytes, *, last: bool = False) -> None:
    whole = path.read_bytes()
    place = whole.rindex(old) if last else whole.index(old)
    path.write_bytes(whole[:place] + new + whole[place + len(old) :])


def test_damaged_containers_say_where(tmp_path: Path, frame: np.ndarray):
    path = tmp_path / "a.lfp"
    for damages, match in [
        ([], r"section 3 at byte .*declares 2 bytes, but 0 remain: the file is truncated"),
        ([(b"\x89LFC", b"\x89LFX", False)], r"section 1 at byte \d+ must begin with"),
        ([(b"\x89LFM", b"\x89LFC", False)], "no table of contents among its 4 sections"),
        # of the private metadata, which are not needed, and of the metadata
        ([(b"sha1-", b"sha2-", True), (b"sha1-", b"sha9-", True)],
         r"refers to metadataRef 'sha1-.*but no section has this name"),
        ([(b'{"picture"', b'["picture"', False)], "the table of contents is not valid JSON"),
        ([(b"\0\0\0\1", b"\0\0\0\2", False)], "not begin as a Lytro container of version 1"),
    ]:  # fmt: skip
        a_container(path, *f01(frame), newer=False)
        for old, new, last in damages:
            read_container(path)
            damaged(path, old, new, last=last)
        if not damages:
            path.write_bytes(path.read_bytes()[:-30])
        with pytest.raises(FormatError, match=match):
            read_container(path)


def test_metadata_that_cannot_be(tmp_path: Path, frame: np.ndarray):
    for key, value, match in [
        ("width", 13, r"13 x 5 pixels in 12 bits must have 99 bytes, got 90"),
        ("width", 11, r"11 x 5 pixels in 12 bits must have 84 bytes, got 90"),
        ("width", 2**31, r"image\.width of the metadata must be .* got 2147483648"),
        ("height", -5, r"image\.height of the metadata must be .* got -5"),
        ("height", True, r"image\.height of the metadata must be .* got True"),
        ("height", None, r"image\.height of the metadata must be .* got None"),
        (
            "pixelPacking",
            {"bitsPerPixel": 14, "endianness": "big"},
            "pixels must have .* got 14 bits .* 'big'",
        ),
        (
            "pixelPacking",
            {"bitsPerPixel": [], "endianness": {}},
            r"pixels must have .* got \[\] bits",
        ),
        (
            "mosaic",
            {"tile": "c,m:y,k", "upperLeftPixel": "c"},
            "colour filters must be .* got 'c,m:y,k'",
        ),
    ]:
        raw, metadata = f01(frame)
        metadata["image"][key] = value
        path = a_container(tmp_path / "a.lfp", raw, metadata, newer=False)
        with pytest.raises(FormatError, match=match):
            read_container(path)


def test_json_that_would_fill_the_stack_or_the_memory(tmp_path: Path):
    path = tmp_path / "a.lfp"
    for table, match in (
        (b"[" * 100000, "is not valid JSON"),
        (b" " * (3 << 20), "longer than 2,097,152"),
    ):
        path.write_bytes(contents_of([(b"M", *content(table)[1:])]))
        with pytest.raises(FormatError, match=match):
            read_container(path)


def test_max_bytes_limits_the_frame(tmp_path: Path, frame: np.ndarray):
    path = a_container(tmp_path / "a.lfp", *f01(frame), newer=False)
    with pytest.raises(FormatError, match=r"the raw image needs 120 bytes, more than 100"):
        read_container(path, max_bytes=100)


def test_the_white_image_is_the_users(
    tmp_path: Path, frame: np.ndarray, monkeypatch, device: Device
):
    path = a_container(tmp_path / "a.lfr", *illum(frame), newer=True)
    with pytest.raises(FormatError, match=r"no calibration is known.*--calibration.*by --white"):
        read_lightfield(path, device=device)
    given = {}

    def decode_frame(frame: np.ndarray, path: Path, **words: object) -> tuple[str, str]:
        given.update(words, frame=frame, path=path)
        return "light field", "sentence"

    monkeypatch.setattr(lytro_files, "decode_frame", decode_frame)
    read = lytro_files.read_lytro
    assert read(path, device=device, layout=Layout(grid="g.json"))[0] == "light field"
    np.testing.assert_array_equal(given["frame"], frame)
    assert given["layout"] == Layout(grid="g.json")
    assert given["capture"].bayer == "GRBG"
    read(path, device=device, layout=Layout(grid="g.json", bayer="RGGB"))
    assert given["layout"].bayer == "RGGB"


def test_a_container_becomes_a_light_field(tmp_path: Path, device: Device):
    """White image and scene in containers; the scene is even, so that all its views are, too."""
    y, x = np.mgrid[:80, :96]
    waves = np.cos(2 * np.pi * (y - 40.2) / 10) + np.cos(2 * np.pi * (x - 47.6) / 10)
    white = (500 + 200 * waves).astype(np.uint16)
    for name, frame in (("white", white), ("scene", white // 2)):
        a_container(tmp_path / f"{name}.lfr", *illum(frame), newer=True)
    words = {"white": tmp_path / "white.lfr", "device": device, "views": (5, 5)}
    lf = read_lightfield(tmp_path / "scene.lfr", **words)
    assert lf.shape[:2] == (5, 5)
    assert lf.shape[4] == 3  # GRBG of the metadata
    inside = lf.to_numpy()[:, :, 1:-1, 1:-1]
    np.testing.assert_allclose(inside / inside.mean(), 1, atol=0.05)


def test_too_many_sections(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(lytro_container, "_MAX_SECTIONS", 3)
    empty = b"\x89LFC\r\n\x1a\n" + bytes(8)
    (tmp_path / "a.lfp").write_bytes(START + 4 * empty)
    with pytest.raises(FormatError, match="more than 3 sections"):
        titles_of(tmp_path / "a.lfp")
